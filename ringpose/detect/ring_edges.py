"""The ring's visible edges between and beyond the stripes (method(7), section 5 c), followed from the break points.

Stripes close together hardly tell the ring's curvature: the search begins where the edges are predicted to a
pixel, and what is found there predicts them farther on, until the image ends or the edge is lost.

The direction of the ring's edges at a single stripe, which its two ends leave open.

Single steps of brightness -> independent points of the ring's edges, with sigmas that explain their scatter.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ringpose.detect.edge_search import (
    ALONG_PX,
    BLUR_PX,
    EdgeImage,
    EdgeTrace,
    Profiles,
    beyond_px,
    chosen,
    clear_of_stripes,
    edge_observations,
    edge_profiles,
    edge_steps,
    edge_trace,
    lit_cells,
    steps_beside,
    unoccluded_steps,
)
from ringpose.detect.ring_arc_fit import NO_SIGHTS, RULES, StripeEvidence, fitted_arcs, possible, stripe_evidence
from ringpose.geometry.ring_arcs import STATE, RingArcs, moved
from ringpose.kernels.edges import Sights
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.detection import BreakPointFlag, BreakPoints, RingEdgePoints, Stripes
from ringpose.types.image import Shot
from ringpose.types.rig import Rig

ROUNDS = 10
"""Most rounds of following the edges; each carries about twice as far."""

FARTHER = 1.05
"""A round that reaches less than this much farther is the last."""

PREDICTED_SIGMA_PX = 1.3
"""Where the edge is predicted worse than this it is not looked for yet."""

WALK_SPACING_PX = 12
"""Distance of the steps that are looked for on the way."""

FIRST_SPACING_PX, FIRST_PX = 4, 600
"""Nearer as long as less of both edges than this is predicted: of so few steps none is to be left out."""

FIRST_REACH_PX, WALK_REACH_PX, REACH_PX = 2, 4, 2
"""How far from the predicted edge a step is looked for, at first, on the way and in the end.

The farther, the more steps are foil's, and at first they are too few to tell.
"""

BLUR_SPANS = (0.4, 0.2, 0.07)
"""Blurs between which the right one is sought in the end, each time closer: half to twice the one assumed."""

BLUR_STEPS = 60
"""So many of the clearest steps tell the blur."""

MIN_SHARE = 0.05
"""Where fewer of the predicted places show a step there is no edge to follow."""

CURVATURE, TURN = STATE.index("curvature"), STATE.index("turn_rad")

ONE_STRIPE = 2
"""Points of the plane on a single stripe: how the face is tilted about it is seen by how both edges run. One edge alone
leaves that to its bends of tenths of a pixel, which foil beside it makes as well."""

MIN_OF_BOTH = 8
"""Points of either edge that show how it runs. One alone lies on the edge and says nothing of its direction, which the
other edge's bends would then have to tell."""

TURN_SIGMA_RAD = 0.2
"""Where the stripes leave the direction of the edges as open as this, the image is asked first."""

SIDE_SIGMAS = 4.0
"""How clearly the edges' curvature must say on which side the ring's centre lies."""


class FoundEdges(NamedTuple):
    """The ring's edges, and what their curvature says of the side on which its centre lies."""

    points: RingEdgePoints
    side_sigmas: float
    """Curvature over its standard deviation; negative if inner and outer edge have each other's name."""


def detect_ring_edges(
    break_points: BreakPoints, shot: Shot, stripes: Stripes, rig: Rig
) -> tuple[BreakPoints, RingEdgePoints | None]:
    """The edges in the frame of a shot that shows them best, and the break points, their edges named by it if open."""
    found = found_edges(break_points, edge_image(shot, stripes), rig)
    return (break_points, None) if found is None else named_by_curvature(break_points, found)


def edge_image(shot: Shot, stripes: Stripes) -> EdgeImage:
    """The first frame without lasers; without one, that with the fewest, and where its stripes are."""
    number = min(range(len(shot.lasers)), key=lambda each: int(shot.lasers[each]).bit_count())
    image = shot.images[number]
    lit = lit_cells(stripes.position_px, image) if shot.lasers[number] else None
    return EdgeImage(image=image, saturation_dn=shot.saturation_dn, lit=lit)


