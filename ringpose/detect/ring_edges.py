"""The ring's visible edges between and beyond the stripes (ringpose-method(7), section 5 c), tracked from the stripes.

A few stripes close together hardly determine the ring's curvature. Therefore the search begins where the edges are
predicted to about a pixel; the steps found there extend the prediction, until the edges leave the image or are lost.
The ring is fitted to the stripes on the face, their break points and the steps by `ringpose.estimate`.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np

from ringpose.detect.difference_images import BAND_PX, VISIBLE_SHARE
from ringpose.detect.edge_search import (
    ALONG_PX,
    CLOSE_REACH_PX,
    MIN_OF_BOTH,
    NEIGHBOURS,
    EdgeImage,
    EdgeTrace,
    RingFromStripes,
    clear_steps,
    edge_observations,
    edge_trace,
    outside_stripes,
    rays_beside,
    ring_from_stripes,
    stripe_mask,
    tracked_ring,
)
from ringpose.detect.motion import RingMotion, moved_to
from ringpose.detect.rim import parallel_in_front
from ringpose.estimate.explanation import decision
from ringpose.estimate.factors.edges import edges_of
from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.measurements import measurements_of
from ringpose.estimate.ring_estimate import STRIPES_OF_A_PLANE
from ringpose.estimate.solver import ALARM_SIGMAS, CERTAIN_SIGMAS, OUTLIER_SIGMAS
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.least_squares import STD_PER_MAD
from ringpose.geometry.rays import undistorted_rays
from ringpose.geometry.ring import CURVATURE, EDGE_SIGN, RingArcs, edge_distances
from ringpose.geometry.sheets import sheet_points
from ringpose.optics.feature_errors import BLUR_SIGMA_PX, MINIMUM_POINTS, POINT_SIGMA_PX
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.assumptions import Assumptions
from ringpose.types.detection import (
    BreakPointFlag,
    BreakPoints,
    JudgedRing,
    NoBreakPoints,
    RingEdgePoints,
    Stripes,
    joined_edge_points,
)
from ringpose.types.finding import Finding
from ringpose.types.image import Shot
from ringpose.types.plausible import RING_RADIUS_M
from ringpose.types.rig import Rig


class FoundEdges(NamedTuple):
    """The ring's edges, and the evidence of their curvature for the side of the ring's centre."""

    points: RingEdgePoints
    side_sigmas: float
    """Curvature over its standard deviation; negative if inner and outer edge are exchanged."""
    steps: int
    """Number of places along the edges that show a step ..."""
    mostly_visible: bool = True
    """... and whether these are most of the places where the edges are predicted."""
    straight: bool = False
    """Whether they are the edges of something straight."""
    arcs: RingArcs | None = None
    """The ring fitted to these steps and the stripes."""


def straight(curvature: float, sd: float) -> bool:
    """Whether edges of that curvature (1/m, standard deviation `sd`) are too straight for a ring, as those of a bar.

    That is straighter than those of the largest ring that a file may state.
    """
    return (abs(curvature) + ALARM_SIGMAS * sd) * RING_RADIUS_M.highest < 1.0


def curved(curvature: float, sd: float) -> bool:
    """Whether edges of that curvature (1/m, standard deviation `sd`) bend at least as much as the largest ring's."""
    return (abs(curvature) - ALARM_SIGMAS * sd) * RING_RADIUS_M.highest > 1.0


class RingEdges(NamedTuple):
    """The break points, inner and outer edge resolved, and the visible edges."""

    break_points: BreakPoints | NoBreakPoints
    points: RingEdgePoints | None
    missing: bool = False
    """Whether ambient light should show the edges, but they were not found."""


