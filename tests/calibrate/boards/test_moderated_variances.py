"""Moderated variances of views, whose sums of squares are drawn from chi-squared distributions."""

import numpy as np
import pytest

from ringpose.calibrate.boards.corner_errors import moderated_variances

FREEDOM = np.full(60, 26.0)


def test_views_with_equal_errors_share_one_variance(rng):
    squares = 0.04 * rng.chisquare(FREEDOM)

    moderated = moderated_variances(squares, FREEDOM)

    assert np.ptp(np.log(moderated)) < 0.2 * np.ptp(np.log(squares))
    assert moderated.mean() == pytest.approx(0.04, rel=0.1)


def test_views_that_differ_keep_their_own_variance(rng):
    true = 0.04 * np.exp(rng.normal(0.0, 1.0, 60))

    moderated = moderated_variances(true * rng.chisquare(FREEDOM), FREEDOM)

    assert np.std(np.log(moderated / true)) < 0.4  # of chi-squared of 26 it is 0.28


def test_moderated_variances_err_less_than_the_views_own(rng):
    true = 0.04 * np.exp(rng.normal(0.0, 0.3, 60))
    squares = true * rng.chisquare(FREEDOM)

    errors = [np.std(np.log(found / true)) for found in (moderated_variances(squares, FREEDOM), squares / FREEDOM)]

    assert errors[0] < 0.9 * errors[1]


def test_exact_corners_have_a_variance_above_zero_and_two_views_share_one():
    assert np.all(moderated_variances(np.zeros(4), np.full(4, 20.0)) > 0)
    two = moderated_variances(np.array([1.0, 9.0]), np.array([10.0, 10.0]))
    assert np.ptp(two) == 0.0
