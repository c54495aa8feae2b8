"""Break points: the endpoints of the stripes on the ring's face (ringpose-method(7), section 3).

Each endpoint is refined in the image: along the stripe, the intensity falls from the level on the face to the level
beyond (zero, the weak continuation on a wall, or light on the body behind) as an error function, under multiplicative
speckle noise. The endpoints are then judged by the ring that explains them best (`ringpose.estimate`): wrong ones are
removed, and the ring's curvature shows which endpoints are on the inner edge.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ringpose.detect.difference_images import LaserImage, beside_left_out
from ringpose.detect.rim import IN_FRONT_M, Face
from ringpose.detect.ring_edges import straight
from ringpose.detect.stripes import lens, line_y_px
from ringpose.estimate.explanation import decision
from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.hypotheses import Explanation
from ringpose.estimate.measurements import Measurements, measurements_of
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.rays import (
    POINTS_OF_A_PLANE,
    nearest_plane,
    project,
    towards_camera,
    undistorted_rays,
)
from ringpose.geometry.sheets import sheet_points
from ringpose.kernels import _kernels, column_names, kernel_record
from ringpose.kernels.lines import (
    CENTERS,
    CORRELATION,
    LASER,
    MIDDLE_X,
    MIDDLE_Y,
    SCATTER,
    SEGMENT_COLUMNS,
    SLOPE,
    X_END,
    X_START,
    Lens,
)
from ringpose.optics.feature_errors import (
    AGREEMENT,
    BORDER_PX,
    FIT_DOF_CORRECTION,
    INSIDE_COLUMNS,
    MIN_COLUMNS,
    MIN_NOISE,
    MIN_SEGMENT_COLUMNS,
    OUTSIDE_COLUMNS,
    WIDTH_SPREAD,
    end_covariance_px2,
    fitted_columns,
    tilt_sigma_px,
)
from ringpose.optics.image_noise import PIXEL_VARIANCE
from ringpose.types.arrays import EDGES, Array, Bool, Float64, Int64, UInt
from ringpose.types.assumptions import IDEAL, Assumptions
from ringpose.types.detection import (
    MAX_OFFSET,
    UNLABELLED,
    BreakPointFlag,
    BreakPoints,
    JudgedRing,
    NoBreakPoints,
    Rejection,
    outside_image,
)
from ringpose.types.finding import Finding
from ringpose.types.rig import Camera, Rig

KINK_LEVEL = 0.25
"""Ratio of the level beyond the edge to that on the face above which the stripe continues: a wall."""

UNCLEAR_PX = 0.75
"""Standard deviation above which an end is flagged: half of the largest error that is permitted without a flag."""

MAX_END_SIGMA_PX = (INSIDE_COLUMNS + OUTSIDE_COLUMNS) * math.sqrt(PIXEL_VARIANCE)
"""Standard deviation of a uniform distribution over the columns of a fit (10.4 px). A larger sigma, as beside a glint
that saturates all columns, means that the image does not show the end."""

CLIPPED_PHASE = 0.022
"""Error of a saturated stripe's centre, times the sigma of its section in pixels.

