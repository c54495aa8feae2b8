"""Whether errors are as large as their covariances state."""

from collections.abc import Sequence

import numpy as np
import pytest
from scipy.special import gammaincinv

DRAWS = pytest.mark.parametrize("draws", [20, pytest.param(60, marks=pytest.mark.slow)])
"""How many shots are drawn: enough to see an error by half, or by a quarter."""

CHANCE = 1e-4
"""Of a limit to be missed although the covariances are right."""


def assert_calibrated(nees: Sequence[float], degrees_of_freedom: int, at_most: bool = False) -> None:
    """Squared errors in their covariances, over the degrees of freedom, have mean and largest value of chi-squared.

    With `at_most` they may be smaller.
    """
    low, high = chi_squared([CHANCE, 1 - CHANCE], len(nees) * degrees_of_freedom)
    assert np.sum(nees) * degrees_of_freedom < high
    assert at_most or np.sum(nees) * degrees_of_freedom > low
    assert max(nees) * degrees_of_freedom < chi_squared([1 - CHANCE / len(nees)], degrees_of_freedom)[0]


def chi_squared(probabilities: Sequence[float], degrees_of_freedom: int) -> np.ndarray:
    """Quantiles of chi-squared; to import SciPy's statistics for them takes as long as NumPy and OpenCV together."""
    return 2.0 * gammaincinv(degrees_of_freedom / 2.0, np.asarray(probabilities))
