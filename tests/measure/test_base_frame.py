"""Poses in the base frame of a robot that carries the camera: mount and clock have errors as stated."""

from dataclasses import replace

import numpy as np
import pytest
from calibrated import DRAWS, assert_calibrated
from moving_cameras import SeenByRobot, in_base, robot
from moving_rings import START_S, Motion
from ring_scenes import face_points_of, nees, ring_at, scene_of

from ringpose.files.rigs import read_rig
from ringpose.measure.stream import pose_line
from ringpose.types.assumptions import NOISE_ONLY, AssumptionOptions
from ringpose.types.detection import Detection
from ringpose.types.options import PoseFrame
from ringpose.types.pose import NoPose

PERIOD_S = 1 / 30
TURN_SD_RAD, SHIFT_SD_M, DELAY_SD_S = 1e-3, 5e-4, 2e-3


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


@DRAWS
def test_errors_in_the_base_are_as_large_as_reported(rig, rng, draws):
    errors = {"normal": [], "grasp": [], "center": []}
    for _ in range(draws):
        target = still_target(rig, rng)
        turn_rad, shift_m = TURN_SD_RAD * rng.normal(size=3), SHIFT_SD_M * rng.normal(size=3)
        seen = SeenByRobot(target, turn_rad, shift_m, DELAY_SD_S * rng.normal())
        camera = robot(1.0, (TURN_SD_RAD, SHIFT_SD_M), DELAY_SD_S)
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
