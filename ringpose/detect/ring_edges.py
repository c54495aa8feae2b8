"""The ring's visible edges between and beyond the stripes (ringpose-method(7), section 5 c), tracked from the stripes.

A few stripes close together hardly determine the ring's curvature. Therefore the search begins where the edges are
predicted to about a pixel; the steps found there extend the prediction, until the edges leave the image or are lost.
The model is two arcs about one centre (`ringpose.geometry.ring_arcs`), fitted by robust least squares to the stripes on
the face, their break points and the steps.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ringpose.detect.edge_points import ring_edge_points
from ringpose.detect.edge_search import (
    ALONG_PX,
    EdgeImage,
    EdgeTrace,
    edge_observations,
    edge_profiles,
    edge_steps,
    edge_trace,
    estimated_blur_px,
    outside_stripes,
    significant_steps,
    steps_along,
    stripe_mask,
)
from ringpose.geometry.planes import towards_camera
from ringpose.geometry.rays import intersect, rays, undistorted_rays
from ringpose.geometry.ring_arcs import STATE, RingArcs, moved
from ringpose.kernels import edges as kernels
from ringpose.kernels.edges import FitParams, PlanePoints, Sights
from ringpose.types.arrays import Array, Float64
from ringpose.types.detection import BreakPointFlag, BreakPoints, RingEdgePoints, Stripes
from ringpose.types.image import Shot
from ringpose.types.rig import Rig

PREDICTED_SIGMA_PX = 1.3
"""Edges are searched where the standard deviation of their prediction is at most this."""

REACH_PX = 2
"""Half width of the search across the predicted edge, after the tracking."""

ONE_STRIPE = 2
"""Number of plane points on a single stripe. The tilt of the face about it follows from the course of both edges; a
single edge determines it only by curvatures of tenths of a pixel, to which foil beside it contributes as much."""

MIN_OF_BOTH = 8
"""Minimum number of points on either edge in that case."""

SIDE_SIGMAS = 4.0
"""Minimum significance of the edges' curvature from which the side of the ring's centre is inferred."""

CURVATURE, TURN = STATE.index("curvature"), STATE.index("turn_rad")


class FoundEdges(NamedTuple):
    """The ring's edges, and the evidence of their curvature for the side of the ring's centre."""

    points: RingEdgePoints
    side_sigmas: float
    """Curvature over its standard deviation; negative if inner and outer edge are exchanged."""


def detect_ring_edges(
    break_points: BreakPoints, shot: Shot, stripes: Stripes, rig: Rig
) -> tuple[BreakPoints, RingEdgePoints | None]:
    """The edges in the frame of a shot that shows them best, and the break points, with inner and outer edge resolved.

    That frame is the first one without lasers; without one, that with the fewest, where places beside the stripes are
    excluded.
    """
    number = min(range(len(shot.lasers)), key=lambda each: int(shot.lasers[each]).bit_count())
    image = shot.images[number]
    lit = stripe_mask(stripes.position_px, image) if shot.lasers[number] else None
    found = found_edges(break_points, EdgeImage(image=image, saturation_dn=shot.saturation_dn, lit=lit), rig)
    if found is None:
        return break_points, None
    named, points = named_by_curvature(break_points, found)
    return named, replace(points, stamp_s=np.full(len(points.edge), shot.mid_exposure_s(number)))


def found_edges(break_points: BreakPoints, frame: EdgeImage, rig: Rig) -> FoundEdges | None:
    """Points of the ring's edges, and the significance of their names; None where no edge was found."""
    evidence = stripe_evidence(break_points, rig)
    tracked = None if evidence is None else tracked_arcs(evidence, frame, rig)
    if evidence is None or tracked is None:
        return None
    arcs, covariance = tracked
    trace = outside_stripes(frame, edge_trace(arcs, covariance, rig, ALONG_PX, PREDICTED_SIGMA_PX))
    profiles = edge_profiles(frame.image, trace.position_px, trace.normal, REACH_PX, frame.saturation_dn)
    steps = edge_steps(profiles, REACH_PX, estimated_blur_px(profiles, REACH_PX))
    arcs, covariance = fitted_arcs(arcs, evidence, edge_observations(trace, steps))
    clear = significant_steps(steps)
    points = ring_edge_points(arcs, trace.selected(clear), steps.offset_px[clear], steps.sigma_px[clear])
    if points is None:
        return None
    if len(evidence.plane.point) == ONE_STRIPE and np.bincount(points.edge, minlength=2).min() < MIN_OF_BOTH:
        return None
    return FoundEdges(points, arcs.curvature / float(np.sqrt(covariance[CURVATURE, CURVATURE])))