def detect_ring_edges(
    break_points: BreakPoints,
    shot: Shot,
    stripes: Stripes,
    rig: Rig,
    assumptions: Assumptions,
    camera: CameraMotion | None,
    motion: RingMotion | None,
    judged: JudgedRing | None = None,
) -> RingEdges:
    """The visible edges in the frames that show them best, and the break points with inner and outer edge resolved.

    `judged`: the ring by which the break points were judged.

    These are the first and the last frame without lasers, or the first alone if the target is still; without one, the
    frame with the fewest lasers, where places beside the stripes are excluded. Every point has the stamp of its frame.
    """
    frames = [number for number, mask in enumerate(shot.lasers.tolist()) if not mask]
    if not frames:
        frames = [min(range(len(shot.lasers)), key=lambda each: int(shot.lasers[each]).bit_count())]
    still = assumptions.motion is None and camera is None
    frames = frames[:1] if still else sorted({frames[0], frames[-1]})
    saturation_dn = shot.saturation_dn

    def searched(points: BreakPoints, start: JudgedRing | None = None) -> list[FoundEdges]:
        edges = (_edges_in_frame(frame, points, shot, saturation_dn, stripes, rig, motion, start) for frame in frames)
        return [each for each in edges if each is not None]

    edges = searched(break_points, judged)
    lit = any(each.mostly_visible for each in edges)
    if not lit:
        lit = edges_lit(break_points, shot)
        if lit:
            edges = _without_displaced_stripe(edges, break_points, searched, rig, assumptions, camera)
    if not edges:
        return RingEdges(break_points, None, missing=lit)
    if all(each.straight for each in edges):
        return RingEdges(NoBreakPoints.STRAIGHT_EDGES, None)
    return RingEdges(*named_by_curvature(break_points, edges))


def edges_lit(points: BreakPoints, shot: Shot) -> bool:
    """Whether the ring's edges should be visible: two break points of an edge, in ambient light.

    The light is that of the frames without lasers, as the range of the grey values (5 to 95 %, at half size against
    noise) in the box of the break points, which black level and a uniform background do not affect. In 64 rendered
    shots without visible edges it is at most 3 / 255 of the saturation value, in 26 of 27 with edges 13 / 255.
    """
    seen = points.seen
    if int(seen.sum(axis=0).max()) <= 1:
        return False
    position = points.position_px[seen]
    left, top = np.maximum(position.min(axis=0).astype(np.int64) - BAND_PX, 0).tolist()
    right, bottom = (position.max(axis=0).astype(np.int64) + BAND_PX).tolist()
    for image in shot.images[shot.lasers == 0]:
        levels = cv2.pyrDown(image[top:bottom, left:right])
        values = np.iinfo(levels.dtype).max + 1
        counts = cv2.calcHist([levels], [0], None, [values], [0, values]).ravel()  # a tenth of the time of sorting
        tail = levels.size // 20
        low, high = np.searchsorted(counts.cumsum(dtype=np.float64), [tail, levels.size - 1 - tail], side="right")
        if high - low > VISIBLE_SHARE * shot.saturation_dn:
            return True
    return False


MORE_STEPS = 1.5
"""Ratio of the steps found along the edges without one stripe to those with all, from which that stripe is elsewhere.
In 107 rendered shots it is at least 1.8 without a displaced stripe, in 27 at most 1.1 without a right one."""


def _without_displaced_stripe(
    with_all: list[FoundEdges],
    break_points: BreakPoints,
    searched: Callable[[BreakPoints], list[FoundEdges]],
    rig: Rig,
    assumptions: Assumptions,
    camera: CameraMotion | None,
) -> list[FoundEdges]:
    """The edges found without one of the stripes, if these are far more; else `with_all`, those found with all stripes.

    A stripe that is not on the ring, or not where it seems to be, leads the search along another ring, where steps are
    found by chance. The ring of the others leads to the edges, and the estimate rejects the stripe; if it is in front
    of that ring, the others may be on a flange behind the face, the edges of which are visible, too. Of two stripes
    each may be the wrong one, so that no edges count as found.
    """
    least, best = MORE_STEPS * sum(each.steps for each in with_all), with_all
    for laser in np.flatnonzero(break_points.of_lasers).tolist():
        lines = np.arange(len(break_points.flags)) == laser
        without = searched(break_points.without(lines[:, None] & break_points.seen, lines))
        steps = sum(each.steps for each in without)
        if steps > least and not any(_in_front(laser, break_points, each.arcs, rig) for each in without):
            least, best = steps, without
    if best is with_all:
        return with_all
    of_two = np.count_nonzero(break_points.of_lasers) <= STRIPES_OF_A_PLANE
    if of_two or (not with_all and not _contradict(best, break_points, rig, assumptions, camera)):
        return []
    return best


