"""Readable NumPy twin of how wide the edges of an image are (ringpose-method(7), section 3).

Part of the oracle of the ends' kernel.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ringpose.kernels.reference_end_levels import Levels, columns_alike_for_width
from ringpose.kernels.ring import EndRules
from ringpose.types.arrays import Array, Float64

WIDTHS = np.array([0.3, 0.4, 0.55, 0.75, 1.0, 1.4, 2.0])
SHARP = 5
ROUNDS = 2
LEAST_INFORMATION = 1e-3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """The edge that fits best, for each width."""

    cost: Float64[Array, "width"]
    position: Float64[Array, "width"]
    outside: Float64[Array, "width"]
    first: Float64[Array, "place"]
    """Costs of the first search."""


class Width(NamedTuple):
    """A logarithm of a width in columns, and its information."""

    logarithm: float
    information: float


class Edge(NamedTuple):
    """An edge of some width."""

    position: float
    width: float
    outside: float
    per_width: float
    """Columns by which the position moves for a width that is e times as large."""


def own_width(levels: Levels, fit: Fit, sigma: float, likeness: float) -> Width:
    """What one end says of its width."""
    best = int(np.argmin(fit.cost[:SHARP]))
    k = min(max(best, 1), SHARP - 2)
    low, middle, high = WIDTHS[k - 1 : k + 2].tolist()
    first, second, third = fit.cost[k - 1 : k + 2].tolist()
    before, after = (second - first) / (middle - low), (third - second) / (high - middle)
    bend = (after - before) / (high - low)
    if not bend > 0:
        return Width(math.log(WIDTHS[best] * sigma), LEAST_INFORMATION)
    width = min(max(0.5 * (low + middle) - 0.5 * before / bend, low), high)
    alike = columns_alike_for_width(levels, likeness, width * sigma)
    return Width(math.log(width * sigma), max(2 * bend * width**2 / alike, LEAST_INFORMATION))


def common_width(widths: list[Width], rules: EndRules) -> Width:
    """The width of all ends of an image, weighted by Cauchy's function: one lens blurs them."""
    own = np.array([width.logarithm for width in widths])
    weight = 1 / (1 / np.array([width.information for width in widths]) + rules.width_spread**2)
    order = np.argsort(own)
    common = float(own[order][np.searchsorted(np.cumsum(weight[order]), 0.5 * weight.sum() * (1 - 1e-12))])
    for _ in range(ROUNDS):
        weighs = weight / (1 + 0.25 * weight * (own - common) ** 2)
        common = float(np.sum(weighs * own) / weighs.sum())
    return Width(common, float(weighs.sum()))


def settled_width(own: Width, common: Width, rules: EndRules) -> Width:
    """An end's width by itself and by the others."""
    others = 1 / (1 / common.information + rules.width_spread**2)
    total = own.information + others
    return Width((own.logarithm * own.information + common.logarithm * others) / total, total)


def edge_of_width(fit: Fit, sigma: float, width: float) -> Edge:
    """A parabola through what was found with the three widths about one."""
    at = min(max(width / sigma, WIDTHS[0]), WIDTHS[SHARP - 1])
    nearest = int(np.argmin(np.abs(np.log(WIDTHS[:SHARP] / at))))
    k = min(max(nearest, 1), SHARP - 2)
    three = slice(k - 1, k + 2)
    line = np.polyfit(WIDTHS[three] - at, fit.position[three], 2)
    outside = float(np.interp(at, WIDTHS[three], fit.outside[three]))
    return Edge(float(line[2]), at * sigma, outside, float(line[1]) * at)