Pixels sample the two corners that clipping produces: the error of each is half the change of slope times the second
Bernoulli polynomial of its phase (Euler-Maclaurin). A stripe of 1.65 times the saturation value is clipped over one
sigma to each side, and filters weight the corners by 0.85 of the flanks. The error is common to all columns where a
stripe stays within a row of pixels; over the rows that it crosses it averages out.
"""


def break_points(
    face: Face,
    segments: Float64[Array, "segment column=12"],
    images: Sequence[LaserImage],
    rig: Rig,
    saturation_dn: int,
) -> BreakPoints:
    """Break points of the face's stripes; `segments`: all segments.

    Where one arc of the ring is seen, left ends are first named as on the inner edge. If both are seen, the edges are
    known, and a stripe that passes beside the hole has one outer end on each arc, its line on the first one.
    """
    points = _on_arc(face, segments, images, rig, saturation_dn)
    if face.opposite is None:
        return points
    beyond = _on_arc(face.opposite, segments, images, rig, saturation_dn)
    lasers = range(len(rig.lasers.names))
    joined = np.array([face.passes_beside_hole(laser) for laser in lasers])
    inner = np.outer(joined, [edge == "inner" for edge in EDGES])
    nothing = np.zeros_like(joined)
    return replace(points.without(inner, nothing), opposite=beyond.without(inner, joined))


def _on_arc(
    face: Face,
    segments: Float64[Array, "segment column=12"],
    images: Sequence[LaserImage],
    rig: Rig,
    saturation_dn: int,
) -> BreakPoints:
    """The break points on one arc, of its stripes' two ends each."""
    ends = _measured(_with_common_bluntness(_ends(face, images, rig, saturation_dn)), rig.camera)
    beside = beside_occluder(ends, segments, rig)
    hidden, stamp_s = np.zeros_like(beside), np.full(len(rig.lasers.names), np.nan)
    for image in images:
        shown = [laser for laser in image.lasers if laser in face.lasers]
        stamp_s[shown] = image.stamp_s
        if image.left_out is not None:
            hidden |= beside_left_out(ends.position_px, image, image.left_out, KINK_LEVEL)
    flags = np.where(beside, int(BreakPointFlag.BESIDE_OCCLUDER), 0) | np.where(hidden, int(BreakPointFlag.UNCLEAR), 0)
    for laser, side in face.covered:
        hidden[laser, side] = True
        flags[laser, side] |= int(BreakPointFlag.OCCLUDED)
        flags[laser] |= int(BreakPointFlag.INTERRUPTED)
    several = ~(face.segments[:, None] == segments).all(axis=2).any(axis=1)  # of them on one line
    flags[np.array(face.lasers)[several | (_dark_columns(face.segments, rig) >= MIN_COLUMNS)]] |= int(
        BreakPointFlag.INTERRUPTED
    )
    points = BreakPoints(
        position_px=np.where(hidden[..., None], np.nan, ends.position_px),
        covariance_px2=np.where(hidden[..., None, None], np.nan, ends.covariance_px2),
        flags=ends.flags | flags,
        face_start_undistorted_px=ends.straight_px[:, 0],
        face_end_undistorted_px=ends.straight_px[:, 1],
        face_sigma_px=ends.straight_sigma_px,
        labelled=not any(
            image.label == UNLABELLED and not set(image.lasers).isdisjoint(face.lasers) for image in images
        ),
        stamp_s=stamp_s,
    )
    return points.with_edges_exchanged() if face.outer_end == 0 else points


def _dark_columns(segments: Float64[Array, "segment column=12"], rig: Rig) -> Float64[Array, "segment"]:
    """The number of image columns between the ends of each segment in which it has no centre."""
    middle_x, middle_y, slope = segments[:, [MIDDLE_X, MIDDLE_Y, SLOPE]].T[..., None]
    x_px = segments[:, [X_START, X_END]]
    ends_px = np.stack([x_px, middle_y + slope * (x_px - middle_x)], axis=-1)
    start_px, end_px = project(undistorted_rays(ends_px, rig.camera), rig.camera)[..., 0].T
    return np.asarray(end_px - start_px + 1.0 - segments[:, CENTERS])


class BreakPointsOnRing(NamedTuple):
    """The break points that agree with one ring, and those that do not."""

    break_points: BreakPoints | NoBreakPoints
    rejected: tuple[Rejection, ...]
    ring: JudgedRing | None = None
    """None if several rings explain the break points, or none does."""


