"""Break points: the ends of the face's tracks refined in the image, their edges named, and what lies between them."""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from ringpose.detect.consistency import checked
from ringpose.detect.faces import Face
from ringpose.detect.frames import LaserImage
from ringpose.detect.stripe_ends import FACET_SIGMAS, INSIDE_COLUMNS, OUTSIDE_COLUMNS, SATURATED_SHARE, stripe_ends
from ringpose.detect.tracks import BORDER_PX, LEAST_COLUMNS, TAKEN_BY_THE_FIT
from ringpose.kernels.ends import Ends, MarkRules, marked_ends
from ringpose.types.arrays import Array, Float64
from ringpose.types.camera import Camera
from ringpose.types.detection import MAX_OFFSET, BreakPointFlag, BreakPoints, outside_image
from ringpose.types.rig import Rig

KINK_LEVEL = 0.25
"""A level beyond the edge of this share of the face's means that the stripe runs on: a wall."""

UNCLEAR_PX = 0.75
"""Ends with a greater sigma are flagged: two of them are the 1.5 px that no end may be off without a flag."""

MAX_END_SIGMA_PX = (INSIDE_COLUMNS + OUTSIDE_COLUMNS) / math.sqrt(12)
"""An end that may lie anywhere among the columns that it is fitted to has this sigma (uniform distribution, 10.4 px).
Where a fit gives more, as beside a glint that saturates all of them, the image shows no end there."""

CLEAR_ENDS = 2
"""Of stripes that end on a ring, so many are known to `UNCLEAR_PX` even before bright foil; of five faces among foil
that look like one, one has so many. Where a frame shows the ring's edges, these say more."""

CLIPPED_PHASE = 0.022
"""Error of a saturated stripe's centre, times the sigma of its section in pixels.

Pixels sample the two corners that clipping makes: each errs by half its bend times the second Bernoulli polynomial of
its phase (Euler and Maclaurin). A stripe of 1.65 times the largest value is clipped over one sigma on either side, and
filters weigh the corners by 0.85 of the flanks. All columns err alike where a track stays within a row of pixels; over
the rows that it crosses the error averages out.
"""


def break_points(
    face: Face,
    tracks: Float64[Array, "track column=11"],
    images: Sequence[LaserImage],
    rig: Rig,
    saturation_dn: int,
) -> BreakPoints:
    """The break points of a face among all tracks; `images` are the frames that show the lasers."""
    ends = _measured(_edges_alike(_ends(face, images, rig, saturation_dn)), rig.camera)
    ends, right_is_inner, clear = checked(ends, tracks, rig)
    order = slice(None, None, -1) if right_is_inner else slice(None)
    flags = ends.flags[:, order].copy()
    if not clear:
        flags[list(face.lasers)] |= int(BreakPointFlag.EDGE_UNKNOWN)
    return BreakPoints(
        position_px=ends.position_px[:, order].copy(),
        covariance_px2=ends.covariance_px2[:, order].copy(),
        flags=flags,
        face_start_px=ends.straight_px[:, 0],
        face_end_px=ends.straight_px[:, 1],
        face_sigma_px=ends.straight_sigma_px,
        labelled=all(image.labelled for image in images if not set(image.lasers).isdisjoint(face.lasers)),
    )


def ends_clear(found: BreakPoints) -> bool:
    """Whether enough ends are edges: a stripe on foil fades, flickers or runs on where a face seems to end."""
    clear = found.seen & (found.flags & int(BreakPointFlag.UNCLEAR) == 0)
    return int(clear.sum()) >= min(CLEAR_ENDS, int(found.seen.sum()))


def _ends(face: Face, images: Sequence[LaserImage], rig: Rig, saturation_dn: int) -> Ends:
    """The ends of the face's tracks, each in the image that shows its stripe."""
    order, found = [], []
    for image in images:
        shown = [number for number, laser in enumerate(face.lasers) if laser in image.lasers]
        if shown:
            order += shown
            found.append(stripe_ends(face.tracks[shown], image, rig.camera, saturation_dn))
    lasers = tuple(face.lasers[number] for number in order)
    ends = found[0] if len(found) == 1 else np.concatenate(found)
    return marked_ends(face.tracks[order], ends, lasers, len(rig.lasers.names), mark_rules(rig.camera.image_width))


@lru_cache(maxsize=4)
def mark_rules(image_width: int) -> MarkRules:
    """What ends in images of that width are held against."""
    return MarkRules(
        image_width=image_width,
        border_px=BORDER_PX,
        saturated_share=SATURATED_SHARE,
        kink_level=KINK_LEVEL,
        unclear_px=UNCLEAR_PX,
        clipped_phase=CLIPPED_PHASE,
        facet_sigmas=FACET_SIGMAS,  # the line follows what is coarser, so that its centres show little of that
        taken_by_fit=TAKEN_BY_THE_FIT,
        least_columns=LEAST_COLUMNS,
        saturated_flag=BreakPointFlag.SATURATED,
        kink_flag=BreakPointFlag.KINK,
        clipped_flag=BreakPointFlag.CLIPPED,
        blunt_flag=BreakPointFlag.BLUNT,
        unclear_flag=BreakPointFlag.UNCLEAR,
    )


def _edges_alike(ends: Ends) -> Ends:
    """The ends with all of an edge blunt where most of them are: it is made alike all around.

    They are then known no better than the best known of the blunt ones.
    """
    blunt = ends.flags & int(BreakPointFlag.BLUNT) != 0
    if not blunt.any():
        return ends
    seen = ~np.isnan(ends.position_px[..., 0])
    others = seen & ~blunt & (2 * blunt.sum(axis=0) > seen.sum(axis=0))
    flags, covariance = ends.flags.copy(), ends.covariance_px2.copy()
    flags[others] |= int(BreakPointFlag.BLUNT)
    for laser, side in np.argwhere(others).tolist():
        least = covariance[blunt[:, side], side, 0, 0].min()
        covariance[laser, side] *= max(least / covariance[laser, side, 0, 0], 1.0)
    return ends._replace(flags=flags, covariance_px2=covariance)


def _measured(ends: Ends, camera: Camera) -> Ends:
    """The ends and lines without those that the image does not determine; such an end is flagged as unclear."""
    size = camera.image_width, camera.image_height
    sigma_px = np.sqrt(np.maximum(ends.covariance_px2[..., 0, 0], ends.covariance_px2[..., 1, 1]))
    placed = np.isfinite(ends.position_px.sum(axis=-1))
    outside = outside_image(ends.position_px, MAX_OFFSET["position_px"], *size)
    known = placed & (sigma_px <= MAX_END_SIGMA_PX) & ~outside
    outside = outside_image(ends.straight_px, MAX_OFFSET["face_start_px"], *size)
    straight = np.logical_and(*((ends.straight_sigma_px <= MAX_END_SIGMA_PX) & ~outside).T)
    return Ends(
        position_px=np.where(known[..., None], ends.position_px, np.nan),
        covariance_px2=np.where(known[..., None, None], ends.covariance_px2, np.nan),
        flags=ends.flags | np.where(placed & ~known, int(BreakPointFlag.UNCLEAR), 0),
        straight_px=np.where(straight[:, None, None], ends.straight_px, np.nan),
        straight_sigma_px=np.where(straight[:, None], ends.straight_sigma_px, np.nan),
    )
