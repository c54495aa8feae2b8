"""The covariance of a stripe's line at its ends."""

import numpy as np
import pytest

from ringpose.estimate.factors.lines import line_whitening


def covariance_of_ends(weight):
    """Of the ordinates at both ends of a line that is fitted to centres of these weights, evenly spread."""
    x = np.linspace(0.0, 1.0, len(weight))
    design = np.stack([np.ones_like(x), x], axis=-1)
    ends = np.array([[1.0, 0.0], [1.0, 1.0]])
    return ends @ np.linalg.inv(design.T @ (weight[:, None] * design)) @ ends.T


@pytest.mark.parametrize("sigma", [1.0, 0.01])
def test_the_ends_of_an_even_line_err_together_as_those_of_a_fit(sigma):
    covariance = covariance_of_ends(np.full(2001, 1.0 / sigma**2))

    first, mixed, second = line_whitening(*np.sqrt(np.diag(covariance)).tolist())

    whitening = np.array([[first, 0.0], [mixed, second]])
    np.testing.assert_allclose(np.linalg.inv(whitening.T @ whitening), covariance, rtol=1e-2)


def test_a_line_that_is_known_better_at_one_end_errs_nearly_as_a_fit_to_better_centres_there():
    covariance = covariance_of_ends(np.linspace(0.7, 1.3, 2001))

    first, mixed, second = line_whitening(*np.sqrt(np.diag(covariance)).tolist())

    whitening = np.array([[first, 0.0], [mixed, second]])
    found = np.linalg.inv(whitening.T @ whitening)
    np.testing.assert_allclose(np.diag(found), np.diag(covariance), rtol=1e-6)
    assert found[0, 1] == pytest.approx(covariance[0, 1], rel=0.1)


@pytest.mark.parametrize("ends_px", [(0.01, 1.0), (1.0, 0.01), (1e-6, 1e4), (0.0277, 0.1)])
def test_a_line_that_is_hardly_known_at_one_end_has_a_covariance_all_the_same(ends_px):
    first, mixed, second = line_whitening(*ends_px)

    inverse = np.linalg.inv(np.array([[first, 0.0], [mixed, second]]))
    np.testing.assert_allclose(np.sqrt((inverse**2).sum(axis=1)), ends_px, rtol=1e-6)