def _in_front(laser: int, break_points: BreakPoints, ring: RingArcs | None, rig: Rig) -> bool:
    """Whether a laser's stripe is on a surface in front of a ring and parallel to it, which may be the ring's face."""
    ends_px = np.stack([break_points.face_start_undistorted_px[laser], break_points.face_end_undistorted_px[laser]])
    ends = sheet_points(undistorted_rays(ends_px, rig.camera), np.array([laser]), rig)
    if ring is None or not np.isfinite(ends).all():
        return False
    return bool(parallel_in_front(ends[None], ring.origin, ring.normal)[0])


def _contradict(
    edges_in_frames: list[FoundEdges],
    break_points: BreakPoints,
    rig: Rig,
    assumptions: Assumptions,
    camera: CameraMotion | None,
) -> bool:
    """Whether no ring explains edges and stripes unless some of them are rejected.

    If edges that agree with all stripes were not found with all of them, they are probably accidental.
    """
    points, edges = named_by_curvature(break_points, edges_in_frames)
    named = not np.any(points.flags & int(BreakPointFlag.EDGE_UNKNOWN))
    prior = Prior(assumptions=assumptions)
    with np.errstate(all="ignore"):  # fits that diverge are rejected by their values
        measured = measurements_of(points, rig, edges, camera=camera)
        best = decision(measured, prior, labelled=points.labelled, edges_named=named)
    return best is None or bool(best.rejected) or Finding.UNEXPLAINED in best.findings


def _edges_in_frame(
    number: int,
    break_points: BreakPoints,
    shot: Shot,
    saturation_dn: int,
    stripes: Stripes,
    rig: Rig,
    motion: RingMotion | None,
    judged: JudgedRing | None,
) -> FoundEdges | None:
    """The edges in one frame, with its stamp, predicted from the stripes of all frames and the ring's motion."""
    image, stamp_s = shot.images[number], shot.mid_exposure_s(number)
    lit = stripe_mask(stripes.position_px, image) if shot.lasers[number] else None
    frame = EdgeImage(image=image, saturation_dn=saturation_dn, lit=lit)
    if motion is not None:
        break_points, rig = moved_to(stamp_s, break_points, rig, motion)
    edges = found_edges(break_points, frame, rig, judged)
    if edges is None:
        return None
    stamps = np.full(len(edges.points.edge), stamp_s)
    return edges._replace(points=replace(edges.points, stamp_s=stamps))


def found_edges(
    break_points: BreakPoints, frame: EdgeImage, rig: Rig, judged: JudgedRing | None = None
) -> FoundEdges | None:
    """Points of the ring's edges, and the significance of which edge is the inner one; None where no edge was found."""
    stripes = ring_from_stripes(break_points, rig, judged)
    tracked = None if stripes is None else tracked_ring(stripes, frame, rig)
    if stripes is None or tracked is None:
        return None
    trace = outside_stripes(frame, edge_trace(*tracked, rig.camera, ALONG_PX, CLOSE_REACH_PX))
    clear = clear_steps(frame, trace, CLOSE_REACH_PX, precise=True)
    refined = stripes.fitted(tracked.arcs, edge_observations(clear, rig))
    if refined is None:
        return None
    points = ring_edge_points(refined.arcs, clear.trace, clear.steps.offset_px, clear.steps.sigma_px)
    if points is None:
        return None
    wider, steps = 1.0, len(clear.trace.edge_sign)
    mostly_visible = 2 * steps >= len(trace.edge_sign)
    if 2 * GROUP * len(points.edge) < len(trace.edge_sign):  # most steps are beside the edges, if any
        wider = uncertainty_factor(points, refined.arcs, stripes, frame, rig)
        if not math.isfinite(wider):
            return None
        points = replace(points, sigma_px=wider * points.sigma_px)
    curvature, curvature_sd = refined.arcs.curvature, wider * math.sqrt(refined.covariance[CURVATURE, CURVATURE])
    if len(stripes.measured.lines.laser) == 1:
        # Its two ends are no evidence for a ring: the edges must be curved. The tilt about the stripe follows from the
        # course of both edges; one alone determines it by curvatures of tenths of a pixel, as large as those by foil.
        both = np.bincount(points.edge, minlength=2).min() >= MIN_OF_BOTH
        if not both or not (curved(curvature, curvature_sd) or straight(curvature, curvature_sd)):
            return None
    return FoundEdges(
        points, curvature / curvature_sd, steps, mostly_visible, straight(curvature, curvature_sd), refined.arcs
    )