def named_by_curvature(break_points: BreakPoints, found: FoundEdges) -> tuple[BreakPoints, RingEdgePoints]:
    """Break points and edge points; inner and outer edge are resolved by the curvature if the break points cannot."""
    unknown = int(BreakPointFlag.EDGE_UNKNOWN)
    if not np.any(break_points.flags & unknown) or not abs(found.side_sigmas) >= SIDE_SIGMAS:
        return break_points, found.points
    named = replace(break_points, flags=break_points.flags & ~unknown)
    if found.side_sigmas > 0:
        return named, found.points
    return named.with_edges_exchanged(), replace(found.points, edge=1 - found.points.edge)


# Tracking

ROUNDS = 10
"""Maximum number of tracking rounds; each extends the tracked length about twofold."""

FARTHER = 1.05
"""Minimum growth of the tracked length in a round; tracking stops with less."""

WALK_SPACING_PX, WALK_REACH_PX = 12, 4
"""Spacing of the places while tracking, and half width of the search across the edge."""

FIRST_SPACING_PX, FIRST_REACH_PX, FIRST_PX = 4, 2, 600
"""The same while less than `FIRST_PX` of both edges are predicted: there are few steps, so that none is left out, and a
wide search would find more steps of foil than the fit could reject."""

MIN_SHARE = 0.05
"""Minimum share of the predicted places that show a step."""

OPEN_TURN_SIGMA_RAD = 0.2
"""Standard deviation of the edges' direction above which it is first searched in the image."""


def tracked_arcs(
    evidence: "StripeEvidence", frame: EdgeImage, rig: Rig
) -> tuple[RingArcs, Float64[Array, "state=7 state=7"]] | None:
    """The ring's edges as far as they can be tracked from the stripes, and their covariance; None if they cannot."""
    params = FIT_PARAMS._replace(rounds=5, outlier_sigmas=np.inf)
    arcs, covariance = fitted_arcs(evidence.start, evidence, NO_OBSERVATIONS, params)
    if covariance[TURN, TURN] > OPEN_TURN_SIGMA_RAD**2:
        beside = edges_beside_stripe(arcs, frame, rig)
        arcs, covariance = fitted_arcs(arcs, evidence, beside, FIT_PARAMS._replace(rounds=4))
    tracked_px = 0.0
    for _ in range(ROUNDS):
        if not plausible(arcs):
            return None
        first = tracked_px < FIRST_PX
        spacing_px, reach_px = (FIRST_SPACING_PX, FIRST_REACH_PX) if first else (WALK_SPACING_PX, WALK_REACH_PX)
        trace = edge_trace(arcs, covariance, rig, spacing_px, PREDICTED_SIGMA_PX)
        if len(trace.side) * spacing_px <= tracked_px * FARTHER:
            break
        tracked_px = len(trace.side) * spacing_px
        trace = outside_stripes(frame, trace)
        observations = edge_observations(trace, steps_along(frame, trace, reach_px))
        if len(observations.side) < MIN_SHARE * len(trace.side):
            return None
        arcs, covariance = fitted_arcs(arcs, evidence, observations)
    return arcs, covariance


# Direction of the edges at a single stripe, which its two ends leave open

TURNS_RAD = np.linspace(-0.75, 0.75, 51)
"""Candidate angles between the stripe's normal on the face and the edges."""

MIN_NUMBER, MAX_NUMBER = 2, 9
"""Range of the places examined on each edge, counted from the stripe to each side ..."""

SPACING_PX = 6.0
"""... and their spacing: so near the stripe the edges are straight."""

