"""The probability that a gripper closes on the ring."""

import numpy as np
import pytest

from ringpose.track.lines import capture_probability


def test_independent_round_errors_have_the_probabilities_of_the_rayleigh_distribution():
    covariance = np.diag([4e-6, 4e-6, 1e-4, 1e-4])

    found = capture_probability(covariance, 0.003, 0.015)

    expected = (1 - np.exp(-(0.003**2) / 8e-6)) * (1 - np.exp(-(0.015**2) / 2e-4))
    assert found == pytest.approx(expected, abs=0.003)


def test_correlated_errors_have_the_probability_of_drawn_ones(rng):
    root = rng.normal(size=(4, 4)) * np.array([[2e-3], [1e-3], [0.01], [0.02]])
    drawn = rng.normal(size=(200_000, 4)) @ root.T
    hit = (np.hypot(drawn[:, 0], drawn[:, 1]) < 0.004) & (np.hypot(drawn[:, 2], drawn[:, 3]) < 0.03)

    assert capture_probability(root @ root.T, 0.004, 0.03) == pytest.approx(hit.mean(), abs=0.006)


def test_limits_of_zero_capture_nothing_and_wide_ones_everything():
    covariance = np.diag([1e-6, 1e-6, 1e-4, 1e-4])

    assert capture_probability(covariance, 0.0, 0.1) == 0.0
    assert capture_probability(covariance, 1.0, 3.0) == 1.0
