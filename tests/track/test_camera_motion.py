"""A camera that a robot carries: the track is in the robot's base frame."""

from dataclasses import replace

import cv2
import moving_cameras
import numpy as np
import pytest
from calibrated import chi_squared
from moving_cameras import RATE, TOOL_FROM_CAMERA, SeenByRobot, base_from_tool, random_error, robot
from moving_rings import START_S, Motion, Shots, drawn_motion, stream
from ring_scenes import RIGS, pixels_of
from tracked_rings import errors_at, nees_at, newest, track_of

from ringpose.geometry.camera_motion import CameraMotion
from ringpose.measure.warm_start import WarmStart
from ringpose.track.pipeline import Tracker
from ringpose.track.prediction import predicted_ring, predicted_stripes
from ringpose.types.rig import Mount
from ringpose.types.track import FusionStatus


@pytest.fixture
def in_base(rng) -> Motion:
    """A ring in slow motion in the base frame, in view of the camera at the start."""
    return moving_cameras.in_base(drawn_motion(rng, speed_m_s=0.005, rate_deg_s=0.3))


def test_the_pose_of_the_camera_is_interpolated_between_those_of_the_robot():
    state = robot(2.0).at(START_S + 0.731)

    expected = base_from_tool(0.731) @ TOOL_FROM_CAMERA
    assert state is not None
    np.testing.assert_allclose(state.rotation, expected[:3, :3], atol=1e-6)
    np.testing.assert_allclose(state.origin_m, expected[:3, 3], atol=1e-5)
    ahead = base_from_tool(0.732) @ TOOL_FROM_CAMERA
    np.testing.assert_allclose(state.velocity_m_s, (ahead - expected)[:3, 3] / 0.001, atol=1e-4)
    np.testing.assert_allclose(state.rate_rad_s, RATE, atol=1e-6)


@pytest.mark.parametrize(("time_s", "word"), [(-0.6, "begin"), (2.1, "end"), (np.nan, "unknown")])
def test_a_time_that_the_poses_do_not_cover_has_no_camera(time_s, word):
    assert robot(2.0).at(START_S + time_s) is None
    assert word in robot(2.0).why_not_at(START_S + time_s)


@pytest.mark.parametrize("stamp_s", [np.nan, np.inf, START_S, START_S + 60.0, START_S + 1e9])
def test_a_robot_is_not_taken_to_go_on_for_long(stamp_s):
    steady = robot(2.0)

    assert steady.going_on_until(stamp_s) is steady


@pytest.mark.parametrize("jump", ["position", "rotation"])
def test_poses_that_jump_as_no_robot_can_have_no_camera_beside_the_jump(jump):
    steady = robot(2.0)
    position_m, rotation = steady.poses.position_m.copy(), steady.poses.rotation.copy()
    if jump == "position":
        position_m[12] += [0.0, 0.0, 1.2]
    else:
        rotation[12] = rotation[12] @ cv2.Rodrigues(np.array([0.0, 3.0, 0.0]))[0]
    jumping = replace(steady, poses=replace(steady.poses, position_m=position_m, rotation=rotation))
    wrong_s = float(steady.poses.stamp_s[12])

    assert [jumping.at(wrong_s + time_s) is None for time_s in (-0.15, -0.05, 0.05, 0.15)] == [False, True, True, False]
    assert "jump" in jumping.why_not_at(wrong_s + 0.05)


@pytest.mark.parametrize("time_s", [1.95, 2.1, 2.7])
def test_a_robot_that_goes_on_is_where_its_last_speed_leads(time_s):
    steady, ended = robot(4.0), robot(2.0)

    expected, found = steady.at(START_S + time_s), ended.going_on_until(START_S + time_s).at(START_S + time_s)

    np.testing.assert_allclose(found.rotation, expected.rotation, atol=1e-6)
    np.testing.assert_allclose(found.origin_m, expected.origin_m, atol=5e-4)


def test_lasers_are_assigned_with_robot_poses_up_to_the_last_shot(in_base, rng):
    shots, lines = WarmStart(tracker := Tracker(None)), stream(SeenByRobot(in_base), 1.5, Shots(), rng)
    for line in lines:
        tracker.camera = robot(line.pose_stamp_s - START_S + 0.15)
        shots.added(line)

    assert tracker.camera.at(lines[-1].pose_stamp_s + 1 / 6) is None
    assert shots.assigns_lasers(RIGS["B"])


def test_a_first_shot_without_a_measurement_assigns_no_lasers(in_base, rng):
    shots, lines = WarmStart(Tracker(None, camera=robot(2.0))), stream(SeenByRobot(in_base), 1.5, Shots(), rng)

    shots.added(replace(lines[0], measurement=None))
    assert not shots.assigns_lasers(RIGS["B"])

    for line in lines[1:]:
        shots.added(line)
    assert shots.assigns_lasers(RIGS["B"])