def without_outliers(
    points: BreakPoints, rig: Rig, assumptions: Assumptions = IDEAL, camera: CameraMotion | None = None
) -> BreakPointsOnRing:
    """The break points judged by the best explanation of their ring: edges named inner or outer, wrong points left out.

    They are judged before the ring's edges are searched, since a wrong end misleads that search. A rejected end is
    flagged as occluded. If several explanations are comparable, nothing is rejected: the pose reports what they have in
    common. If the side of the centre is not known, all ends are flagged with `EDGE_UNKNOWN`.
    """
    prior = Prior(assumptions=assumptions)
    with np.errstate(all="ignore"):  # fits that diverge are rejected by their values
        measured = measurements_of(points, rig, camera=camera)
        best = decision(measured, prior, labelled=points.labelled, edges_named=points.opposite is not None)
    if best is not None and straight(*best.estimate.curvature_alone):
        return BreakPointsOnRing(NoBreakPoints.STRAIGHT_EDGES, ())
    if best is not None and best.edges_exchanged:
        points = points.with_edges_exchanged()
    if best is None or not best.side_known:
        unknown = np.where(points.seen.any(axis=1, keepdims=True), int(BreakPointFlag.EDGE_UNKNOWN), 0)
        points = replace(points, flags=points.flags | unknown)
    clear = best is not None and not best.competing and Finding.UNEXPLAINED not in best.findings
    rejected = tuple(each for each in best.rejected if each.what in ("point", "stripe")) if best and clear else ()
    kept = _without(points, [each for each in rejected if not each.opposite], rig)
    if points.opposite is not None:
        beyond = [each for each in rejected if each.opposite or each.what == "stripe"]
        kept = replace(kept, opposite=_without(points.opposite, beyond, rig))
    return BreakPointsOnRing(kept, rejected, _judged_ring(best, measured) if best and clear else None)


def _without(points: BreakPoints, rejected: Sequence[Rejection], rig: Rig) -> BreakPoints:
    """The break points without rejected ones, which are flagged as occluded, and without the lines of such stripes."""
    left_out = np.zeros(points.flags.shape, dtype=bool)
    for each in rejected:
        laser = rig.lasers.names.index(each.laser or "")
        left_out[laser, slice(None) if each.edge is None else EDGES.index(each.edge)] = True
    without_line = np.isin(rig.lasers.names, [each.laser or "" for each in rejected if each.what == "stripe"])
    flags = points.flags | np.where(left_out, int(BreakPointFlag.OCCLUDED), 0)
    return replace(points, flags=flags).without(left_out, without_line)


def _judged_ring(best: Explanation, measured: Measurements) -> JudgedRing | None:
    """The ring of an explanation, with inner and outer edge as named by it; None if it depends on weak priors."""
    if best.estimate.prior.regularize_about is not None:
        return None
    arcs, rates = best.estimate.arcs, best.estimate.rates
    if best.edges_exchanged and best.measured is measured:  # it was estimated with the edges as they were given
        arcs = arcs.with_center_opposite()
    return JudgedRing(
        origin_m=arcs.origin,
        axes=arcs.axes,
        curvature_per_m=arcs.curvature,
        half_band_m=arcs.half_band_m,
        velocity_m_s=rates.velocity_m_s,
        rate_rad_s=rates.rate_rad_s,
        stamp_s=best.measured.reference_s if math.isfinite(best.measured.reference_s) else None,
    )


def ends_clear(points: BreakPoints) -> bool:
    """Whether enough ends are clear edges, as many as one stripe has.

    At the end of an apparent face on foil, a stripe fades or continues: of false detections on foil one in five has so
    many, and rings even before bright foil.
    """
    clear = sum(int((arc.seen & (arc.flags & int(BreakPointFlag.UNCLEAR) == 0)).sum()) for arc in points.arcs)
    seen = sum(int(arc.seen.sum()) for arc in points.arcs)
    return clear >= min(len(EDGES), seen)


class Ends(NamedTuple):
    """The ends of the stripes on the ring's rim, left, then right; NaN where none was found."""

    position_px: Float64[Array, "laser end=2 xy=2"]
    """Ends in the distorted image."""
    covariance_px2: Float64[Array, "laser end=2 xy=2 xy=2"]
    flags: Int64[Array, "laser end=2"]
    straight_px: Float64[Array, "laser end=2 xy=2"]
    """The segments' own ends, in the undistorted image."""
    straight_sigma_px: Float64[Array, "laser end=2"]
    """Standard deviations of the ordinates of the segments' lines at these ends."""


def _ends(face: Face, images: Sequence[LaserImage], rig: Rig, saturation_dn: int) -> Ends:
    """The ends of the segments on the face, each measured in the image that shows the segment's stripe."""
    shown = [[number for number, laser in enumerate(face.lasers) if laser in image.lasers] for image in images]
    order = [number for numbers in shown for number in numbers]
    lit = [
        LitLines(image.lit, image.dark, face.segments[numbers][:, LINE])
        for image, numbers in zip(images, shown, strict=True)
        if numbers
    ]
    ends = stripe_ends(lit, lens(rig.camera), EndParams(saturation_dn=saturation_dn))
    lasers = [face.lasers[number] for number in order]
    if face.crossing_sine is not None:
        ends = _not_grazing(ends, face.crossing_sine[order])
    return flagged_ends(face.segments[order], ends, lasers, rig)


