"""Break points: the ends of the face's tracks refined in the image, their edges named, and what lies between them.

Where stripes on the face end: an edge blurred by the optics, fitted to the stripe's brightness along itself.

Along the stripe the brightness falls from the face's level to what lies beyond (nothing, the weak continuation
on a wall, a leak of the stripe on the body behind) as an error function; speckle multiplies it (ringpose-method(7),
section 3).

Whether the ends of the face's tracks make one ring, which of them is hidden, and where the ring's centre lies.
"""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from ringpose.detect.difference_images import LaserImage
from ringpose.detect.rim import Face
from ringpose.detect.stripes import BORDER_PX, MIN_SEGMENT_COLUMNS, TAKEN_BY_THE_FIT, lens
from ringpose.geometry.planes import nearest_plane, towards_camera
from ringpose.geometry.rays import intersect, rays, undistorted_rays
from ringpose.kernels import ends as kernels
from ringpose.kernels.ends import EndParams, Ends, MarkParams, flagged_ends
from ringpose.kernels.lines import LASER, MIDDLE_X, MIDDLE_Y, SLOPE, X_END, X_START, ArcFit, arc_fit
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.camera import Camera
from ringpose.types.detection import MAX_OFFSET, UNLABELLED, BreakPointFlag, BreakPoints, outside_image
from ringpose.types.rig import Rig

KINK_LEVEL = 0.25
"""A level beyond the edge of this share of the face's means that the stripe runs on: a wall."""

UNCLEAR_PX = 0.75
"""Ends with a greater sigma are flagged: two of them are the 1.5 px that no end may be off without a flag."""

INSIDE_COLUMNS = 24
"""Columns of the face that set its level before the edge."""

OUTSIDE_COLUMNS = 12
"""Columns beyond the edge that set the level there."""

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
    return flagged_ends(face.tracks[order], ends, lasers, len(rig.lasers.names), mark_rules(rig.camera.image_width))


