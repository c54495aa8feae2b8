"""Poses in the base frame of a robot: its poses, the mount and the clock have errors as stated."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from calibrated import DRAWS, assert_calibrated
from moving_cameras import SeenByRobot, base_from_tool, in_base, random_error, robot
from moving_rings import START_S, Motion
from ring_scenes import face_points_of, nees, ring_at, scene_of

from ringpose.files.rigs import read_rig
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.measure.stream import pose_line
from ringpose.types.assumptions import NOISE_ONLY, AssumptionOptions
from ringpose.types.detection import Detection
from ringpose.types.options import PoseFrame
from ringpose.types.pose import NoPose
from ringpose.types.rig import Mount

PERIOD_S = 1 / 30
TURN_SD_RAD, SHIFT_SD_M, DELAY_SD_S = 1e-3, 5e-4, 2e-3
ROBOT_SD = (2e-3, 1e-3)


@pytest.fixture(scope="module")
def rig(carried_data):
    rig = read_rig(carried_data / "rig_b" / "rig.yaml")
    return replace(rig, covariance=None)


def seen_shot(seen, rig, rng):
    """The features of a shot whose lasers are switched one after the other."""
    lasers = range(len(rig.lasers.names))
    points_m = np.array([seen.at(PERIOD_S * k).break_points_m(rig.lasers)[k] for k in lasers])
    points = face_points_of(scene_of(rig, seen.at(0.0), points_m), 0.3, 0.05, rng)
    points = replace(points, stamp_s=START_S + PERIOD_S * np.arange(len(lasers)))
    return Detection(shot="a", stamp_s=START_S, break_points=points, lasers_on=np.ones(len(lasers), dtype=bool))


def still_target(rig, rng) -> Motion:
    tilt_rad = tuple(rng.uniform(-0.2, 0.2, 2))
    return in_base(Motion(ring=ring_at(rig, tilt_rad=tilt_rad), velocity_m_s=np.zeros(3), rate_rad_s=np.zeros(3)))


@pytest.mark.slow
@DRAWS
def test_errors_in_the_base_are_as_large_as_reported(rig, rng, draws):
    errors = {"normal": [], "grasp": [], "center": []}
    for _ in range(draws):
        target = still_target(rig, rng)
        turn_rad, shift_m = TURN_SD_RAD * rng.normal(size=3), SHIFT_SD_M * rng.normal(size=3)
        seen = SeenByRobot(target, turn_rad, shift_m, DELAY_SD_S * rng.normal())
        of_robot = random_error(rng, ROBOT_SD)
        camera = robot(1.0, (TURN_SD_RAD, SHIFT_SD_M), DELAY_SD_S, robot_sd=ROBOT_SD, error=of_robot)
        line = pose_line(seen_shot(seen, rig, rng), rig, frame=PoseFrame.BASE, options=NOISE_ONLY, camera=camera)
        assert line.frame is PoseFrame.BASE
        for name, value in nees(line.pose, target.at(0.0)).items():
            errors[name].append(value)
    assert_calibrated(errors["normal"], 2)
    assert_calibrated(errors["grasp"], 2)
    assert_calibrated(errors["center"], 3)


def test_a_target_at_rest_has_no_velocity_in_the_base(rig, rng):
    seen = SeenByRobot(still_target(rig, rng))
    line = pose_line(
        seen_shot(seen, rig, rng), rig, frame=PoseFrame.BASE, options=AssumptionOptions(), camera=robot(1.0)
    )
    assert np.linalg.norm(line.velocity.center_m_s / np.sqrt(np.diag(line.velocity.covariance)[:3])) < 4.0


def test_a_shot_that_the_robots_poses_do_not_cover_has_no_pose_in_the_base(rig, rng):
    seen = SeenByRobot(still_target(rig, rng))
    line = pose_line(seen_shot(seen, rig, rng), rig, frame=PoseFrame.BASE, camera=robot(-0.2))
    assert (line.status, line.frame) == ("none", PoseFrame.BASE)
    assert str(NoPose.NO_ROBOT_POSES.value) in line.reason


@DRAWS
def test_a_camera_beside_the_robot_is_at_rest_in_the_base_and_moves_in_the_tool(rig, rng, draws):
    delay_sd_s = 0.02
    root = np.diag([TURN_SD_RAD] * 3 + [SHIFT_SD_M] * 3)
    base_from_camera = np.eye(4)
    base_from_camera[:3, :3], base_from_camera[:3, 3] = cv2.Rodrigues(np.array([2.0, 0.3, -0.2]))[0], [1.2, 0.1, 0.5]
    mount = Mount(
        carrier_from_camera=base_from_camera, root=root, delay_sd_s=delay_sd_s, carrier=PoseFrame.BASE,
        robot_rotation_sd_rad=ROBOT_SD[0], robot_translation_sd_m=ROBOT_SD[1],
    )  # fmt: skip
    mounted, errors = replace(rig, mount=mount), {PoseFrame.BASE: [], PoseFrame.TOOL: []}
    for _ in range(draws):
        target = Motion(
            ring=ring_at(rig, tilt_rad=tuple(rng.uniform(-0.2, 0.2, 2))),
            velocity_m_s=np.zeros(3),
            rate_rad_s=np.zeros(3),
        )
        shot = seen_shot(target, rig, rng)
        true = base_from_camera.copy()
        true[:3, :3] = cv2.Rodrigues(TURN_SD_RAD * rng.normal(size=3))[0] @ true[:3, :3]
        true[:3, 3] += SHIFT_SD_M * rng.normal(size=3)
        delay_s = delay_sd_s * rng.normal()
        poses = robot(1.0, error=random_error(rng, ROBOT_SD)).poses
        for frame, camera in ((PoseFrame.BASE, None), (PoseFrame.TOOL, CameraMotion(poses=poses, mount=mount))):
            line = pose_line(shot, mounted, frame=frame, options=NOISE_ONLY, camera=camera)
            time_s = line.pose_stamp_s - START_S + delay_s
            moved = true if frame is PoseFrame.BASE else np.linalg.inv(base_from_tool(time_s)) @ true
            assert (line.frame, line.measurement.camera_motion) == (frame, "none")
            errors[frame].append(nees(line.pose, target.at(0.0).moved_by(moved))["center"])
    for each in errors.values():
        assert_calibrated(each, 3)


def test_a_shot_that_the_robots_poses_do_not_cover_has_no_pose_in_the_tool_of_a_camera_beside_it(rig, rng):
    target = Motion(ring=ring_at(rig), velocity_m_s=np.zeros(3), rate_rad_s=np.zeros(3))
    mount = Mount(carrier_from_camera=np.eye(4), root=np.zeros((6, 6)), carrier=PoseFrame.BASE)
    camera = CameraMotion(poses=robot(-0.2).poses, mount=mount)
    line = pose_line(seen_shot(target, rig, rng), replace(rig, mount=mount), frame=PoseFrame.TOOL, camera=camera)
    assert (line.status, line.velocity) == ("none", None)
    assert str(NoPose.NO_ROBOT_POSES.value) in line.reason