def _not_grazing(
    ends: Float64[Array, "segment end=2 column=10"], crossing_sine: Float64[Array, "segment end=2"]
) -> Float64[Array, "segment end=2 column=10"]:
    """The ends, NaN where a stripe grazes its edge, so that the fall along it is longer than the columns of the fit.

    An edge that a stripe with the section sigma s crosses at the angle a is met over 4 s / tan(a) columns.
    """
    section = ends[..., END_COLUMNS.index("section_sigma")]
    cosine = np.sqrt(np.maximum(1.0 - crossing_sine**2, 0.0))
    grazing = 4.0 * section * cosine > (INSIDE_COLUMNS + OUTSIDE_COLUMNS) * crossing_sine
    return np.where(grazing[..., None] & np.isin(END_COLUMNS, ("x", "y")), np.nan, ends)


# Positions of the ends, by the compiled loops of kernels/ends

FACET_SIGMAS = 6.0
"""Correlation length of the surface texture along a stripe, in sigmas of its cross-section: finer texture averages out
across the stripe."""


BEYOND_COLUMNS = 40
"""Columns beyond a segment in which its end is searched, and the stripe on a surface that hides it."""


@kernel_record
@dataclass(frozen=True, slots=True, kw_only=True)
class EndParams:
    """Parameters of the endpoint search. The face is the part of the stripe on the ring's rim."""

    saturation_dn: int
    beyond_columns: int = BEYOND_COLUMNS
    inside_columns: int = INSIDE_COLUMNS
    outside_columns: int = OUTSIDE_COLUMNS
    flank_sigmas: float = 3.0
    """Half height of the evaluated window about the line, in sigmas of the cross-section."""
    flanks_share: float = 0.6
    """Share of columns with a saturated pixel above which the amplitude is measured on the flanks only."""
    undimmed_level: float = 0.6
    """A stripe continues while its level stays above this share of the face's: on a wall beyond a kink it is lower."""
    min_headroom: float = 0.05
    """Smallest visible share by which the amplitude of a saturated column is divided."""
    min_noise: float = MIN_NOISE
    shape_sigma: float = 0.005
    """Standard deviation, in columns, of the position due to the model of the blur; added to that by noise."""
    texture_factor: float = 1.5
    """Factor from the residual of a column's cross-section to the error of its amplitude, on crinkled foil: 1.4 to
    1.75."""
    facet_sigmas: float = FACET_SIGMAS
    near_columns: float = 9.0
    """Columns beyond the edge in which the fitted level is required; farther out a stripe on the body may begin."""
    width_spread: float = WIDTH_SPREAD
    blunt_gain: float = AGREEMENT
    """Gain in log likelihood, over all ends of an edge, by widths larger than the cross-section's, above which ends are
    blunt: optics do not blur more along a stripe than across it, so that the edge is chamfered or worn."""
    clipped_shape: float = 0.45
    """Relative error of the shape of a saturated edge: its visible foot is not that of a Gaussian blur, since speckle
    is clipped, too, and light on a wall or glare adds to it."""


END_COLUMNS, LINE_COLUMNS = column_names("StripeEnd"), column_names("StripeLine")
"""Columns of an end (ends.c), and of a line whose ends are searched (profile.h)."""


class LitLines(NamedTuple):
    """Lines whose stripes an image shows."""

    lit: UInt[Array, "row column"]
    dark: UInt[Array, "row column"] | None
    """The view with these lasers off."""
    lines: Float64[Array, "segment column=5"]
    """`LINE_COLUMNS`, in undistorted pixels."""