def test_the_track_of_a_moving_camera_is_that_of_the_target_in_the_base(in_base, rng):
    tracker = Tracker(None, camera=robot(3.0))
    found = [tracker.add(line).fusion_status for line in stream(SeenByRobot(in_base), 1.5, Shots(), rng)]

    assert found.count(FusionStatus.FUSED) >= len(found) - 1  # one in a thousand is rejected by chance
    line = newest(tracker)
    nees = nees_at(in_base, line)
    assert (line.frame, line.camera) == ("base", "robot_poses")
    assert max(3 * nees["centre"], 3 * nees["velocity"]) < 16.3  # 99.9 % of chi-squared
    assert np.linalg.norm(errors_at(in_base, line)["velocity"][0]) < 0.005


@pytest.mark.slow
def test_errors_of_mount_and_clock_widen_the_covariance_and_do_not_average_out(in_base, rng):
    lines = stream(SeenByRobot(in_base), 2.0, Shots(), rng)

    def grasp_sd_m(**errors):
        line = newest(track_of(lines, camera=robot(3.0, **errors)))
        return np.sqrt(np.trace(line.grasp.covariance[:3, :3]))

    exact = grasp_sd_m()
    assert exact < 3e-4
    assert grasp_sd_m(mount_sd=(0.0, 0.002)) > 0.0025  # of two of three axes: the third lies along the face
    assert grasp_sd_m(mount_sd=(0.004, 0.0)) > 0.0018
    assert grasp_sd_m(delay_sd_s=0.1) > 0.001


@pytest.mark.slow
def test_errors_are_as_stated_if_mount_clock_and_robot_have_errors_as_stated(rng):
    """NEES of the grasp point and of the normal in the base frame, 24 runs with drawn errors."""
    squares, mount_sd, robot_sd, delay_sd_s = [], (0.002, 0.001), (0.001, 0.001), 0.01
    for _ in range(24):
        motion = moving_cameras.in_base(drawn_motion(rng, speed_m_s=0.005, rate_deg_s=0.3))
        errors = mount_sd[0] * rng.normal(size=3), mount_sd[1] * rng.normal(size=3), delay_sd_s * rng.normal()
        seen = stream(SeenByRobot(motion, *errors), 2.0, Shots(), rng)
        camera = robot(2.5, mount_sd, delay_sd_s, robot_sd=robot_sd, error=random_error(rng, robot_sd))
        found = nees_at(motion, newest(track_of(seen, camera=camera)))
        squares += [2 * found["grasp"], 2 * found["normal"]]

    least, most = chi_squared([5e-5, 1 - 5e-5], 2 * len(squares)) / 2
    assert least < np.sum(squares) / 2 < most


def test_a_displaced_mount_displaces_the_track_as_its_covariance_states(in_base, rng):
    """The error that the consider states describe, by its sign: a mount that is off by one standard deviation."""
    lines, sd_m = stream(SeenByRobot(in_base), 1.0, Shots(), rng, 4.0), 0.005
    wrong = Mount(
        carrier_from_camera=TOOL_FROM_CAMERA + sd_m * np.eye(4)[:, [2]] @ np.eye(4)[[3]],
        root=np.diag([0, 0, 0, 0, 0, sd_m]),
    )
    line = newest(track_of(lines, camera=CameraMotion(poses=robot(3.0).poses, mount=wrong)))
    ring = in_base.at(line.stamp_s - START_S)

    axial_m = (line.grasp.point_m - ring.center_m) @ ring.normal
    sd = np.sqrt(ring.normal @ line.grasp.covariance[:3, :3] @ ring.normal)
    assert abs(axial_m) == pytest.approx(sd_m, rel=0.15)
    assert sd == pytest.approx(sd_m, rel=0.15)


def test_a_measurement_that_the_poses_do_not_cover_is_rejected_and_the_track_goes_on(in_base, rng):
    tracker = Tracker(None, camera=robot(1.0))

    found = [tracker.add(line).fusion_status for line in stream(SeenByRobot(in_base), 1.4, Shots(), rng, 4.0)]

    assert found[:3] == [FusionStatus.FUSED] * 3
    assert found[-1] is FusionStatus.REJECTED_COVARIANCE


def test_the_prediction_of_a_track_in_the_base_frame_is_what_the_moving_camera_sees(in_base, rng):
    seen = SeenByRobot(in_base)
    tracker = track_of(stream(seen, 1.5, Shots(), rng), camera=robot(3.0))

    stamp_s, rig = tracker.track.stamp_s + 0.2, RIGS["B"]
    predicted = predicted_stripes([predicted_ring(tracker.track, stamp_s, tracker.camera)] * 3, rig)

    truth_px = pixels_of(seen.at(stamp_s - START_S).break_points_m(rig.lasers), rig.camera).reshape(-1, 2, 2)
    error_px = np.abs(predicted.position_px - truth_px)[predicted.seen]
    sigma_px = np.sqrt(predicted.covariance_px2[..., [0, 1], [0, 1]])[predicted.seen]
    assert (error_px < 4.5 * sigma_px).all()