def found_edges(break_points: BreakPoints, frame: EdgeImage, rig: Rig) -> FoundEdges | None:
    """Points of the ring's edges, and how sure the edges' names are; None where no edge was seen."""
    evidence = stripe_evidence(break_points, rig)
    if evidence is None:
        return None
    followed = tracked_arcs(evidence, frame, rig)
    if followed is None:
        return None
    arcs, covariance = followed
    trace = clear_of_stripes(frame, edge_trace(arcs, covariance, rig, ALONG_PX, PREDICTED_SIGMA_PX))
    profiles = edge_profiles(frame.image, trace.place_px, trace.normal, REACH_PX, frame.saturation_dn)
    steps = edge_steps(profiles, REACH_PX, blur_px(profiles))
    arcs, covariance = fitted_arcs(arcs, evidence, edge_observations(trace, steps))
    clear = unoccluded_steps(steps)
    points = ring_edge_points(arcs, chosen(trace, clear), steps.offset_px[clear], steps.sigma_px[clear])
    side_sigmas = arcs.curvature / float(np.sqrt(covariance[CURVATURE, CURVATURE]))
    if points is None or (
        len(evidence.plane.point) == ONE_STRIPE and np.bincount(points.edge, minlength=2).min() < MIN_OF_BOTH
    ):
        return None
    return FoundEdges(points, side_sigmas)


def named_by_curvature(break_points: BreakPoints, found: FoundEdges) -> tuple[BreakPoints, RingEdgePoints]:
    """Break points and edge points with their edges' names set right, if the break points left them open."""
    unknown = int(BreakPointFlag.EDGE_UNKNOWN)
    if not np.any(break_points.flags & unknown) or not abs(found.side_sigmas) >= SIDE_SIGMAS:
        return break_points, found.points
    named = replace(break_points, flags=break_points.flags & ~unknown)
    if found.side_sigmas > 0:
        return named, found.points
    swapped = replace(
        named,
        position_px=named.position_px[:, ::-1],
        covariance_px2=named.covariance_px2[:, ::-1],
        flags=named.flags[:, ::-1],
    )
    return swapped, replace(found.points, edge=1 - found.points.edge)


def tracked_arcs(
    evidence: StripeEvidence, frame: EdgeImage, rig: Rig
) -> tuple[RingArcs, Float64[Array, "state=7 state=7"]] | None:
    """The ring's edges as far as they can be followed from the stripes, and their covariance; None if not at all."""
    arcs, covariance = fitted_arcs(evidence.start, evidence, NO_SIGHTS, RULES._replace(rounds=5, outlier_sigmas=np.inf))
    if covariance[TURN, TURN] > TURN_SIGMA_RAD**2:
        beside = edges_beside_stripe(arcs, frame, rig)
        arcs, covariance = fitted_arcs(arcs, evidence, beside, RULES._replace(rounds=4))
    reached_px = 0.0
    for _ in range(ROUNDS):
        if not possible(arcs):
            return None
        spacing_px, reach_px = (
            (FIRST_SPACING_PX, FIRST_REACH_PX) if reached_px < FIRST_PX else (WALK_SPACING_PX, WALK_REACH_PX)
        )
        trace = edge_trace(arcs, covariance, rig, spacing_px, PREDICTED_SIGMA_PX)
        if len(trace.side) * spacing_px <= reached_px * FARTHER:
            break
        reached_px = len(trace.side) * spacing_px
        trace = clear_of_stripes(frame, trace)
        sights = edge_observations(trace, steps_beside(frame, trace, reach_px))
        if len(sights.side) < MIN_SHARE * len(trace.side):
            return None
        arcs, covariance = fitted_arcs(arcs, evidence, sights)
    return arcs, covariance


def blur_px(profiles: Profiles) -> float:
    """The blur (sigma) that explains the clearest steps best; a step's place depends on it by a third of its error."""
    clear = np.flatnonzero(~profiles.saturated.any(axis=1))
    clear = clear[np.argsort(np.ptp(profiles.value[clear], axis=1))[-BLUR_STEPS:]]
    if len(clear) < BLUR_STEPS // 4:
        return BLUR_PX
    part = Profiles(*(each[clear] for each in profiles))
    log_blur = math.log(BLUR_PX)
    for span in BLUR_SPANS:
        trials = [round(math.exp(log_blur + side * span), 2) for side in (-1, 0, 1)]
        left, middle, right = (_middle(edge_steps(part, REACH_PX, trial).cost) for trial in trials)
        bend = left - 2 * middle + right
        step = (left - right) / (2 * bend) if bend > 0 else math.copysign(1.0, left - right)
        log_blur += span * min(max(step, -1.5), 1.5)
    return round(math.exp(log_blur), 2)


