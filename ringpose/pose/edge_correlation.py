"""How many independent measurements the points of a visible edge are.

Neighbours on an edge see the same shade, the same facet of the foil behind, the same speckle: what they err alike no
number of them averages (ringpose-method(7), section 5).
"""

from dataclasses import replace

import numpy as np

from ringpose.pose.measurements import Edges
from ringpose.types.arrays import Array, Float64

SHORT_SERIES = 1.5
"""A circle fitted to a short series takes part of its likeness away: what is found is so much too small."""

LONGEST_SHARE = 3
"""Likeness is looked for up to this part of an edge's points; fewer pairs say nothing."""


def loosened(edges: Edges, residual: Float64[Array, "visible"]) -> Edges:
    """Each edge's points with their standard deviations raised, so that together they weigh what they know.

    `residual` is what a fit of all leaves, in standard deviations.
    """
    factor = np.ones(len(residual))
    for edge in (0, 1):
        own = np.flatnonzero(edges.edge == edge)
        if len(own) > LONGEST_SHARE:
            along = edges.ray[own, :2] - edges.ray[own, :2].mean(axis=0)
            direction = np.linalg.svd(along, full_matrices=False)[2][0]
            factor[own] = np.sqrt(excess(residual[own][np.argsort(along @ direction)]))
    return replace(edges, step=edges.step * factor[:, None], common=edges.common / factor[:, None])


def excess(series: Float64[Array, "n"]) -> float:
    """Variance of the mean of a series, in that of as many independent numbers of variance one; at least 1.

    The variance, and twice the autocovariance as far as it stays positive (Geyer's initial sequence).
    """
    inside = np.clip(series, -3.0, 3.0)
    variance = total = float(inside @ inside) / len(inside)
    for lag in range(1, len(inside) // LONGEST_SHARE):
        likeness = float(inside[lag:] @ inside[:-lag]) / len(inside)
        if likeness <= 0:
            break
        total += 2.0 * likeness
    return max(1.0, SHORT_SERIES * total if total > variance else variance)