START_REACH_PX = 2
"""Half width of the search across a candidate edge."""

MIN_STEPS = 5
"""Minimum number of places that show a step ..."""

DISTINCT, SIMILAR = 2, 6
"""... and its minimum ratio to that of any direction that is not among the next `SIMILAR` ones."""


def edges_beside_stripe(arcs: RingArcs, frame: EdgeImage, rig: Rig) -> Sights:
    """Steps along the two straight edges through a stripe's ends that the image supports best; empty if none does."""
    unit_turn = np.eye(len(STATE))[TURN]
    certain = np.zeros((len(STATE), len(STATE)))
    tables = []
    for direction, turn_rad in enumerate(TURNS_RAD):
        trace = edge_trace(moved(arcs, turn_rad * unit_turn), certain, rig, SPACING_PX, np.inf, MAX_NUMBER)
        table = trace.table[np.abs(trace.number) >= MIN_NUMBER]
        table[:, -1] = direction
        tables.append(table)
    trace = outside_stripes(frame, EdgeTrace(np.concatenate(tables)))  # its `number` is the candidate direction

    steps = steps_along(frame, trace, START_REACH_PX)
    count = np.bincount(trace.number.astype(np.int64), significant_steps(steps), minlength=len(tables))
    best = int(np.argmax(count))
    elsewhere = np.delete(count, slice(max(best - SIMILAR, 0), best + SIMILAR + 1))
    if count[best] < max(MIN_STEPS, DISTINCT * elsewhere.max()):
        return NO_OBSERVATIONS
    trace = trace.selected(trace.number == best)
    return edge_observations(trace, steps_along(frame, trace, START_REACH_PX))


# Robust least-squares fit of the arcs

TILT_SIGMA_RAD = 0.4
"""Prior sigma of the ring's tilt against the image plane; the stripes determine all directions but one far better."""

TURN_SIGMA_RAD = 0.6
"""Prior sigma of the angle between the stripes on the face and the radius."""

CURVATURE_SIGMA = 2.5
"""Prior sigma of the curvature in 1/m: adapter rings have radii of 0.4 to 1.5 m, and the centre is on either side."""

HALF_BAND_M = (0.018, 0.008)
"""Prior mean and sigma of half the band's width; bands are 20 to 60 mm wide."""

LINE_SIGMA_PX = 0.1
"""Calibration error that is added to the sigma of a stripe's line, across the line."""

END_SIGMA_PX = 0.4
"""Error of calibration and material that is added to the sigma of a break point."""

MAX_SIGMA_IN_ARC_FIT_PX = 1.5
"""Upper limit of a break point's sigma in this fit, so that two uncertain ones still predict the edge; the steps found
there then confirm or contradict them."""

POSSIBLE = ((0.03, 5.0), (0.001, 0.1), (0.1, 1.1), (-1.0, 10.0))
"""Limits of depth and half band in metres, of the cosine between normal and optical axis, of |curvature| in 1/m."""

MAX_STEP = (0.5, 0.5, 0.2, 0.2, 0.5, 3.0, 0.02)
"""Largest change of each component of the state in one iteration, beyond which the linearization is not valid."""

OUTLIER_SIGMAS = 3.0
"""Residual beyond which an observation is weighted down, by the fourth power of the residual."""

FIT_PARAMS = FitParams(
    rounds=2,
    outlier_sigmas=OUTLIER_SIGMAS,
    tilt_sigma_rad=TILT_SIGMA_RAD,
    turn_sigma_rad=TURN_SIGMA_RAD,
    curvature_sigma=CURVATURE_SIGMA,
    half_band_m=HALF_BAND_M[0],
    half_band_sigma_m=HALF_BAND_M[1],
    max_step=MAX_STEP,
)

