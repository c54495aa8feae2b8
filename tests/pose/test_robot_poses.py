"""A ring seen from a camera that a robot moves within the shot (ringpose-method(7), section 8)."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from ring_scenes import Scene, edges_in_frames, face_points_of, make_scene, scene_of

from ringpose.estimate.pose_errors import mahalanobis_squared, tilt_error_rad
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.ring import displacement_increments, ring_arcs
from ringpose.measure.stream import pose_line, pose_result
from ringpose.types.assumptions import USUAL, Assumptions, MotionPrior
from ringpose.types.detection import Detection
from ringpose.types.pose import NoPose, PoseFlag, RingPose
from ringpose.types.rig import MOUNT_PARAMETERS, Mount, RobotPoses

STAMPS_S = 100.0 + np.arange(3) / 30
STILL = Assumptions()
TOOL_FROM_CAMERA = np.array([[0.0, -1, 0, 0.1], [1, 0, 0, 0.05], [0, 0, 1, -0.1], [0, 0, 0, 1]])
ROTATION_SD_RAD, TRANSLATION_SD_M, DELAY_SD_S = 0.01, 0.003, 0.002


def base_from_tool(stamp_s):
    """A tool that swings to and fro, at up to 0.15 m/s and 0.3 rad/s."""
    phase = 4.0 * (stamp_s - 100.0)
    matrix = np.eye(4)
    matrix[:3, :3] = cv2.Rodrigues(np.array([0.05, -0.06, 0.04]) * np.sin(phase + 0.3))[0]
    matrix[:3, 3] = np.array([1.0, 0.5, 0.8]) + np.array([0.02, 0.03, -0.02]) * np.sin(phase)
    return matrix


def robot(delay_s=0.0, sds=(0.0, 0.0, 0.0), mount=TOOL_FROM_CAMERA, until_s=100.4, period_s=0.01):
    """What the robot reports."""
    stamps_s = np.arange(99.7, until_s, period_s)
    poses = np.array([base_from_tool(stamp_s) for stamp_s in stamps_s])
    return CameraMotion(
        poses=RobotPoses(stamp_s=stamps_s, position_m=poses[:, :3, 3], rotation=poses[:, :3, :3]),
        mount=Mount(
            carrier_from_camera=mount,
            root=np.diag([sds[0]] * 3 + [sds[1]] * 3),
            delay_s=delay_s,
            delay_sd_s=sds[2],
        ),
    )


def seen_at(ring, stamp_s, mount=TOOL_FROM_CAMERA, delay_s=0.0):
    """A ring at rest, given as the camera sees it at 100 s, as the camera sees it at a stamp of its clock."""
    then, now = (np.linalg.inv(base_from_tool(each + delay_s) @ mount) for each in (100.0, stamp_s))
    return ring.moved_by(now @ np.linalg.inv(then))


def seen_by_robot(scene, **truth):
    """The scene as its lasers show it one after the other."""
    lasers = scene.rig.lasers
    rings = [seen_at(scene.ring, stamp_s, **truth) for stamp_s in STAMPS_S]
    points_m = np.array([ring.break_points_m(lasers)[laser] for laser, ring in enumerate(rings)])
    return scene_of(scene.rig, scene.ring, points_m)


def measured(scene, rng, sigma_px=0.1):
    return replace(face_points_of(scene, sigma_px, sigma_px / 10, rng), stamp_s=STAMPS_S)


@pytest.fixture
def scene() -> Scene:
    return make_scene("B", distance_m=0.5, tilt_rad=(0.15, -0.1))


def test_without_noise_a_still_ring_is_where_it_is_at_the_stamp_of_the_pose(scene):
    points = measured(seen_by_robot(scene), None)

    result = pose_result(points, scene.rig, assumptions=STILL, camera=robot(period_s=0.001))

    truth = seen_at(scene.ring, result.stamp_s)
    np.testing.assert_allclose(result.pose.center_m, truth.center_m, atol=1e-5)
    np.testing.assert_allclose(result.pose.normal, truth.normal, atol=1e-5)
    assert result.measurement.camera_motion == "robot_poses"
    assert not result.measurement.nuisance_parameters


def test_the_centre_is_right_with_the_robots_poses_and_not_without(scene, rng):
    points = measured(seen_by_robot(scene), rng)

    def is_right(result):
        covariance = result.pose.covariance_center_m2 if isinstance(result.pose, RingPose) else None
        error_m = None if covariance is None else result.pose.center_m - seen_at(scene.ring, result.stamp_s).center_m
        return error_m is not None and not result.flags and mahalanobis_squared(error_m, covariance) < 5**2

    assert is_right(pose_result(points, scene.rig, assumptions=STILL, camera=robot()))
    assert not is_right(pose_result(points, scene.rig, assumptions=STILL))


@pytest.mark.parametrize(("delay_s", "flagged"), [(0.0, False), (0.25, True)])
def test_a_wrong_delay_of_the_robots_clock_shows_as_a_motion(scene, rng, delay_s, flagged):
    points = measured(seen_by_robot(scene, delay_s=delay_s), rng)
    stamps_s = STAMPS_S[0] - 1 / 30, STAMPS_S[-1] + 1 / 30  # the ambient light shows the edges
    rings = {each: seen_at(scene.ring, each, delay_s=delay_s) for each in stamps_s}
    edges = edges_in_frames(scene.rig, rings, 30, 0.2, rng)

    result = pose_result(points, scene.rig, ring_edges=edges, assumptions=STILL, camera=robot(delay_s=0.0))

    assert bool(result.flags & PoseFlag.MOTION) == flagged


def test_a_velocity_is_relative_to_the_base(scene, rng):
    points = measured(seen_by_robot(scene), rng, sigma_px=0.02)
    motion = MotionPrior(speed_sd_m_s=0.025, rate_sd_rad_s=0.04)

    result = pose_result(points, scene.rig, assumptions=Assumptions(motion=motion), camera=robot())

    assert mahalanobis_squared(result.velocity.center_m_s, result.velocity.covariance[:3, :3]) < 3 * 9
    assert np.linalg.norm(result.velocity.center_m_s) < 0.1


def test_poses_of_the_robot_that_end_before_the_shot_give_no_pose_and_a_line_that_says_why(scene, rng):
    points = measured(seen_by_robot(scene), rng)
    detection = Detection(shot="shot", stamp_s=float(STAMPS_S[0]), break_points=points)

    line = pose_line(detection, scene.rig, options=USUAL, camera=robot(until_s=100.02))

    assert pose_result(points, scene.rig, camera=robot(until_s=100.02)).pose is NoPose.NO_ROBOT_POSES
    assert line.status == "none"
    assert "robot" in line.reason


@pytest.mark.slow
def test_errors_of_mount_and_delay_are_covered_and_part_of_the_measurement(rng):
    sds, errors = (ROTATION_SD_RAD, TRANSLATION_SD_M, DELAY_SD_S), []
    for _ in range(30):
        scene = make_scene(
            "B", distance_m=0.5, tilt_rad=tuple(0.15 * rng.normal(size=2)), turn_rad=rng.uniform(-0.3, 0.3)
        )
        mount = TOOL_FROM_CAMERA.copy()
        mount[:3, :3] = cv2.Rodrigues(ROTATION_SD_RAD * rng.normal(size=3))[0] @ mount[:3, :3]
        mount[:3, 3] += TRANSLATION_SD_M * rng.normal(size=3)
        truth = {"mount": mount, "delay_s": DELAY_SD_S * rng.normal()}
        points = measured(seen_by_robot(scene, **truth), rng, sigma_px=0.03)

        result = pose_result(points, scene.rig, assumptions=STILL, camera=robot(sds=sds))

        ring = seen_at(scene.ring, result.stamp_s, **truth)
        assert result.measurement.nuisance_parameters == MOUNT_PARAMETERS
        errors.append(
            (
                mahalanobis_squared(result.pose.center_m - ring.center_m, result.pose.covariance_center_m2),
                mahalanobis_squared(tilt_error_rad(result.pose.normal, ring.normal), result.pose.covariance[:2, :2]),
            )
        )
    center, normal = np.mean(errors, axis=0) / (3, 2)
    # 99 % of chi-squared with 90 and 60 degrees of freedom
    assert 0.65 < center < 1.42
    assert 0.58 < normal < 1.54


def test_increments_by_a_displacement_of_the_camera_are_those_of_differences(scene, rng):
    ring = scene.ring
    arcs = ring_arcs(ring.center_m, ring.normal, ring.radius_m, scene.points_m.mean(axis=(0, 1)))
    displacement, step = rng.normal(size=6), 1e-6

    def displaced(size):
        rotation = cv2.Rodrigues(size * displacement[:3])[0]
        origin = rotation @ arcs.origin + size * displacement[3:]
        return replace(arcs, origin=origin, axes=arcs.axes @ rotation.T)

    moved = [displaced(sign * step) for sign in (1, -1)]
    expected = (moved[0].center - moved[1].center) / (2 * step), (moved[0].normal - moved[1].normal) / (2 * step)
    after = [arcs.retract(sign * step * (displacement_increments(arcs) @ displacement)) for sign in (1, -1)]

    np.testing.assert_allclose((after[0].center - after[1].center) / (2 * step), expected[0], atol=1e-8)
    np.testing.assert_allclose((after[0].normal - after[1].normal) / (2 * step), expected[1], atol=1e-8)
