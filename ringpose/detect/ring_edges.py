"""The ring's visible edges between and beyond the stripes (method(7), section 5 c), followed from the break points.

Stripes close together hardly tell the ring's curvature: the search begins where the edges are predicted to a
pixel, and what is found there predicts them farther on, until the image ends or the edge is lost.
"""

import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from ringpose.detect.edge_points import ring_edge_points
from ringpose.detect.edge_search import (
    BLUR_PX,
    EdgeImage,
    clear_of_stripes,
    clear_steps,
    lit_cells,
    step_sights,
    steps_beside,
)
from ringpose.detect.edge_start import sights_beside_stripe
from ringpose.detect.edge_steps import ALONG_PX, Profiles, edge_profiles, edge_steps
from ringpose.detect.edge_trace import chosen, edge_trace
from ringpose.detect.ring_arc_fit import NO_SIGHTS, RULES, StripeEvidence, fitted_arcs, possible, stripe_evidence
from ringpose.geometry.ring_arcs import STATE, RingArcs
from ringpose.types.arrays import Array, Float64
from ringpose.types.detection import BreakPointFlag, BreakPoints, RingEdgePoints, Stripes
from ringpose.types.frame import Shot
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

LEAST_SHARE = 0.05
"""Where fewer of the predicted places show a step there is no edge to follow."""

CURVATURE, TURN = STATE.index("curvature"), STATE.index("turn_rad")

ONE_STRIPE = 2
"""Points of the plane on a single stripe: how the face is tilted about it is seen by how both edges run. One edge alone
leaves that to its bends of tenths of a pixel, which foil beside it makes as well."""

LEAST_OF_BOTH = 8
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


def shown_edges(
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
    followed = followed_arcs(evidence, frame, rig)
    if followed is None:
        return None
    arcs, covariance = followed
    trace = clear_of_stripes(frame, edge_trace(arcs, covariance, rig, ALONG_PX, PREDICTED_SIGMA_PX))
    profiles = edge_profiles(frame.image, trace.place_px, trace.normal, REACH_PX, frame.saturation_dn)
    steps = edge_steps(profiles, REACH_PX, blur_px(profiles))
    arcs, covariance = fitted_arcs(arcs, evidence, step_sights(trace, steps))
    clear = clear_steps(steps)
    points = ring_edge_points(arcs, chosen(trace, clear), steps.offset_px[clear], steps.sigma_px[clear])
    side_sigmas = arcs.curvature / float(np.sqrt(covariance[CURVATURE, CURVATURE]))
    if points is None or (
        len(evidence.plane.point) == ONE_STRIPE and np.bincount(points.edge, minlength=2).min() < LEAST_OF_BOTH
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


def followed_arcs(
    evidence: StripeEvidence, frame: EdgeImage, rig: Rig
) -> tuple[RingArcs, Float64[Array, "state=7 state=7"]] | None:
    """The ring's edges as far as they can be followed from the stripes, and their covariance; None if not at all."""
    arcs, covariance = fitted_arcs(evidence.start, evidence, NO_SIGHTS, RULES._replace(rounds=5, outlier_sigmas=np.inf))
    if covariance[TURN, TURN] > TURN_SIGMA_RAD**2:
        beside = sights_beside_stripe(arcs, frame, rig)
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
        sights = step_sights(trace, steps_beside(frame, trace, reach_px))
        if len(sights.side) < LEAST_SHARE * len(trace.side):
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