STEP_ON_EDGE_PX, DISTINCT_EDGE = 0.35, 7.0
"""Standard deviation of a step on the edge from the ring, and the density of these steps at the edge over that of the
steps of what is behind: a third of the steps are on the edge. Neighbouring steps that differ by less than three of
them are on the border of one facet of foil, and a stretch whose mean is off the ring by more than one is another edge:
the rim of a wall, a chamfer, a shadow."""

OPEN_CURVATURE_PER_M = 0.5
"""Standard deviation of the curvature by the stripes alone from which it is the visible edges that determine it."""

MOSTLY_ON_EDGE, UNCONFIRMED = 0.8, 5.0
"""Share of the steps that must then be on the edges, with `MIN_OF_BOTH` points on either one, and the factor on the
standard deviations if they are not: other edges than the ring's may have been found."""

CURVATURES = np.linspace(-5.0, 5.0, 101)
"""Inverse hyperbolic sines of the alternative curvatures, in standard deviations: close to the one found and far."""


def uncertainty_factor(
    points: RingEdgePoints,
    arcs: RingArcs,
    stripes: RingFromStripes,
    frame: EdgeImage,
    rig: Rig,
) -> float:
    """Factor by which the points' standard deviations are too small if the edges may as well be somewhere else.

    The stripes leave mainly one number of the ring open, its curvature with the centre that follows from it. If most
    steps are on foil as bright as the face, other curvatures explain about as many steps as the one that the tracking
    arrived at. The likelihood of the curvature, with steps on the edge and steps of what is behind (a mixture), shows
    how well it is known; its second moment about the curvature found is the variance that the points must have. The
    steps of a facet's border are one coincidence, however long the border is.

    If the stripes do not determine the curvature, nothing shows that these are edges of the ring, unless most steps are
    on them, and on both; a single one may be any circle, and the factor is infinite.
    """
    covariance = stripes.start.covariance
    confirmed = covariance[CURVATURE, CURVATURE] <= OPEN_CURVATURE_PER_M**2
    of_fewer = int(np.bincount(points.edge, minlength=2).min())
    if not confirmed and of_fewer <= 1:
        return math.inf
    direction = covariance[:, CURVATURE] / math.sqrt(covariance[CURVATURE, CURVATURE])
    edges = edges_of(points, rig.camera)
    at = edge_distances(arcs, edges.ray, 2.0 * edges.edge - 1.0)
    slope = at.wrt_step @ direction / np.einsum("nr,nr->n", at.wrt_ray, edges.step)
    information = float(slope @ np.linalg.solve(np.eye(len(slope)) + edges.common @ edges.common.T, slope))
    trace = outside_stripes(frame, edge_trace(arcs, None, rig.camera, ALONG_PX))
    trace, steps = clear_steps(frame, trace, 2 * CLOSE_REACH_PX, precise=True)
    at = edge_distances(arcs, rays_beside(trace, steps.offset_px), trace.edge_sign)
    residual_px = at.distance_m * trace.edge_sign / trace.metres_per_px
    slope_px = at.wrt_step @ direction * trace.edge_sign / trace.metres_per_px
    mostly_on_edge = np.count_nonzero(np.abs(residual_px) < 2.0 * STEP_ON_EDGE_PX) >= MOSTLY_ON_EDGE * len(residual_px)
    confirmed = confirmed or (mostly_on_edge and of_fewer >= MIN_OF_BOTH)
    away = np.sinh(CURVATURES) / math.sqrt(information)
    on_edge = np.exp(-0.5 * ((residual_px + away[:, None] * slope_px) / STEP_ON_EDGE_PX) ** 2)
    neighbours = (np.diff(trace.number) == 1) & (np.diff(trace.edge_sign) == 0)
    other_facet = ~neighbours | (np.abs(np.diff(residual_px)) > ALARM_SIGMAS * STEP_ON_EDGE_PX)
    facets_per_step = (1 + np.count_nonzero(other_facet)) / max(len(residual_px), 1)
    logarithm = facets_per_step * np.log1p(DISTINCT_EDGE * on_edge).sum(axis=1)
    weight = np.exp(logarithm - logarithm.max()) * np.cosh(CURVATURES)
    variance = float(weight @ away**2 / weight.sum())
    if not math.isfinite(variance):
        return math.inf
    return max(1.0, math.sqrt(variance * information)) * (1.0 if confirmed else UNCONFIRMED)