def stripe_ends(images: Sequence[LitLines], lens: Lens, params: EndParams) -> Float64[Array, "segment end=2 column=10"]:
    """Left and right end of the stripe on each line of the images in turn, to a fraction of a column.

    The amplitude of the Gaussian cross-section in each column is modelled as a level inside, a level outside and an
    error function between; position, width and levels are estimated by maximum likelihood. What the images of a shot
    have in common, noise, speckle and the width of the blur, is estimated from all ends. Columns of the result
    (`END_COLUMNS`): x, y and slope of the line there (distorted pixels), sigma along x, the level outside as a share of
    that inside, the share of saturated columns at the end, the edge's width, the sigma of the cross-section, whether
    the edge is blunt, and the relative variance of the amplitudes due to the background; NaN where no edge fits.
    """
    arrays = tuple(
        (
            np.ascontiguousarray(image.lit),
            None if image.dark is None else np.ascontiguousarray(image.dark),
            np.ascontiguousarray(image.lines),
        )
        for image in images
    )
    return np.frombuffer(_kernels.ends(arrays, lens, params)).reshape(-1, 2, len(END_COLUMNS))


# Standard deviations and flags of the ends

SHARED_WEIGHT, MAX_DECREASE = 0.75, 0.3
"""Weight of all stripes of a shot in the scatter of one, and the largest decrease of its logarithm by the others.

Surface, lens and speckle are the same for all stripes of a shot, and the scatter of 40 correlated columns is uncertain
by a third. That of a single stripe may be larger, on textured background.
"""


def flagged_ends(
    segments: Float64[Array, "segment column=12"],
    measured: Float64[Array, "segment end=2 column=10"],
    lasers: list[int],
    rig: Rig,
) -> Ends:
    """The ends of segments, each of a different laser of the rig, with covariances and flags.

    `measured` is the result of `stripe_ends`. The error along the line is that of the edge; the error across is that of
    the line: the scatter of the segment's centres, pooled over the segments, divided by the root of the number of
    independent columns, and errors that all its centres have in common. The background shifts a centre by the relative
    change of the amplitude times the section's sigma; a saturated centre errs by `CLIPPED_PHASE`.
    """
    ends = dict(zip(END_COLUMNS, measured.transpose(2, 1, 0), strict=True))
    x, y, slope, along, width = ends["x"], ends["y"], ends["slope"], ends["sigma"], ends["width"]
    outside, saturated, blunt = ends["outside"], ends["saturated"], ends["blunt"] == 1
    (section, _), (background, _) = ends["section_sigma"], ends["background"]
    count, start, end = segments[:, CENTERS], segments[:, X_START], segments[:, X_END]
    with np.errstate(divide="ignore", invalid="ignore"):  # a scatter of 0; ends that were not found
        error = np.log(segments[:, SCATTER] * np.sqrt(segments[:, CORRELATION]))
        pooled = SHARED_WEIGHT * (np.average(error, weights=count) - error)
        scatter = segments[:, SCATTER] * np.exp(np.where(np.isfinite(pooled), np.maximum(pooled, -MAX_DECREASE), 0.0))
        used = fitted_columns(count) / np.maximum(count, 1)
        independent = used * count / segments[:, CORRELATION] - FIT_DOF_CORRECTION / math.sqrt(len(segments))
        middle = scatter / np.sqrt(np.maximum(independent, MIN_SEGMENT_COLUMNS))
        # the fitted line absorbs coarser texture, which the centres' scatter does not show
        facets = np.maximum(count / (FACET_SIGMAS * section), 1)
        middle = np.fmax(middle, section * np.sqrt(background / facets))
        clipped = (saturated > SATURATED_SHARE).any(axis=0)
        rows = np.maximum(np.abs(segments[:, SLOPE]) * (end - start), 1)
        shared = np.where(clipped, CLIPPED_PHASE / section / rows, 0.0)
        fitted_px = np.maximum(used * (end - start), 1)
        straight_x = np.stack([start, end])
        # standard deviations of the line's ordinate at the measured ends and at its own
        at_ends, at_own = (
            np.hypot(np.hypot(middle, tilt_sigma_px(middle, at - segments[:, MIDDLE_X], fitted_px)), shared)
            for at in (x, straight_x)
        )
        inside = (x >= BORDER_PX) & (x <= rig.camera.image_width - 1 - BORDER_PX)
        edge_sigma = np.where(blunt, np.sqrt(np.maximum(along**2 - width**2, 0)), along)
        flags = np.where(saturated > SATURATED_SHARE, int(BreakPointFlag.SATURATED), 0)
        flags |= np.where(outside > KINK_LEVEL, int(BreakPointFlag.KINK), 0)
        flags |= np.where(blunt, int(BreakPointFlag.BLUNT), 0)
        flags |= np.where(edge_sigma > UNCLEAR_PX, int(BreakPointFlag.UNCLEAR), 0)
        flags = np.where(inside, flags, int(BreakPointFlag.CLIPPED))
        covariance = end_covariance_px2(along, at_ends, slope)
    straight_y = line_y_px(segments, straight_x)

    def of_lasers(values: Array, fill: float = np.nan) -> Array:
        """The values, with axes (end, segment, ...), arranged by laser, with axes (laser, end, ...)."""
        table = np.full((len(rig.lasers.names), 2, *values.shape[2:]), fill, values.dtype)
        table[lasers] = values.swapaxes(0, 1)
        return table

    return Ends(
        position_px=of_lasers(np.where(inside[..., None], np.stack([x, y], axis=-1), np.nan)),
        covariance_px2=of_lasers(np.where(inside[..., None, None], covariance, np.nan)),
        flags=of_lasers(flags, 0),
        straight_px=of_lasers(np.stack([straight_x, straight_y], axis=-1)),
        straight_sigma_px=of_lasers(at_own),
    )


