import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ringpose.geometry.rotations import facing_normal
from ringpose.simulate.placement import Placement, ring_rotation
from ringpose.types.pose import RingPose

PLACEMENT = Placement(rotation=ring_rotation(facing_normal(0.2, -0.3), 0.4), translation_m=np.array([0.1, 0.2, 0.5]))

ANGLE = st.floats(-1.2, 1.2)


def pose_with(normal):
    return RingPose(
        center_m=np.zeros(3), normal=normal, radius_inner_m=1.0, radius_outer_m=1.1, grasp_m=np.zeros(3),
        method="paper", condition_number=1.0, residual_rms_px=0.0,
    )  # fmt: skip


@given(ANGLE, ANGLE)
def test_the_normal_has_the_papers_pitch_and_yaw(pitch_rad, yaw_rad):
    pose = pose_with(facing_normal(pitch_rad, yaw_rad))

    assert (pose.pitch_rad, pose.yaw_rad) == pytest.approx((pitch_rad, yaw_rad), abs=1e-12)


@given(ANGLE, ANGLE, st.floats(-3, 3))
def test_axes_are_a_rotation_with_the_normal_as_z(pitch_rad, yaw_rad, roll_rad):
    normal = facing_normal(pitch_rad, yaw_rad)

    rotation = ring_rotation(normal, roll_rad)

    np.testing.assert_allclose(rotation @ rotation.T, np.eye(3), atol=1e-12)
    assert np.linalg.det(rotation) == pytest.approx(1.0)
    np.testing.assert_allclose(rotation[:, 2], normal, atol=1e-12)


def test_there_and_back_is_identity(rng):
    points = rng.standard_normal((3, 20))

    back = PLACEMENT.points_target(PLACEMENT.points_camera(points.T).T)

    np.testing.assert_allclose(back, points, atol=1e-12)


def test_the_eye_is_the_centre_of_the_camera():
    np.testing.assert_allclose(PLACEMENT.points_camera(PLACEMENT.eye_m), np.zeros(3), atol=1e-15)