NO_OBSERVATIONS = Sights(np.zeros((0, 3)), np.zeros(0), np.zeros(0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class StripeEvidence:
    """The observations from the stripes alone: points of the ring's plane, and the break points."""

    plane: PlanePoints
    ends: Sights
    start: RingArcs
    """Initial guess, and the frame of the priors: facing the camera, straight."""


def stripe_evidence(break_points: BreakPoints, rig: Rig) -> StripeEvidence | None:
    """The evidence in the break points; None without a stripe's line on the face and one end on each edge."""
    lasers = np.flatnonzero(np.isfinite(break_points.face_start_px[:, 0]))
    line_px = np.stack([break_points.face_start_px, break_points.face_end_px], axis=1)[lasers]
    plane_point = _on_light_plane(undistorted_rays(line_px, rig.camera), lasers, rig)
    moved_point = _on_light_plane(undistorted_rays(line_px + np.array([0.0, 1.0]), rig.camera), lasers, rig)
    in_space = np.isfinite(plane_point + moved_point).all(axis=(1, 2))
    lasers, plane_point, moved_point = lasers[in_space], plane_point[in_space], moved_point[in_space]
    position = _on_light_plane(rays(break_points.position_px, rig.camera), np.arange(len(break_points.flags)), rig)
    seen = np.isfinite(position[..., 0])
    if not len(lasers) or not seen.any(axis=0).all():
        return None
    position, side = position[seen], np.broadcast_to([1.0, -1.0], seen.shape)[seen]
    start = _facing(plane_point, position, side)
    if not plausible(start):
        return None
    line_sigma_px = np.hypot(break_points.face_sigma_px[lasers], LINE_SIGMA_PX)
    end_sigma_px = np.hypot(np.sqrt(break_points.covariance_px2[seen][:, 0, 0]), END_SIGMA_PX)
    end_sigma_px = np.minimum(end_sigma_px, MAX_SIGMA_IN_ARC_FIT_PX)
    return StripeEvidence(
        plane=PlanePoints(
            point=plane_point.reshape(-1, 3),
            sigma_m=(np.abs((moved_point - plane_point) @ start.axes[2]) * line_sigma_px).ravel(),
        ),
        ends=Sights(ray=position, side=side, sigma_m=end_sigma_px * position[:, 2] / rig.camera.camera_matrix[0, 0]),
        start=start,
    )


def _on_light_plane(ray: Float64[Array, "laser k xyz=3"], lasers: Array, rig: Rig) -> Float64[Array, "laser k xyz=3"]:
    return intersect(ray, rig.lasers.normal[lasers][:, None], rig.lasers.distance_m[lasers][:, None])


def _facing(
    lines: Float64[Array, "laser end=2 xyz=3"], ends: Float64[Array, "n xyz=3"], side: Float64[Array, "n"]
) -> RingArcs:
    """Straight edges across the stripes, on a plane that faces the camera as far as the stripes' direction allows."""
    along = (lines[:, 1] - lines[:, 0]).sum(axis=0)
    along /= np.linalg.norm(along)
    middle = lines.mean(axis=(0, 1))
    position = (ends - middle) @ along
    inner, outer = position[side > 0].mean(), position[side < 0].mean()
    across = along if inner > outer else -along
    origin = middle + (inner + outer) / 2 * along
    normal = towards_camera(origin - (origin @ across) * across, origin)
    normal /= np.linalg.norm(normal)
    return RingArcs(
        origin=origin,
        axes=np.stack([across, np.cross(normal, across), normal]),
        curvature=0.0,
        half_band_m=abs(inner - outer) / 2,
    )


def fitted_arcs(
    arcs: RingArcs, evidence: StripeEvidence, edges: Sights, params: FitParams = FIT_PARAMS
) -> tuple[RingArcs, Float64[Array, "state=7 state=7"]]:
    """The arcs after some Gauss-Newton iterations from `arcs`, and the covariance of their state."""
    observations = Sights(*(np.concatenate(both) for both in zip(evidence.ends, edges, strict=True)))
    return kernels.fitted_arcs(arcs, evidence.plane, observations, evidence.start.axes, params)


def plausible(arcs: RingArcs) -> bool:
    """Whether a ring in front of a camera can have these arcs; a fit of contradictory observations may not."""
    numbers = [arcs.origin[2], arcs.half_band_m, -arcs.axes[2, 2], abs(arcs.curvature)]
    return all(low < number < high for number, (low, high) in zip(numbers, POSSIBLE, strict=True))
