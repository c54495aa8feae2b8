"""Closed-form cases of the errors."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ringpose.errors import DataError
from ringpose.estimate.pose_errors import (
    circle_error,
    mahalanobis_squared,
    tilt_error_rad,
    truth_at,
)
from ringpose.geometry.rotations import tilted
from ringpose.types.truth import Truth

ORIGIN = np.zeros(3)
Z = np.array([0.0, 0.0, 1.0])


@pytest.mark.parametrize(
    ("point", "along_normal", "radial"),
    [
        ([2.0, 0.0, 0.0], 0.0, 0.0),
        ([0.0, -2.0, 0.0], 0.0, 0.0),
        ([5.0, 0.0, 4.0], 4.0, 3.0),
        ([0.0, 0.0, 0.0], 0.0, -2.0),
        ([0.0, 2.5, 0.2], 0.2, 0.5),
    ],
)
def test_a_point_is_off_a_circle_along_the_normal_and_radially(point, along_normal, radial):
    axes, error_m = circle_error(np.array(point) + 3.0, ORIGIN + 3.0, Z, 2.0)

    np.testing.assert_allclose(error_m, [along_normal, radial], atol=1e-14)
    np.testing.assert_allclose(axes @ axes.T, np.eye(2), atol=1e-15)
    np.testing.assert_allclose(axes[0], Z)


def test_mahalanobis_distance_of_a_correlated_error():
    covariance = np.array([[2.0, 1.0], [1.0, 2.0]])

    along = mahalanobis_squared(np.array([3.0, 3.0]), covariance)
    across = mahalanobis_squared(np.array([1.0, -1.0]), covariance)

    assert along == pytest.approx(18 / 3)
    assert across == pytest.approx(2 / 1)


def test_an_error_along_a_direction_that_is_claimed_to_be_exact_is_huge():
    covariance = np.diag([1.0, 1.0, 0.0])

    assert mahalanobis_squared(np.array([0.0, 0.0, 0.001]), covariance) > 1e5
    assert mahalanobis_squared(np.array([1.0, 1.0, 0.0]), covariance) == pytest.approx(2)


def test_mean_nees_of_errors_drawn_from_their_covariance_is_1(rng):
    factor = rng.normal(size=(3, 3))
    errors = rng.normal(size=(4000, 3)) @ factor.T

    nees = np.mean([mahalanobis_squared(error, factor @ factor.T) / 3 for error in errors])

    assert nees == pytest.approx(1, abs=4 * np.sqrt(2 / (3 * 4000)))


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3))
def test_tilts_lead_from_the_answer_to_the_truth(tilt_1, tilt_2):
    normal = np.array([0.48, -0.6, -0.64])
    truth = tilted(normal, np.array([tilt_1, tilt_2]))

    tilt_rad = tilt_error_rad(normal, truth)

    np.testing.assert_allclose(tilt_rad, [tilt_1, tilt_2], atol=1e-12)


def test_a_moving_truth_refuses_stamps_of_another_clock():
    truth = Truth(
        shot="a", expect="pose", center_m=ORIGIN, normal=-Z, stamp_s=100.0, velocity_m_s=np.array([0.1, 0, 0])
    )

    with pytest.raises(DataError, match=r"a: is stamped 900 s after its truth"):
        truth_at(truth, 1000.0)
    assert truth_at(truth, np.nan) is truth
