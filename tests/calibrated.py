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
    low, high = _quantiles(len(nees) * degrees_of_freedom, np.array([CHANCE, 1 - CHANCE]))
    assert np.mean(nees) < high
    assert at_most or np.mean(nees) > low
    assert max(nees) < _quantiles(degrees_of_freedom, np.array(1 - CHANCE / len(nees)))


def _quantiles(degrees_of_freedom: int, probability: np.ndarray) -> np.ndarray:
    """Of chi-squared over its degrees of freedom."""
    return 2.0 * gammaincinv(degrees_of_freedom / 2.0, probability) / degrees_of_freedom