def named_by_curvature(break_points: BreakPoints, edges: Sequence[FoundEdges]) -> tuple[BreakPoints, RingEdgePoints]:
    """Break points and edge points of all frames; inner and outer edge by the most significant curvature if unknown.

    What lies beside the edges, and with it most of their errors, is the same in every frame: the standard deviations
    are raised so that several frames of a ring at rest determine the ring no better than one.
    """
    parts = [replace(each.points, sigma_px=math.sqrt(len(edges)) * each.points.sigma_px) for each in edges]
    points = parts[0] if len(parts) == 1 else joined_edge_points(parts)
    side_sigmas = max((each.side_sigmas for each in edges), key=lambda each: np.nan_to_num(abs(each)))
    unknown = int(BreakPointFlag.EDGE_UNKNOWN)
    if not np.any(break_points.flags & unknown) or not abs(side_sigmas) >= CERTAIN_SIGMAS:
        return break_points, points
    named = replace(break_points, flags=break_points.flags & ~unknown)
    if side_sigmas > 0:
        return named, points
    return named.with_edges_exchanged(), replace(points, edge=1 - points.edge)


# Steps -> independent points of the ring's edges, with standard deviations that explain their scatter.
# The sigma of a single step only ranks it among its neighbours. The actual errors (facets of foil, walls and shadows
# beside the edge) are estimated from the scatter of neighbouring steps about the fitted ring.

GROUP = 3
"""Neighbouring steps that are averaged into one point: 12 px, about the largest facet of crinkled foil."""


class _Points(NamedTuple):
    number: Float64[Array, "n"]
    edge_sign: Float64[Array, "n"]
    """-1 on the inner edge, +1 on the outer."""
    position_px: Float64[Array, "n xy=2"]
    normal: Float64[Array, "n xy=2"]
    residual_px: Float64[Array, "n"]
    """Distance off the face, along the normal, from the edge of the fitted ring."""
    sigma_px: Float64[Array, "n"]

    def selected(self, which: Bool[Array, "n"]) -> "_Points":
        return _Points(*(part[which] for part in self))


