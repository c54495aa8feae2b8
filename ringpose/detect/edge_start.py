"""The direction of the ring's edges at a single stripe, which its two ends leave open."""

import numpy as np

from ringpose.detect.edge_search import EdgeImage, clear_of_stripes, clear_steps, step_sights, steps_beside
from ringpose.detect.edge_trace import EdgeTrace, chosen, edge_trace
from ringpose.detect.ring_arc_fit import NO_SIGHTS
from ringpose.geometry.ring_arcs import STATE, RingArcs, moved
from ringpose.kernels.edges import Sights
from ringpose.types.rig import Rig

TURNS_RAD = np.linspace(-0.75, 0.75, 51)
"""Angles between the stripe's normal on the face and the edges that are tried."""

NEAREST, FARTHEST = 2, 9
"""Places that are looked at to both sides on each edge ..."""

SPACING_PX = 6.0
"""... this far apart: so near the stripe that edges look straight."""

REACH_PX = 2
"""How far from a tried edge its steps may lie."""

TURN = np.eye(len(STATE))[STATE.index("turn_rad")]

LEAST_STEPS = 5
"""So many places must show a step ..."""

DISTINCT, SIMILAR = 2, 6
"""... so many times more than in any other direction that is not among the next few."""


def sights_beside_stripe(arcs: RingArcs, frame: EdgeImage, rig: Rig) -> Sights:
    """Steps along the two straight edges through a stripe's ends that the image shows best; none if it shows none."""
    tables = [_places(moved(arcs, turn * TURN), rig).table for turn in TURNS_RAD]
    table = np.concatenate(tables)
    table[:, -1] = np.repeat(np.arange(len(tables)), [len(each) for each in tables])
    trace = clear_of_stripes(frame, EdgeTrace(table))

    clear = clear_steps(steps_beside(frame, trace, REACH_PX))
    shown = np.bincount(trace.number.astype(np.int64), clear, minlength=len(tables))
    best = int(np.argmax(shown))
    elsewhere = np.delete(shown, slice(max(best - SIMILAR, 0), best + SIMILAR + 1))
    if shown[best] < max(LEAST_STEPS, DISTINCT * elsewhere.max()):
        return NO_SIGHTS
    trace = chosen(trace, trace.number == best)
    return step_sights(trace, steps_beside(frame, trace, REACH_PX))


def _places(arcs: RingArcs, rig: Rig) -> EdgeTrace:
    """The places on both edges of these arcs, as if they were known."""
    trace = edge_trace(arcs, np.zeros((len(STATE), len(STATE))), rig, SPACING_PX, np.inf, FARTHEST)
    return chosen(trace, np.abs(trace.number) >= NEAREST)
