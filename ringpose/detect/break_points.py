"""Break points: the endpoints of the stripes on the ring's face (ringpose-method(7), section 3).

Each endpoint is refined in the image: along the stripe, the intensity falls from the level on the face to the level
beyond (zero, the weak continuation on a wall, or light on the body behind) as an error function, under multiplicative
speckle noise. The endpoints are then checked for lying on one ring: an occluded one is removed, and the curvature of
the two arcs resolves which endpoints are on the inner edge.
"""

import math
from collections.abc import Sequence
from functools import lru_cache

import numpy as np

from ringpose.detect.difference_images import LaserImage
from ringpose.detect.rim import Face
from ringpose.detect.stripes import BORDER_PX, FIT_DOF_CORRECTION, MIN_SEGMENT_COLUMNS, lens
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
"""Ratio of the level beyond the edge to that on the face above which the stripe continues: a wall."""

UNCLEAR_PX = 0.75
"""Standard deviation above which an end is flagged: half of the largest error that is permitted without a flag."""

INSIDE_COLUMNS = 24
"""Columns inside the edge from which the level on the face is estimated."""

OUTSIDE_COLUMNS = 12
"""Columns beyond the edge from which the level there is estimated."""

MAX_END_SIGMA_PX = (INSIDE_COLUMNS + OUTSIDE_COLUMNS) / math.sqrt(12)
"""Standard deviation of a uniform distribution over the columns of a fit (10.4 px). A larger sigma, as beside a glint
that saturates all columns, means that the image does not show the end."""

CLEAR_ENDS = 2
"""Minimum number of ends with a sigma below `UNCLEAR_PX`. Rings reach it even before bright foil; of false detections
on foil one in five does. Visible edges of the ring are the stronger evidence, where a frame shows them."""

CLIPPED_PHASE = 0.022
"""Error of a saturated stripe's centre, times the sigma of its section in pixels.

Pixels sample the two corners that clipping produces: the error of each is half the change of slope times the second
Bernoulli polynomial of its phase (Euler-Maclaurin). A stripe of 1.65 times the saturation value is clipped over one
sigma to each side, and filters weight the corners by 0.85 of the flanks. The error is common to all columns where a
stripe stays within a row of pixels; over the rows that it crosses it averages out.
"""


def break_points(
    face: Face,
    tracks: Float64[Array, "track column=11"],
    images: Sequence[LaserImage],
    rig: Rig,
    saturation_dn: int,
) -> BreakPoints:
    """The break points of a face among all tracks; `images` are the frames that show the lasers."""
    ends = _measured(_with_common_bluntness(_ends(face, images, rig, saturation_dn)), rig.camera)
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
    """Whether enough ends are clear edges: at the end of an apparent face on foil, a stripe fades or continues."""
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
    return flagged_ends(face.tracks[order], ends, lasers, len(rig.lasers.names), mark_params(rig.camera.image_width))


@lru_cache(maxsize=4)
def mark_params(image_width: int) -> MarkParams:
    """Thresholds for the flags and sigmas of ends in images of that width."""
    return MarkParams(
        image_width=image_width,
        border_px=BORDER_PX,
        saturated_share=SATURATED_SHARE,
        kink_level=KINK_LEVEL,
        unclear_px=UNCLEAR_PX,
        clipped_phase=CLIPPED_PHASE,
        facet_sigmas=FACET_SIGMAS,  # the fitted line absorbs coarser texture, which the centres' scatter does not show
        fit_dof=FIT_DOF_CORRECTION,
        min_columns=MIN_SEGMENT_COLUMNS,
        saturated_flag=BreakPointFlag.SATURATED,
        kink_flag=BreakPointFlag.KINK,
        clipped_flag=BreakPointFlag.CLIPPED,
        blunt_flag=BreakPointFlag.BLUNT,
        unclear_flag=BreakPointFlag.UNCLEAR,
    )