def ring_edge_points(
    arcs: RingArcs, trace: EdgeTrace, offset_px: Float64[Array, "n"], sigma_px: Float64[Array, "n"]
) -> RingEdgePoints | None:
    """Points of the ring near `arcs`, from steps at these offsets from the places of a trace; None for too few."""
    position = trace.position_px + offset_px[:, None] * trace.normal
    distances = edge_distances(arcs, rays_beside(trace, offset_px), trace.edge_sign)
    residual_px = trace.edge_sign * distances.distance_m / trace.metres_per_px
    steps = _Points(
        trace.number, trace.edge_sign, position, trace.normal, residual_px, np.hypot(sigma_px, BLUR_SIGMA_PX)
    )
    steps = steps.selected(~_displaced(steps))
    steps = _inliers(steps._replace(sigma_px=steps.sigma_px * _scale(steps)))
    points = _grouped(steps)
    # The blur error is common to the steps of a group, so that averaging does not reduce it.
    points = points._replace(sigma_px=np.hypot(points.sigma_px, BLUR_SIGMA_PX))
    points = _inliers(points._replace(sigma_px=points.sigma_px * np.maximum(_scale(points), 1.0)))
    known = points.sigma_px < POINT_SIGMA_PX
    if np.count_nonzero(known) < MINIMUM_POINTS:
        return None
    return RingEdgePoints(
        position_px=points.position_px[known],
        normal=points.normal[known],
        sigma_px=points.sigma_px[known],
        edge=(points.edge_sign[known] > 0).astype(np.int64),
    )


def _displaced(points: _Points) -> Bool[Array, "n"]:
    """Which points lie in a stretch that is off the ring as a whole, by more than its own scatter."""
    displaced = np.zeros(len(points.edge_sign), dtype=bool)
    for here in _edges(points):
        near = _stretches(points.residual_px[here])
        middle = near.mean(axis=-1)
        variance = np.einsum("ij,ij->i", near, near) / near.shape[1] - middle**2
        displaced[here] = (np.abs(middle) > STEP_ON_EDGE_PX) & (middle**2 > variance)
    return displaced


def _inliers(points: _Points) -> _Points:
    """The points that are not outliers; in the scatter, their distance is clipped to the same number of sigmas."""
    return points.selected(np.abs(points.residual_px) < OUTLIER_SIGMAS * points.sigma_px)


def _scale(points: _Points) -> Float64[Array, "n"]:
    """Root mean square of the whitened residuals over a stretch of the same edge, outliers clipped."""
    scale = np.ones(len(points.edge_sign))
    deviation = np.abs(points.residual_px / points.sigma_px)
    for here in _edges(points):
        near = _stretches(deviation[here])
        median = np.sort(near, axis=-1)[:, near.shape[1] // 2, None]
        near = np.minimum(near, OUTLIER_SIGMAS * STD_PER_MAD * median)
        squares = np.einsum("ij,ij->i", near, near)
        scale[here] = np.sqrt((squares + squares.mean()) / (2 * near.shape[1]))  # of both: a few may agree by chance
    return np.maximum(scale, 1e-3)


def _grouped(steps: _Points) -> _Points:
    """Weighted means of neighbouring steps, along the inner edge first."""
    key = np.floor(steps.number / GROUP)
    begins = np.append(True, (np.diff(key) != 0) | (np.diff(steps.edge_sign) != 0))[: len(key)]
    group = np.cumsum(begins) - 1
    weight = steps.sigma_px**-2
    total = np.bincount(group, weight)
    columns = (steps.number, steps.edge_sign, steps.residual_px, *steps.position_px.T, *steps.normal.T)
    means = [np.bincount(group, weight * values) / total for values in columns]
    number, edge_sign, residual_px = means[:3]
    position, normal = np.stack(means[3:5], axis=-1), np.stack(means[5:], axis=-1)
    normal /= np.hypot(*normal.T)[:, None]
    return _Points(number, edge_sign, position, normal, residual_px, total**-0.5)


def _edges(points: _Points) -> list[Int64[Array, "m"]]:
    """Indices of the points on the inner and on the outer edge, of each edge that has at least two."""
    edges = [np.flatnonzero(points.edge_sign == sign) for sign in EDGE_SIGN]
    return [here for here in edges if len(here) > 1]


def _stretches(values: Float64[Array, "n"]) -> Float64[Array, "n near"]:
    """The values of the neighbours of each point, mirrored at the ends."""
    half = min(NEIGHBOURS, len(values)) // 2
    mirrored = np.concatenate([values[half - 1 :: -1], values, values[: -half - 1 : -1]])
    near: Float64[Array, "n near"] = mirrored[np.arange(len(values))[:, None] + np.arange(2 * half + 1)]
    return near
