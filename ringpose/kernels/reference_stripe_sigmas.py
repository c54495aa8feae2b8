"""Readable NumPy twin of `stripe_sigmas.c`: what differences between the centres of a piece say of their sigmas.

Second differences do not see where a straight piece runs. Near ones show speckle, far ones what surrounds it.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from ringpose.types.arrays import Array

NEAR_LAG, FAR_LAG = 4, 20
"""Columns over which the speckle of two centres has become independent, and a background."""

BACKGROUND = 1.75
"""Far centres differ by so much more than near ones where the surroundings of a stripe spoil it."""

PRIOR_DIFFERENCES = 4.0
"""The sensor's noise counts as much as so many differences."""

LARGEST_SQUARE, ROUNDS = 25.0, 3
"""Squares count up to this many times their mean."""

SURROUNDINGS = 24
"""Differences on either side that are a column's surroundings."""

PIECE_DIFFERENCES = 16.0
"""Those of all the piece count as so many."""

VARIANCES = 6.0
"""A second difference has six times the variance of a centre."""

CLUTTERED = 8.0
"""An excess above this comes from speckle, clutter or bends rather than from the sensor."""

Column = Float64[Array, "n"]


class Scatter(NamedTuple):
    """What second differences between centres show."""

    excess: float
    """Over what the sensor's noise explains."""
    lag: int
    """Columns between the centres."""
    background: bool
    """Whether far ones show much more than near ones."""


def scatter(y: Column, variance: Column) -> Scatter:
    """By near differences, unless far ones show much more."""
    near, far = _excess(y, variance, NEAR_LAG), _excess(y, variance, FAR_LAG)
    if far > BACKGROUND * near:
        return Scatter(far, FAR_LAG, background=True)
    return Scatter(near, NEAR_LAG, background=False)


def scatter_variance(y: Column, of: Scatter) -> float:
    """Variance of a centre that those differences show."""
    return _clipped_mean(_squares(y, _fitting(of.lag, len(y))))


def raised(y: Column, variance: Column, of: Scatter) -> Column:
    """The variances raised by a small excess, which is the sensor's; a large one is added as it is near each column."""
    if of.excess <= CLUTTERED:
        return variance * of.excess
    lag = _fitting(of.lag, len(y))
    piece, squares = scatter_variance(y, of), _squares(y, lag)
    squares = np.minimum(squares, LARGEST_SQUARE * piece)
    added = np.empty(len(y))
    for i in range(len(y)):
        near = squares[max(i - lag - SURROUNDINGS, 0) : max(i - lag + SURROUNDINGS + 1, 0)]
        added[i] = (near.sum() + PIECE_DIFFERENCES * piece) / (len(near) + PIECE_DIFFERENCES)
    return variance + added


def _fitting(lag: int, count: int) -> int:
    """A short piece has to do with nearer neighbours."""
    return lag if 4 * lag < count else count // 4


def _differences(y: Column, lag: int) -> Float64[Array, "difference"]:
    """Second differences: none at lag 0."""
    return (y[: -2 * lag] + y[2 * lag :]) - 2 * y[lag:-lag] if lag else np.empty(0)


def _squares(y: Column, lag: int) -> Float64[Array, "difference"]:
    """Second differences as variances of centres."""
    return _differences(y, lag) ** 2 / VARIANCES


def _excess(y: Column, variance: Column, lag: int) -> float:
    """Squared second differences over what the sensor's noise explains."""
    lag = _fitting(lag, len(y))
    explained = (variance[: -2 * lag] + variance[2 * lag :]) + 4 * variance[lag:-lag] if lag else np.empty(0)
    ratio = _differences(y, lag) ** 2 / explained
    total = PRIOR_DIFFERENCES + (_clipped_mean(ratio) * len(ratio) if len(ratio) else 0.0)
    return total / (PRIOR_DIFFERENCES + len(ratio))


def _clipped_mean(values: Column) -> float:
    """Mean without outliers; 1 of nothing."""
    limit, mean = np.inf, 1.0
    for _ in range(ROUNDS if len(values) else 0):
        mean = float(np.minimum(values, limit).mean())
        limit = LARGEST_SQUARE * mean
    return mean
