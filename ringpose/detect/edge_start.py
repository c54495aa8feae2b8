"""The direction of the ring's edges at a single stripe, which its two ends leave open."""

import numpy as np

from ringpose.detect.edge_search import EdgeImage, clear_steps, step_sights, steps_beside
from ringpose.detect.edge_trace import chosen, clear_of, imaged, in_image
from ringpose.detect.ring_arc_fit import NO_SIGHTS, Sights
from ringpose.detect.ring_arcs import STATE, RingArcs, arc_points, moved
from ringpose.types.rig import Rig

TURNS_RAD = np.linspace(-0.75, 0.75, 51)
"""Angles between the stripe's normal on the face and the edges that are tried."""

NUMBERS = np.concatenate([np.arange(-9.0, -1.0), np.arange(2.0, 10.0)])
"""Places that are looked at on each edge ..."""

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
    number, side = np.tile(NUMBERS, 2), np.repeat([1.0, -1.0], len(NUMBERS))
    along_m = number * SPACING_PX * arcs.origin[2] / rig.camera.camera_matrix[0, 0]
    turned = [arc_points(moved(arcs, turn * TURN), along_m, side) for turn in TURNS_RAD]
    point, outward = (np.concatenate(parts) for parts in zip(*turned, strict=True))
    trial = np.repeat(np.arange(len(turned), dtype=np.float64), len(side))
    trace = imaged(point, outward, arcs.axes[2], np.tile(side, len(turned)), trial, rig)
    trace = clear_of(frame.stripes_px, chosen(trace, in_image(trace, rig)))

    clear = clear_steps(steps_beside(frame, trace, REACH_PX))
    shown = np.bincount(trace.number.astype(np.int64), clear, minlength=len(turned))
    best = int(np.argmax(shown))
    elsewhere = np.delete(shown, slice(max(best - SIMILAR, 0), best + SIMILAR + 1))
    if shown[best] < max(LEAST_STEPS, DISTINCT * elsewhere.max()):
        return NO_SIGHTS
    trace = chosen(trace, trace.number == best)
    return step_sights(trace, steps_beside(frame, trace, REACH_PX))
