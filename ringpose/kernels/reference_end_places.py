"""Readable NumPy twin of what other places of an end add to its variance: part of the oracle of the ends' kernel."""

import math

import numpy as np

from ringpose.kernels.reference_end_levels import Columns, Levels, share_shown, variance_of
from ringpose.kernels.reference_end_sigmas import light_noise, lit_share
from ringpose.kernels.reference_end_widths import Edge
from ringpose.types.arrays import Array, Float64

PLACES = np.arange(-12, 7) * 1.0
"""Columns at which ends are looked for first."""

OPEN = 40.0
"""Minus log likelihood over that of the best column above which no place nearest to a column is looked at again."""

LEAST_SHARE = 1e-3

LEAST_TOLD = 0.05
"""Likelihood, as a share of the best place's, below which the model of the noise is not to be trusted."""


def open_steps(edge: Edge, first: Float64[Array, "place"]) -> Float64[Array, "step"]:
    """Whole columns from an edge to other places where the end may be, by the costs of the first search."""
    steps = np.delete(np.arange(-18, 19), 18) * 1.0
    nearest = np.rint(edge.position + steps - PLACES[0]).astype(np.int64)
    steps, nearest = [each[(nearest >= 0) & (nearest < len(PLACES))] for each in (steps, nearest)]
    found: Float64[Array, "step"] = steps[first[nearest] - first.min() < OPEN]
    return found


def variance_over_places(
    columns: Columns, levels: Levels, edge: Edge, variance: float, likeness: float, excess: dict[float, float]
) -> float:
    """Mean squared distance from an edge of all places where the end may be.

    About the edge the likelihood is a Gaussian of that variance; other places weigh by as much as theirs is beyond it.
    `excess`: of their minus log likelihoods over the edge's, by their steps from it.
    """
    weights = near = math.sqrt(2 * math.pi * variance)
    squares = near * variance
    for step, more in excess.items():
        share = _independent_share(columns, levels, edge, edge.position + step, likeness)
        weight = math.exp(-max(more, 0.0) * share) - math.exp(-0.5 * step**2 / variance)
        weight = max(weight - LEAST_TOLD, 0.0)
        weights += weight
        squares += weight * step**2
    return squares / weights


def _independent_share(columns: Columns, levels: Levels, edge: Edge, place: float, likeness: float) -> float:
    """By how much less columns tell one place from another than if each erred by itself."""
    outer = edge._replace(position=max(place, edge.position))
    shown, here, there = (
        share_shown(columns, lit_share((position - columns.along) / edge.width))
        for position in (outer.position, edge.position, place)
    )
    influence = (1 - edge.outside) * (here - there) / variance_of(columns, levels, shown)
    alone = float(np.sum(influence**2 * variance_of(columns, levels, shown)))
    together = light_noise(columns, levels, outer, influence, (likeness, columns.facet))
    return min(alone / max(together, LEAST_SHARE * alone, 1e-30), 1.0)