@lru_cache(maxsize=4)
def mark_rules(image_width: int) -> MarkParams:
    """What ends in images of that width are held against."""
    return MarkParams(
        image_width=image_width,
        border_px=BORDER_PX,
        saturated_share=SATURATED_SHARE,
        kink_level=KINK_LEVEL,
        unclear_px=UNCLEAR_PX,
        clipped_phase=CLIPPED_PHASE,
        facet_sigmas=FACET_SIGMAS,  # the line follows what is coarser, so that its centres show little of that
        fit_dof=TAKEN_BY_THE_FIT,
        min_columns=MIN_SEGMENT_COLUMNS,
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


BEYOND_COLUMNS = 40
"""Columns beyond a track in which its end is looked for."""

FLANK_SIGMAS = 3.0
"""Rows on both sides of the line that are looked at, in sigmas of the stripe."""

FLANKS_SHARE = 0.6
"""Share of columns with a saturated pixel above which a stripe is read by its flanks; they see less light."""

UNDIMMED_LEVEL = 0.6
"""Share of the face's level above which a stripe still goes on; a wall beyond a kink has less."""

MIN_HEADROOM = 0.05
"""Columns that saturation leaves less of than this say nothing about the stripe's level."""

MIN_NOISE = 0.01
"""No column weighs as if it had less noise than this share of the stripe's level: glare and the tails of the blur."""

SHAPE_SIGMA = 0.005
"""Columns by which a real edge's position depends on how its blur is modelled; adds to what noise explains."""

SATURATED_SHARE = 0.2
"""Share of the last columns with a saturated pixel above which an end is flagged."""

TEXTURE_FACTOR = 1.5
"""Error of a column's peak over what its section leaves unexplained, where crinkled foil lies beneath: 1.4 to 1.75."""

FACET_SIGMAS = 6.0
"""Columns over which what lies beneath a stripe is alike, in sigmas of its section: what is finer than the section is
wide averages out across it."""

NEAR_COLUMNS = 9.0
"""Columns beyond the edge in which the level should be the fitted one; farther out the body's stripe may begin."""

WIDTH_SPREAD = 0.1
"""How far the blur of one end may be from that of the others: depth of field, pixels."""

BLUNT_GAIN = 3.0
"""Falls wider than the stripe is thick must explain all ends of an image by so much better, in log likelihood, to be
believed: no lens blurs more along the stripe than across it, so that an edge has a chamfer or is worn round."""

LINE = [MIDDLE_X, MIDDLE_Y, SLOPE, X_START, X_END]


def stripe_ends(
    tracks: Float64[Array, "track column=11"], image: LaserImage, camera: Camera, saturation_dn: int
) -> Float64[Array, "track end=2 column=10"]:
    """The left and right end of each track in the image that shows its stripe, as the kernel tells them."""
    return kernels.stripe_ends(image.lit, image.dark, tracks[:, LINE], lens(camera), _rules(saturation_dn))


@lru_cache(maxsize=4)
def _rules(saturation_dn: int) -> EndParams:
    return EndParams(
        saturation_dn=saturation_dn,
        beyond_columns=BEYOND_COLUMNS,
        inside_columns=INSIDE_COLUMNS,
        outside_columns=OUTSIDE_COLUMNS,
        flank_sigmas=FLANK_SIGMAS,
        flanks_share=FLANKS_SHARE,
        undimmed_level=UNDIMMED_LEVEL,
        min_headroom=MIN_HEADROOM,
        min_noise=MIN_NOISE,
        shape_sigma=SHAPE_SIGMA,
        texture_factor=TEXTURE_FACTOR,
        facet_sigmas=FACET_SIGMAS,
        near_columns=NEAR_COLUMNS,
        width_spread=WIDTH_SPREAD,
        blunt_gain=BLUNT_GAIN,
    )


CIRCLE_SIGMA_PX = 0.5
"""How far a refined end may lie from its circle besides its own sigma: calibration, an edge's chamfer."""

OCCLUDED_PENALTY = 12.0
"""Drop in squared sigmas over two that calls one end of six occluded: below 1e-5 by chance, six ends tried."""

FITTED_EXACTLY = 4
"""Two arcs about one centre go through so many ends whatever their errors: nothing is left over that would show those
of calibration or of a stripe that is two."""

SIDE_SIGMAS = 2.0
"""How clearly the curvature must say on which side the ring's centre lies."""

TIE = 3.0
"""Two ends whose removal explains the rest this equally well cannot be told apart by the circles: if one end of
a stripe is wrong, another curvature makes the other end look wrong."""

IN_FRONT_M = 0.005
"""What stands out of the ring's face by more than this is not the ring."""

BESIDE_PX = 40.0
"""How far from an end a stripe on what hides it begins."""

Tracks = Float64[Array, "track column=11"]
"""Columns as in `TRACK_COLUMNS`."""


def checked(ends: Ends, tracks: Tracks, rig: Rig) -> tuple[Ends, bool, bool]:
    """The ends without a hidden one; whether the ring's centre lies to the right of the stripes; whether that is clear.

    The sign of the arcs' curvature tells the side: if the centre lies to the right, right ends are inner ones.
    """
    planes, optics = _planes(rig), lens(rig.camera)
    fit = arc_fit(ends.position_px, ends.covariance_px2, planes, optics, CIRCLE_SIGMA_PX, FITTED_EXACTLY)
    if sum(fit.seen) < FITTED_EXACTLY or 0 in fit.seen:
        return ends, False, False
    if sum(fit.seen) >= 6 and fit.cost - min(fit.cost_without) > OCCLUDED_PENALTY:
        return checked(_without_hidden(ends, fit, tracks, rig), tracks, rig)
    return ends, fit.curvature > 0, abs(fit.curvature) > SIDE_SIGMAS * fit.curvature_sigma


def _without_hidden(ends: Ends, fit: ArcFit, tracks: Tracks, rig: Rig) -> Ends:
    """The ends without the one that lies off the circles of the others.

    If both ends of its stripe would do, the one beside a stripe on something nearer than the face is hidden;
    if that decides nothing, both are left out.
    """
    cost_without = np.array(fit.cost_without).reshape(-1, 2)
    suspects = np.argwhere(cost_without < cost_without.min() + TIE)
    beside = [each for each in suspects if _beside_something_nearer(ends, int(each[0]), int(each[1]), tracks, rig)]
    if len(beside) == 1:
        return _without(ends, np.array(beside))
    labelled = np.isin(suspects[:, 0], tracks[:, LASER]).all()
    return _without(ends, suspects) if labelled else _without_stripes(ends, suspects)


def _without_stripes(ends: Ends, suspects: Int64[Array, "n 2"]) -> Ends:
    """The ends without stripes of which one is suspected: nothing hides it, and no laser is known to have drawn it."""
    lasers = np.unique(suspects[:, 0])
    left = _without(ends, np.stack([np.repeat(lasers, 2), np.tile([0, 1], len(lasers))], axis=1))
    straight, sigma = ends.straight_px.copy(), ends.straight_sigma_px.copy()
    straight[lasers], sigma[lasers] = np.nan, np.nan
    return left._replace(straight_px=straight, straight_sigma_px=sigma)


def _without(ends: Ends, suspects: Int64[Array, "n 2"]) -> Ends:
    """The ends with some called occluded."""
    position, covariance, flags = ends.position_px.copy(), ends.covariance_px2.copy(), ends.flags.copy()
    which = tuple(suspects.T)
    position[which], covariance[which] = np.nan, np.nan
    flags[which] |= int(BreakPointFlag.OCCLUDED)
    return ends._replace(position_px=position, covariance_px2=covariance, flags=flags)


def _beside_something_nearer(ends: Ends, laser: int, side: int, tracks: Tracks, rig: Rig) -> bool:
    """Whether a stripe of the same laser begins beside an end and, by its depth, in front of the face."""
    seen = ~np.isnan(ends.position_px[..., 0])
    planes = np.repeat(_planes(rig), 2, axis=0)[seen.ravel()]
    points = intersect(rays(ends.position_px[seen], rig.camera), planes[:, :3], planes[:, 3])
    points = points[np.isfinite(points).all(axis=1)]
    towards = towards_camera(nearest_plane(points)[0], points.mean(axis=0))
    own = np.isin(tracks[:, LASER], [laser, UNLABELLED])
    near_x = tracks[:, X_END if side == 0 else X_START]
    outward = (near_x - ends.straight_px[laser, side, 0]) * (-1 if side == 0 else 1)
    beside = own & (outward > -BESIDE_PX / 4) & (outward < BESIDE_PX)
    near_y = tracks[:, MIDDLE_Y] + tracks[:, SLOPE] * (near_x - tracks[:, MIDDLE_X])
    directions = undistorted_rays(np.stack([near_x, near_y], axis=-1)[beside], rig.camera)
    stripe = intersect(directions, rig.lasers.normal[[laser]], rig.lasers.distance_m[[laser]])
    return bool(np.any((stripe - points.mean(axis=0)) @ towards > IN_FRONT_M))


@lru_cache(maxsize=4)
def _planes(rig: Rig) -> Float64[Array, "laser normal_and_distance=4"]:
    """The light planes."""
    return np.concatenate([rig.lasers.normal, rig.lasers.distance_m[:, None]], axis=1)