def _with_common_bluntness(ends: Ends) -> Ends:
    """The ends, all of an edge flagged as blunt where most of them are: an edge has the same shape all around.

    The variance of those is then at least the smallest of the blunt ones.
    """
    blunt = ends.flags & int(BreakPointFlag.BLUNT) != 0
    if not blunt.any():
        return ends
    seen = ~np.isnan(ends.position_px[..., 0])
    others = seen & ~blunt & (2 * blunt.sum(axis=0) > seen.sum(axis=0))
    flags, covariance = ends.flags.copy(), ends.covariance_px2.copy()
    flags[others] |= int(BreakPointFlag.BLUNT)
    for laser, side in np.argwhere(others).tolist():
        smallest = covariance[blunt[:, side], side, 0, 0].min()
        covariance[laser, side] *= max(smallest / covariance[laser, side, 0, 0], 1.0)
    return ends._replace(flags=flags, covariance_px2=covariance)


def _measured(ends: Ends, camera: Camera) -> Ends:
    """The ends and lines; NaN for those that the image does not determine, and such an end is flagged as unclear."""
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
"""Columns beyond a segment in which its end is searched for."""

FLANK_SIGMAS = 3.0
"""Half height of the evaluated window about the line, in sigmas of the stripe."""

FLANKS_SHARE = 0.6
"""Share of columns with a saturated pixel above which only the flanks of a stripe are evaluated."""

UNDIMMED_LEVEL = 0.6
"""Ratio to the level on the face above which a stripe continues; on a wall beyond a kink it is lower."""

MIN_HEADROOM = 0.05
"""Minimum share of a column's intensity that is not clipped by saturation; other columns are ignored."""

MIN_NOISE = 0.01
"""Minimum noise of a column relative to the stripe's level: glare and the tails of the blur."""

SHAPE_SIGMA = 0.005
"""Error of an edge's position, in columns, due to the model of its blur; added to that by noise."""

SATURATED_SHARE = 0.2
"""Share of the last columns with a saturated pixel above which an end is flagged."""

TEXTURE_FACTOR = 1.5
"""Ratio of a column's amplitude error to the residual of its cross-section, on crinkled foil: 1.4 to 1.75."""

FACET_SIGMAS = 6.0
"""Correlation length of the surface texture along a stripe, in sigmas of its cross-section: finer texture averages out
across the stripe."""

NEAR_COLUMNS = 9.0
"""Columns beyond the edge in which the fitted level is required; farther out a stripe on the body may begin."""

WIDTH_SPREAD = 0.1
"""Relative standard deviation of the blur between ends: depth of field, pixels."""

BLUNT_GAIN = 3.0
"""Gain in log likelihood, over all ends of an image, above which edges wider than the stripe's cross-section are
accepted: optics do not blur more along a stripe than across it, so that the edge is chamfered or worn."""

LINE = [MIDDLE_X, MIDDLE_Y, SLOPE, X_START, X_END]


def stripe_ends(
    tracks: Float64[Array, "track column=11"], image: LaserImage, camera: Camera, saturation_dn: int
) -> Float64[Array, "track end=2 column=10"]:
    """The left and right end of each segment in the image that shows its stripe; columns as returned by the kernel."""
    return kernels.stripe_ends(image.lit, image.dark, tracks[:, LINE], lens(camera), _end_params(saturation_dn))


@lru_cache(maxsize=4)
def _end_params(saturation_dn: int) -> EndParams:
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
"""Standard deviation of a refined end from its circle, besides its own sigma: calibration, an edge's chamfer."""

OCCLUDED_PENALTY = 12.0
"""Drop in chi2 / 2 above which one end of six is rejected as occluded: below 1e-5 by chance, six ends tried."""

FITTED_EXACTLY = 4
"""Degrees of freedom of two arcs about one centre: with so many ends there are no residuals, and errors of calibration
or of the assignment of stripes remain undetected."""

