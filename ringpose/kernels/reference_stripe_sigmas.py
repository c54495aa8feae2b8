"""Readable NumPy twin of `stripe_sigmas.c`: what differences between the centres of a piece say of their sigmas.

Second differences do not see where a straight piece runs. Near ones show speckle, far ones what surrounds it
(ringpose-method(7), section 3).
"""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ringpose.types.arrays import Array, Float64

NEAR_LAG, FAR_LAG = 4, 40
"""Columns over which the speckle of two centres has become independent, and a background."""

BACKGROUND = 1.75
"""Far centres differ by so much more than near ones where the surroundings of a stripe spoil it."""

EXPECTED_DIFFERENCES = 4.0
"""What is expected of a piece counts as much as so many differences."""

FRAME_DIFFERENCES = 8.0
"""And what the frame's pieces show as so many, on a scale of ratios: short pieces show little."""

LARGEST_SQUARE, ROUNDS = 25.0, 3
"""Squares count up to this many times their mean."""

SURROUNDINGS = 10
"""Differences on either side that are a column's surroundings."""

PIECE_DIFFERENCES = 6.0
"""Those of all the piece count as so many."""

VARIANCES = 6.0
"""A second difference has six times the variance of a centre."""

Column = Float64[Array, "n"]


class Scatter(NamedTuple):
    """What second differences between centres show."""

    total: float
    """Of their squares over what the sensor's noise explains."""
    differences: int
    lag: int
    """Columns between the centres."""

    @property
    def background(self) -> bool:
        """Whether far ones show much more than near ones."""
        return self.lag == FAR_LAG

    def excess(self, expected: float = 1.0) -> float:
        """Mean of those squares, together with a few that are as expected."""
        return (EXPECTED_DIFFERENCES * expected + self.total) / (EXPECTED_DIFFERENCES + self.differences)


def scatter(y: Column, variance: Column) -> Scatter:
    """By near differences, unless far ones show much more."""
    near, far = scatter_at(y, variance, NEAR_LAG), scatter_at(y, variance, FAR_LAG)
    return far if far.excess() > BACKGROUND * near.excess() else near


def scatter_at(y: Column, variance: Column, lag: int) -> Scatter:
    """Of the differences of centres so far apart, or as far as fits."""
    near = _fitting(lag, len(y))
    explained = (variance[: -2 * near] + variance[2 * near :]) + 4 * variance[near:-near] if near else np.empty(0)
    ratio = _differences(y, near) ** 2 / explained
    return Scatter(_clipped_mean(ratio) * len(ratio), len(ratio), lag)


def scatter_variance(y: Column, of: Scatter) -> float:
    """Variance of a centre that those differences show."""
    return _clipped_mean(_squares(y, _fitting(of.lag, len(y))))


def usual_excess(pieces: Sequence[Scatter]) -> float:
    """The excess that half the differences of all pieces keep below."""
    usual, seen, half = 1.0, 0, sum(of.differences for of in pieces) / 2
    for of in sorted(pieces, key=Scatter.excess):
        if seen < half:
            usual = of.excess()
        seen += of.differences
    return usual


def raised(y: Column, variance: Column, of: Scatter, usual: float) -> Column:
    """The variances, or more where the differences around a column show it.

    Where there are few, those of the piece and of the frame count.
    """
    lag = _fitting(of.lag, len(y))
    expected, share = usual * variance.mean(), FRAME_DIFFERENCES / (FRAME_DIFFERENCES + of.differences)
    shown = EXPECTED_DIFFERENCES * expected + of.differences * scatter_variance(y, of)
    piece = expected**share * (shown / (EXPECTED_DIFFERENCES + of.differences)) ** (1 - share)
    squares = np.minimum(_squares(y, lag), LARGEST_SQUARE * piece)
    around = np.empty(len(y))
    for i in range(len(y)):
        near = squares[max(i - lag - SURROUNDINGS, 0) : max(i - lag + SURROUNDINGS + 1, 0)]
        around[i] = (near.sum() + PIECE_DIFFERENCES * piece) / (len(near) + PIECE_DIFFERENCES)
    return np.maximum(variance, around)


def _fitting(lag: int, count: int) -> int:
    """A short piece has to do with nearer neighbours."""
    return lag if 4 * lag < count else count // 4


def _differences(y: Column, lag: int) -> Float64[Array, "difference"]:
    """Second differences: none at lag 0."""
    return (y[: -2 * lag] + y[2 * lag :]) - 2 * y[lag:-lag] if lag else np.empty(0)


def _squares(y: Column, lag: int) -> Float64[Array, "difference"]:
    """Second differences as variances of centres."""
    return _differences(y, lag) ** 2 / VARIANCES


def _clipped_mean(values: Float64[Array, "difference"]) -> float:
    """Mean without outliers; 1 of nothing."""
    limit, mean = np.inf, 1.0
    for _ in range(ROUNDS if len(values) else 0):
        mean = float(np.minimum(values, limit).mean())
        limit = LARGEST_SQUARE * mean
    return mean
