"""Readable NumPy twin of how well the end of a stripe is known: part of the oracle of the ends' kernel.

The u^T V u of ringpose-method(7), section 3: `_influence` is u, `_column_noise` and `_speckle` are the parts of V.
"""

import math

import numpy as np

from ringpose.kernels.reference_end_levels import Columns, Levels, share_shown, variance_of
from ringpose.kernels.reference_end_widths import Edge
from ringpose.kernels.ring import EndRules
from ringpose.types.arrays import Array, Float64

LAGS = 5
MISFIT_WIDTHS = 3
RESOLVED = 0.25
STEPS = np.linspace(-4.0, 4.0, 801)
NORMAL_CDF = np.array([0.5 * (1 + math.erf(step / math.sqrt(2))) for step in STEPS])


def lit_share(steps: Float64[Array, "*shape"]) -> Float64[Array, "*shape"]:
    """The normal distribution function, as far as it is tabulated."""
    lit: Float64[Array, "*shape"] = np.interp(steps, STEPS, NORMAL_CDF, left=0.0, right=1.0)
    return lit


def edge_variance(
    columns: Columns, levels: Levels, edge: Edge, likeness: float, information: float, rules: EndRules
) -> float:
    """Variance of an edge's position along the columns; its width (logarithm) is known with that information."""
    t = (edge.position - columns.along) / edge.width
    lit = lit_share(t)
    shown, beyond = share_shown(columns, lit), 1 - lit
    slope = columns.level * (1 - edge.outside) * np.exp(-0.5 * t**2) / (edge.width * math.sqrt(2 * math.pi))
    weight = 1 / variance_of(columns, levels, shown)
    shapes = [slope * _growth(columns, lit), shown, beyond][: 3 if edge.outside > 0 else 2]
    influence = _influence(np.stack(shapes), weight)
    seen = light_noise(columns, levels, edge, influence, (likeness, 1.0))
    seen += float(np.sum(influence**2 * columns.texture))
    off = columns.amplitude - columns.level * (shown + edge.outside * beyond)
    near = np.abs(columns.along - edge.position) <= MISFIT_WIDTHS * edge.width + 1
    count = int(near.sum())
    misfit = max(float(np.sum((off**2 * weight)[near])) / (count - 2) - 1, 1.0) if count > 2 else 1.0
    shift = 0.5 * math.sqrt(2 * math.pi) * edge.width
    slow = _slow_levels(columns, levels, edge, rules) * shift**2
    return seen * misfit + slow + edge.per_width**2 / information + rules.shape_sigma**2


def _growth(columns: Columns, lit: Float64[Array, "n"]) -> Float64[Array, "n"]:
    """How what is shown grows with what is lit."""
    faint, half, full = columns.room
    grows = np.where(lit < 0.5, faint + 4 * (half - faint) * lit, 2 * half - full + 4 * (full - half) * lit)
    return np.maximum(grows, 0.0) if columns.clipped else np.ones_like(lit)


def _influence(shapes: Float64[Array, "parameter n"], weight: Float64[Array, "n"]) -> Float64[Array, "n"]:
    """How much each column's light moves the edge, both levels being fitted as well."""
    normal = (shapes * weight) @ shapes.T
    levels = np.linalg.lstsq(normal[1:, 1:], normal[1:, 0], rcond=None)[0]
    information = max(float(normal[0, 0] - levels @ normal[1:, 0]), 1e-12)
    influence: Float64[Array, "n"] = weight * (shapes[0] - levels @ shapes[1:]) / information
    return influence


def light_noise(
    columns: Columns, levels: Levels, edge: Edge, influence: Float64[Array, "n"], alike: tuple[float, float]
) -> float:
    """Variance of the columns' light, summed with an influence, before an edge.

    Speckle and what lies beneath are so much alike in neighbouring columns.
    """
    likeness, facet = alike
    shown = share_shown(columns, lit_share((edge.position - columns.along) / edge.width))
    speckle = levels.speckle * max(_speckle(columns, edge, (shown, influence), likeness), 0.0)
    alone = float(np.sum(influence**2 * (levels.noise + levels.shot * shown)))
    beneath = np.abs(influence) * np.sqrt(columns.texture)
    apart = np.abs(columns.along[:, None] - columns.along)
    return alone + float(beneath @ facet**apart @ beneath) + speckle


def _speckle(columns: Columns, edge: Edge, seen: tuple[Array, Array], likeness: float) -> float:
    """Variance by speckle of one: a share as if grains were resolved, the rest as if they were finer than the blur."""
    shown, influence = seen
    apart = np.round(np.abs(columns.along[:, None] - columns.along))
    middle = (columns.along[:, None] + columns.along) / 2
    fine = lit_share(math.sqrt(2) * (edge.position - middle) / edge.width)
    averaged = fine * np.outer(columns.room[-1], columns.room[-1])
    shared = RESOLVED * np.outer(shown, shown) + (1 - RESOLVED) * averaged
    alike = np.where(apart <= LAGS, likeness ** (apart**2), 0.0)
    return float(influence @ (alike * shared) @ influence)


def _slow_levels(columns: Columns, levels: Levels, edge: Edge, rules: EndRules) -> float:
    """Relative variance of the levels on both sides of an edge that neighbours share beyond grains of speckle."""
    away, value = columns.along - edge.position, columns.amplitude / columns.level
    full = (value / np.maximum(columns.room[-1], rules.least_headroom))[away < -3 * edge.width]
    beyond = value[(away > 3 * edge.width) & (away < rules.near_columns)]
    inside = max(_slow_variance(full, 1.0) - levels.speckle / columns.level**2, 0.0)
    return inside + _slow_variance(beyond, edge.outside)


def _slow_variance(values: Float64[Array, "n"], level: float) -> float:
    """Variance about a level of what neighbours share; what each column has of its own shows in their differences."""
    if len(values) < 3:
        return 0.0
    return max(float(np.mean((values - level) ** 2)) - 0.5 * float(np.mean(np.diff(values) ** 2)), 0.0)