SIDE_SIGMAS = 2.0
"""Minimum significance of the curvature from which the side of the ring's centre is inferred."""

TIE = 3.0
"""Difference in chi2 / 2 below which two candidates for rejection are equivalent: if one end of a stripe is wrong, the
other end is an outlier to a ring of another curvature."""

IN_FRONT_M = 0.005
"""Height above the ring's face from which a surface is not part of the ring."""

BESIDE_PX = 40.0
"""Maximum distance between an occluded end and the stripe on the occluding surface."""

Tracks = Float64[Array, "track column=11"]
"""Columns as in `TRACK_COLUMNS`."""


def checked(ends: Ends, tracks: Tracks, rig: Rig) -> tuple[Ends, bool, bool]:
    """The ends without an occluded one; whether the ring's centre is to the right of the stripes; if that is certain.

    The side follows from the sign of the arcs' curvature. If the centre is to the right, right ends are inner ones.
    """
    planes, optics = _planes(rig), lens(rig.camera)
    fit = arc_fit(ends.position_px, ends.covariance_px2, planes, optics, CIRCLE_SIGMA_PX, FITTED_EXACTLY)
    if sum(fit.seen) < FITTED_EXACTLY or 0 in fit.seen:
        return ends, False, False
    if sum(fit.seen) >= 6 and fit.cost - min(fit.cost_without) > OCCLUDED_PENALTY:
        return checked(_without_occluded(ends, fit, tracks, rig), tracks, rig)
    return ends, fit.curvature > 0, abs(fit.curvature) > SIDE_SIGMAS * fit.curvature_sigma


def _without_occluded(ends: Ends, fit: ArcFit, tracks: Tracks, rig: Rig) -> Ends:
    """The ends without the one that does not lie on the circles of the others.

    If either end of its stripe could be the one, it is that beside a stripe on a surface nearer than the face. If this
    does not decide, both are rejected.
    """
    cost_without = np.array(fit.cost_without).reshape(-1, 2)
    suspects = np.argwhere(cost_without < cost_without.min() + TIE)
    beside = [each for each in suspects if _beside_occluder(ends, int(each[0]), int(each[1]), tracks, rig)]
    if len(beside) == 1:
        return _without(ends, np.array(beside))
    labelled = np.isin(suspects[:, 0], tracks[:, LASER]).all()
    return _without(ends, suspects) if labelled else _without_stripes(ends, suspects)


def _without_stripes(ends: Ends, suspects: Int64[Array, "n 2"]) -> Ends:
    """The ends without the stripes of the suspects: with unlabelled stripes, the assignment to a laser may be wrong."""
    lasers = np.unique(suspects[:, 0])
    left = _without(ends, np.stack([np.repeat(lasers, 2), np.tile([0, 1], len(lasers))], axis=1))
    straight, sigma = ends.straight_px.copy(), ends.straight_sigma_px.copy()
    straight[lasers], sigma[lasers] = np.nan, np.nan
    return left._replace(straight_px=straight, straight_sigma_px=sigma)


def _without(ends: Ends, suspects: Int64[Array, "n 2"]) -> Ends:
    """The ends, some of them removed and flagged as occluded."""
    position, covariance, flags = ends.position_px.copy(), ends.covariance_px2.copy(), ends.flags.copy()
    which = tuple(suspects.T)
    position[which], covariance[which] = np.nan, np.nan
    flags[which] |= int(BreakPointFlag.OCCLUDED)
    return ends._replace(position_px=position, covariance_px2=covariance, flags=flags)


def _beside_occluder(ends: Ends, laser: int, side: int, tracks: Tracks, rig: Rig) -> bool:
    """Whether a stripe of the same laser begins beside an end, and its triangulated depth is in front of the face."""
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
    """The light planes: unit normal and distance."""
    return np.concatenate([rig.lasers.normal, rig.lasers.distance_m[:, None]], axis=1)
