"""Break points: the ends of the face's tracks refined in the image, their edges named, and what lies between them."""

import math
from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ringpose.detect.consistency import Ends, checked
from ringpose.detect.faces import Face
from ringpose.detect.frames import LaserImage
from ringpose.detect.stripe_ends import SATURATED_SHARE, stripe_ends
from ringpose.detect.tracks import BORDER_PX, Track
from ringpose.kernels.ring import StripeEnd
from ringpose.types.arrays import Array, Float64
from ringpose.types.break_points import BreakPointFlag, BreakPoints
from ringpose.types.rig import Rig

KINK_LEVEL = 0.25
"""A level beyond the edge of this share of the face's means that the stripe runs on: a wall."""

UNCLEAR_PX = 0.75
"""Ends with a greater sigma are flagged: two of them are the 1.5 px that no end may be off without a flag."""

CLIPPED_PHASE = 0.022
"""Error of a saturated stripe's centre, times the sigma of its section in pixels.

Pixels sample the two corners that clipping makes: each errs by half its bend times the second Bernoulli polynomial of
its phase (Euler and Maclaurin). A stripe of 1.65 times the largest value is clipped over one sigma on either side, and
filters weigh the corners by 0.85 of the flanks. All columns err alike where a track stays within a row of pixels; over
the rows that it crosses the error averages out.
"""


FACET_SIGMAS = 6.0
"""Columns over which what lies beneath a stripe is alike, in sigmas of its section: what is finer than the section is
wide averages out across it. The line follows what is coarser, so that its centres show little of that."""


class Mark(NamedTuple):
    """An end of a face's track in distorted pixels; NaN where none was found."""

    x: float
    y: float
    xx: float
    """Covariance."""
    xy: float
    yx: float
    yy: float
    flags: float
    straight_x: float
    """The track's own end, an undistorted column, and ..."""
    straight_sigma_px: float
    """... the standard deviation of the track's ordinate there."""


NAN = math.nan

NO_MARK = Mark(NAN, NAN, NAN, NAN, NAN, NAN, 0.0, NAN, NAN)


def break_points(
    face: Face,
    tracks: Float64[Array, "track column=11"],
    images: Sequence[LaserImage],
    rig: Rig,
    saturation_dn: int,
) -> BreakPoints:
    """The break points of a face among all tracks (rows of `Track`); `images` are the frames that show the lasers."""
    marks = [(NO_MARK, NO_MARK)] * len(rig.lasers.names)
    labelled = True
    for image in images:
        shown = [(laser, track) for laser, track in face.tracks if laser in image.lasers]
        if shown:
            found = stripe_ends([track for _, track in shown], image, rig.camera, saturation_dn)
            for (laser, track), both in zip(shown, found, strict=True):
                marks[laser] = _marks(track, both, rig.camera.image_width)
            labelled = labelled and image.labelled
    ends, right_is_inner, clear = checked(_edges_alike(_table(marks)), tracks, rig)
    return _gathered(face, ends, right_is_inner=right_is_inner, clear=clear, labelled=labelled)


def _marks(track: Track, ends: tuple[StripeEnd, StripeEnd], image_width: int) -> tuple[Mark, Mark]:
    """The ends of a track with their covariances and flags."""
    beneath_px, shared_px = _unseen_errors(track, ends)
    left, right = (
        _mark(end, image_width, at, *(math.hypot(track.sigma(x, beneath_px), shared_px) for x in (end.x, at)))
        for end, at in zip(ends, (track.x_start, track.x_end), strict=True)
    )
    return left, right


