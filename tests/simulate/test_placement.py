from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ringpose.geometry.rotations import facing_normal
from ringpose.simulate.pipeline import illuminated_ring, view_truth
from ringpose.simulate.placement import Placement, ring_rotation
from ringpose.simulate.renderer import layers, pixel_rays
from ringpose.types.pose import RingPose
from ringpose.types.rig import LaserPlanes
from ringpose.types.scene import Light, RingView, Scene
from ringpose.types.target import MATERIALS, Gap, RingShape

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


def test_there_and_back_is_identity_and_the_eye_is_the_centre_of_the_camera(rng):
    points = rng.standard_normal((3, 20))

    back = PLACEMENT.points_target(PLACEMENT.points_camera(points.T).T)

    np.testing.assert_allclose(back, points, atol=1e-12)
    np.testing.assert_allclose(PLACEMENT.points_camera(PLACEMENT.eye_m), np.zeros(3), atol=1e-15)


def test_pixels_of_a_pose_that_was_computed_by_hand(small_rig):
    """Fixes the convention of poses: a ring that faces the camera 2 m away, its x axis turned by 90 degrees.

    With f = 100 px and the principal point (160, 120), a metre at 2 m is 50 px. At a roll of 90 degrees the target's x
    axis points up in the image, so that a gap at the angle 0 is above the centre, at row 120 - 50 * 0.75 = 82.5.
    The light plane y = 0.6 meets the circles of 0.65 and 0.85 m at x = +-0.25 and +-0.6021, row 120 + 30 = 150.
    """
    camera = replace(
        small_rig.camera,
        camera_matrix=np.array([[100.0, 0.0, 160.0], [0.0, 100.0, 120.0], [0.0, 0.0, 1.0]]),
        distortion_coefficients=np.zeros(5),
    )
    lasers = LaserPlanes(
        names=("only",),
        normal=np.array([[0.0, 1.0, 0.0]]),
        distance_m=np.array([0.6]),
        projector_m=np.array([[0.0, 0.6, 0.0]]),
    )
    profile_m = np.array([[0.65, 0.0], [0.65, 0.1], [0.85, 0.1], [0.85, 0.0]])
    ring = RingShape(profile_m=profile_m, face=MATERIALS["white"], gaps=(Gap(angle_rad=0.0, width_m=0.2, depth_m=0.1),))
    sun = Light(name="dim", sun_w_m2=10.0, sun_direction=np.array([0.0, 0.0, -1.0]))
    view = RingView(
        name="by hand", center_m=np.array([0.0, 0.0, 2.0]), normal=np.array([0.0, 0.0, -1.0]), roll_rad=np.pi / 2
    )
    scene = Scene(rig=replace(small_rig, camera=camera, lasers=lasers), ring=ring, lights={"dim": sun}, views=(view,))
    illuminated = illuminated_ring(scene, view)

    truth = view_truth(scene, view, illuminated)
    image = layers(illuminated, pixel_rays(camera)).ambient

    left = truth.break_points_px[0, 0, 0] < 160
    expected = np.array([[160 + 50 * 0.25, 150.0], [160 + 50 * np.sqrt(0.85**2 - 0.6**2), 150.0]])
    expected[:, 0] = 320 - expected[:, 0] if left else expected[:, 0]
    np.testing.assert_allclose(truth.break_points_px[0], expected, atol=1e-9)
    bright = image > image.max() / 2
    assert not bright[82, 160]  # the gap, above the centre
    assert bright[157, 160]  # below it
    assert bright[120, 160 - 37]  # to the left ...
    assert bright[120, 160 + 37]  # ... and to the right
    assert not bright[120, 160]
