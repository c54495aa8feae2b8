"""Robust spread and weights."""

import numpy as np
import pytest
import scipy
from scipy.optimize import least_squares

from ringpose.geometry.least_squares import huber_weights, robust_std


def test_the_robust_standard_deviation_is_that_of_normal_errors_with_outliers(rng):
    errors = rng.normal(scale=0.2, size=4000)
    errors[:200] += 100.0

    expected = 0.2 * scipy.stats.norm.ppf(0.5 + 0.5 * 0.5 / 0.95) / scipy.stats.norm.ppf(0.75)
    assert robust_std(errors) == pytest.approx(expected, rel=0.05)


def test_reweighted_means_reach_the_huber_estimate_of_scipy(rng):
    values = np.concatenate([rng.normal(size=60), np.full(9, 30.0)])

    mean = float(np.median(values))
    for _ in range(60):
        mean = float(np.average(values, weights=huber_weights(values - mean, 1.5)))

    expected = least_squares(lambda center: values - center, 0.0, loss="huber", f_scale=1.5, xtol=1e-12, gtol=1e-12)
    assert mean == pytest.approx(float(expected.x[0]), abs=1e-6)