def _unseen_errors(track: Track, ends: tuple[StripeEnd, StripeEnd]) -> tuple[float, float]:
    """Standard deviations of what a track's centres share, which does not show in their scatter.

    What lies beneath a stripe and shifts its peak by a share of itself shifts its centre by that share of its sigma;
    the other is that of clipping.
    """
    section_px, beneath = ends[0].section_px, ends[0].beneath
    if math.isnan(section_px):
        return 0.0, 0.0
    facets = track.centers / (FACET_SIGMAS * section_px)
    clipped = any(end.saturated > SATURATED_SHARE for end in ends)
    shared_px = CLIPPED_PHASE / section_px / max(abs(track.slope) * track.length, 1.0) if clipped else 0.0
    return section_px * math.sqrt(beneath / max(facets, 1.0)), shared_px


def _mark(end: StripeEnd, image_width: int, straight_x: float, sigma_px: float, straight_sigma_px: float) -> Mark:
    """An end with its covariance, from the line's `sigma_px` there, and its flags; at the image's border it is none."""
    if not BORDER_PX <= end.x <= image_width - 1 - BORDER_PX:
        return NO_MARK._replace(
            flags=int(BreakPointFlag.CLIPPED), straight_x=straight_x, straight_sigma_px=straight_sigma_px
        )
    xx = end.sigma_px * end.sigma_px
    xy = xx * end.slope
    yy = xy * end.slope + sigma_px * sigma_px
    return Mark(end.x, end.y, xx, xy, xy, yy, _flags(end), straight_x, straight_sigma_px)


def _flags(end: StripeEnd) -> int:
    """The flags of an end that was found."""
    return (
        BreakPointFlag.SATURATED * (end.saturated > SATURATED_SHARE)
        + BreakPointFlag.KINK * (end.outside > KINK_LEVEL)
        + BreakPointFlag.BLUNT * (end.blunt == 1)
        + BreakPointFlag.UNCLEAR * (end.sigma_px > UNCLEAR_PX and end.blunt != 1)
    )


def _table(marks: Sequence[tuple[Mark, Mark]]) -> Ends:
    """The ends over all lasers of the rig."""
    table = np.array([[*left, *right] for left, right in marks]).reshape(-1, 2, len(NO_MARK))
    return Ends(
        position_px=table[..., :2].copy(),
        covariance_px2=table[..., 2:6].reshape(-1, 2, 2, 2),
        flags=table[..., 6].astype(np.int64),
        straight_x=table[..., 7],
        straight_sigma_px=table[..., 8],
    )


def _edges_alike(ends: Ends) -> Ends:
    """The ends with all of an edge blunt where most of them are: it is made alike all around.

    They are then known no better than the best known of the blunt ones.
    """
    blunt = (ends.flags & int(BreakPointFlag.BLUNT)) != 0
    if not blunt.any():
        return ends
    seen = ends.seen
    others = seen & ~blunt & (2 * blunt.sum(axis=0) > seen.sum(axis=0))
    flags, covariance = ends.flags.copy(), ends.covariance_px2.copy()
    flags[others] |= int(BreakPointFlag.BLUNT)
    for track, side in np.argwhere(others).tolist():
        least = covariance[blunt[:, side], side, 0, 0].min()
        covariance[track, side] *= max(least / covariance[track, side, 0, 0], 1.0)
    return replace(ends, flags=flags, covariance_px2=covariance)


def _gathered(face: Face, ends: Ends, *, right_is_inner: bool, clear: bool, labelled: bool) -> BreakPoints:
    """The record, NaN where nothing was seen."""
    order = slice(None, None, -1 if right_is_inner else 1)
    flags = ends.flags[:, order].copy()
    lines = np.full((len(flags), 2, 2), np.nan)
    for laser, track in face.tracks:
        lines[laser] = (track.x_start, track.y(track.x_start)), (track.x_end, track.y(track.x_end))
        flags[laser] |= 0 if clear else int(BreakPointFlag.EDGE_UNKNOWN)
    return BreakPoints(
        position_px=ends.position_px[:, order].copy(),
        covariance_px2=ends.covariance_px2[:, order].copy(),
        flags=flags,
        face_start_px=lines[:, 0],
        face_end_px=lines[:, 1],
        face_sigma_px=ends.straight_sigma_px,
        labelled=labelled,
    )