def _middle(values: Float64[Array, "n"]) -> float:
    """The median, in a tenth of the time that NumPy's takes for so few."""
    ascending = np.sort(values)
    return float(ascending[(len(values) - 1) // 2] + ascending[len(values) // 2]) / 2


TURNS_RAD = np.linspace(-0.75, 0.75, 51)
"""Angles between the stripe's normal on the face and the edges that are tried."""

MIN_DISTANCE, MAX_DISTANCE = 2, 9
"""Places that are looked at to both sides on each edge ..."""

SPACING_PX = 6.0
"""... this far apart: so near the stripe that edges look straight."""

START_REACH_PX = 2
"""How far from a tried edge its steps may lie."""

START_TURN = np.eye(len(STATE))[STATE.index("turn_rad")]

MIN_STEPS = 5
"""So many places must show a step ..."""

DISTINCT, SIMILAR = 2, 6
"""... so many times more than in any other direction that is not among the next few."""


def edges_beside_stripe(arcs: RingArcs, frame: EdgeImage, rig: Rig) -> Sights:
    """Steps along the two straight edges through a stripe's ends that the image shows best; none if it shows none."""
    tables = [_places(moved(arcs, turn * START_TURN), rig).table for turn in TURNS_RAD]
    table = np.concatenate(tables)
    table[:, -1] = np.repeat(np.arange(len(tables)), [len(each) for each in tables])
    trace = clear_of_stripes(frame, EdgeTrace(table))

    clear = unoccluded_steps(steps_beside(frame, trace, START_REACH_PX))
    shown = np.bincount(trace.number.astype(np.int64), clear, minlength=len(tables))
    best = int(np.argmax(shown))
    elsewhere = np.delete(shown, slice(max(best - SIMILAR, 0), best + SIMILAR + 1))
    if shown[best] < max(MIN_STEPS, DISTINCT * elsewhere.max()):
        return NO_SIGHTS
    trace = chosen(trace, trace.number == best)
    return edge_observations(trace, steps_beside(frame, trace, START_REACH_PX))


def _places(arcs: RingArcs, rig: Rig) -> EdgeTrace:
    """The places on both edges of these arcs, as if they were known."""
    trace = edge_trace(arcs, np.zeros((len(STATE), len(STATE))), rig, SPACING_PX, np.inf, MAX_DISTANCE)
    return chosen(trace, np.abs(trace.number) >= MIN_DISTANCE)


BLUR_SIGMA_PX = 0.03
"""By how much a step's place depends on the assumed shape of its blur."""

GROUP = 3
"""Neighbouring steps that make one point: 12 px, which a facet of crinkled foil hardly exceeds."""

STRETCH = 15
"""Neighbouring steps, or points, whose scatter tells the size of their errors."""

SHARED = 6
"""So many of them, as large as the edge's are on average, are added: a few that agree by chance say little."""

OUTLIER_SIGMAS = 3.5
"""What lies off the ring by more is none of it, and counts in the scatter as if it were so far off."""

DISPLACED_PX = 0.4
"""A stretch this far off as a whole is the rim of a wall, a chamfer, a shadow."""

MAX_DISTANCE_PX = 1.5
"""Nor is a step this far off, whatever its neighbours scatter."""

POINT_SIGMA_PX = 0.5
"""A point that is known worse is of no use."""

MINIMUM_POINTS = 12
"""Fewer points cannot tell an edge from a chance."""


class _Points(NamedTuple):
    number: Float64[Array, "n"]
    side: Float64[Array, "n"]
    position_px: Float64[Array, "n xy=2"]
    normal: Float64[Array, "n xy=2"]
    off_px: Float64[Array, "n"]
    """From the edge of the ring that explains all of them."""
    sigma_px: Float64[Array, "n"]


def ring_edge_points(
    arcs: RingArcs, trace: EdgeTrace, offset_px: Float64[Array, "n"], sigma_px: Float64[Array, "n"]
) -> RingEdgePoints | None:
    """Points of the ring near `arcs` from the steps found beside the places of a trace; None for too few.

    A step's own sigma tells how it compares with its neighbours; what they all are worth (facets of foil, walls
    and shadows beside the edge) shows in their scatter about the ring.
    """
    position = trace.place_px + offset_px[:, None] * trace.normal
    off_px = beyond_px(arcs, trace, offset_px)
    steps = _Points(trace.number, trace.side, position, trace.normal, off_px, np.hypot(sigma_px, BLUR_SIGMA_PX))
    steps = _chosen(steps, ~_displaced(steps))
    steps = _without_outliers(steps._replace(sigma_px=steps.sigma_px * _scale(steps)))
    points = _grouped(steps)
    points = points._replace(sigma_px=np.hypot(points.sigma_px, BLUR_SIGMA_PX))
    points = _without_outliers(points._replace(sigma_px=points.sigma_px * np.maximum(_scale(points), 1.0)))
    known = points.sigma_px < POINT_SIGMA_PX
    if np.count_nonzero(known) < MINIMUM_POINTS:
        return None
    return RingEdgePoints(
        position_px=points.position_px[known],
        normal=points.normal[known],
        sigma_px=points.sigma_px[known],
        edge=(points.side[known] < 0).astype(np.int64),
    )


def _without_outliers(points: _Points) -> _Points:
    kept = np.abs(points.off_px) < np.minimum(OUTLIER_SIGMAS * points.sigma_px, MAX_DISTANCE_PX)
    return _chosen(points, kept)


def _chosen(points: _Points, which: Bool[Array, "n"]) -> _Points:
    return _Points(*(part[which] for part in points))


def _grouped(steps: _Points) -> _Points:
    """Weighted means of neighbouring steps, along the inner edge first."""
    key = np.floor(steps.number / GROUP)
    begins = np.append(True, (np.diff(key) != 0) | (np.diff(steps.side) != 0))[: len(key)]
    group = np.cumsum(begins) - 1
    weight = steps.sigma_px**-2
    total = np.bincount(group, weight)

    def mean(values: Float64[Array, "n"]) -> Float64[Array, "m"]:
        return np.bincount(group, weight * values) / total

    number, side, off_px = mean(steps.number), mean(steps.side), mean(steps.off_px)
    position = np.stack([mean(steps.position_px[:, axis]) for axis in (0, 1)], axis=-1)
    normal = np.stack([mean(steps.normal[:, axis]) for axis in (0, 1)], axis=-1)
    normal /= np.hypot(*normal.T)[:, None]
    return _Points(number, side, position, normal, off_px, total**-0.5)


def _scale(points: _Points) -> Float64[Array, "n"]:
    """Root mean square of the deviations in sigmas, over a stretch of the same edge."""
    scale = np.ones(len(points.side))
    deviation = np.abs(points.off_px / points.sigma_px)
    for here in _edges(points):
        near = _stretches(deviation[here])
        middle = np.sort(near, axis=-1)[:, near.shape[1] // 2, None]
        near = np.minimum(near, OUTLIER_SIGMAS * 1.4826 * middle)
        squares = np.einsum("ij,ij->i", near, near)
        scale[here] = np.sqrt((squares + SHARED * squares.mean() / near.shape[1]) / (near.shape[1] + SHARED))
    return np.maximum(scale, 1e-3)


def _displaced(points: _Points) -> Bool[Array, "n"]:
    """Whether a stretch is off the ring as a whole, much the same everywhere: another edge beside it."""
    displaced = np.zeros(len(points.side), dtype=bool)
    for here in _edges(points):
        near = _stretches(points.off_px[here])
        middle = near.mean(axis=-1)
        variance = np.einsum("ij,ij->i", near, near) / near.shape[1] - middle**2
        displaced[here] = (np.abs(middle) > DISPLACED_PX) & (middle**2 > variance)
    return displaced


def _edges(points: _Points) -> list[Int64[Array, "m"]]:
    """Indices of the points on the inner and on the outer edge, if there are enough for a stretch."""
    edges = [np.flatnonzero(points.side == side) for side in (1.0, -1.0)]
    return [here for here in edges if len(here) >= 2]


def _stretches(values: Float64[Array, "n"]) -> Float64[Array, "n near"]:
    """The values of each one's neighbours, mirrored at the ends."""
    half = min(STRETCH, len(values)) // 2
    mirrored = np.concatenate([values[half - 1 :: -1], values, values[: -half - 1 : -1]])
    near: Float64[Array, "n near"] = mirrored[np.arange(len(values))[:, None] + np.arange(2 * half + 1)]
    return near