def _with_common_bluntness(ends: Ends) -> Ends:
    """The ends, with all ends of an edge flagged as blunt if most of them are: an edge has the same shape all around.

    The variance of the newly flagged ends is then at least the smallest of those found to be blunt.
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
    outside = outside_image(ends.straight_px, MAX_OFFSET["face_start_undistorted_px"], *size)
    straight = np.logical_and(*((ends.straight_sigma_px <= MAX_END_SIGMA_PX) & ~outside).T)
    return Ends(
        position_px=np.where(known[..., None], ends.position_px, np.nan),
        covariance_px2=np.where(known[..., None, None], ends.covariance_px2, np.nan),
        flags=ends.flags | np.where(placed & ~known, int(BreakPointFlag.UNCLEAR), 0),
        straight_px=np.where(straight[:, None, None], ends.straight_px, np.nan),
        straight_sigma_px=np.where(straight[:, None], ends.straight_sigma_px, np.nan),
    )


SATURATED_SHARE = 0.2
"""Share of the last columns with a saturated pixel above which an end is flagged."""

LINE = [SEGMENT_COLUMNS.index(name) for name in LINE_COLUMNS]
"""Columns of a segment that describe its line."""


def beside_occluder(ends: Ends, segments: Float64[Array, "segment column=12"], rig: Rig) -> Bool[Array, "laser end=2"]:
    """Mask of the ends beside which another stripe of the same laser begins that lies in front of the face in space."""
    beside = np.zeros(ends.flags.shape, dtype=bool)
    seen = ~np.isnan(ends.position_px[..., 0])
    # distance, off the face, from each end to the nearer end of each segment
    near_x = segments[:, [X_END, X_START]].T
    outward = (near_x - ends.straight_px[:, :, :1]) * np.array([-1.0, 1.0])[:, None]
    own = (segments[:, LASER] == np.arange(len(seen))[:, None]) | (segments[:, LASER] == UNLABELLED)
    near = seen[..., None] & own[:, None] & (outward > -BEYOND_COLUMNS / 4) & (outward < BEYOND_COLUMNS)
    laser, side, segment = np.nonzero(near)
    known = seen & np.isfinite(ends.straight_px[..., 0])
    if not len(laser) or known.sum() < POINTS_OF_A_PLANE:
        return beside
    x = near_x[side, segment]
    y = line_y_px(segments[segment], x)
    pixels = np.concatenate([ends.straight_px[known], np.stack([x, y], axis=-1)])
    of = np.concatenate([np.nonzero(known)[0], laser])
    points = sheet_points(undistorted_rays(pixels, rig.camera), of, rig)
    face, stripe = np.split(points, [len(points) - len(laser)])
    face = face[np.isfinite(face).all(axis=1)]
    if len(face) < POINTS_OF_A_PLANE:
        return beside
    mean = face.mean(axis=0)
    in_front = (stripe - mean) @ towards_camera(nearest_plane(face)[0], mean) > IN_FRONT_M[0]
    beside[laser[in_front], side[in_front]] = True
    return beside
