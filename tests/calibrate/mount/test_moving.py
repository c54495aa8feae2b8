"""The mount, and the offset of the clocks, by views of a robot that moves."""

from dataclasses import replace

import numpy as np
import pytest
from calibrated import chi_squared
from known_views import TRUE_CAMERA
from moving_robots import matrix, seen_by_a_moving_robot
from scipy.spatial.transform import Rotation

from ringpose.calibrate.mount.matching import motion_finding
from ringpose.calibrate.mount.moving import ToolMotion
from ringpose.calibrate.mount.pipeline import calibrate_mount, moving_stations
from ringpose.calibrate.mount.quality import (
    compared_mount,
    comparison_lines,
    mount_quality,
    mount_summary,
    mount_verdict,
)
from ringpose.errors import DataError
from ringpose.types.calibration import Grade
from ringpose.types.rig import RobotPoses


def motion_of(seen) -> ToolMotion:
    return ToolMotion(
        poses=RobotPoses(stamp_s=seen.robot_s, position_m=seen.poses[:, :3, 3], rotation=seen.poses[:, :3, :3]),
        locations=tuple(f"poses.csv:{number + 2}" for number in range(len(seen.poses))),
    )


def stations_of(seen, eye_to_hand=False, exposure_s=0.002):
    exposures_s = [exposure_s] * len(seen.views)
    return moving_stations(
        seen.views, TRUE_CAMERA, seen.stamps_s, exposures_s, motion_of(seen), eye_to_hand=eye_to_hand
    )


def calibrated(seen, eye_to_hand=False, exposure_s=0.002):
    return calibrate_mount(stations_of(seen, eye_to_hand, exposure_s)[0], TRUE_CAMERA, eye_to_hand=eye_to_hand)


def errors_of(calibration, seen) -> tuple[np.ndarray, float]:
    """Of the mount (rotation vector, translation) and the delay."""
    estimated = calibration.solution.state.mount
    turn = Rotation.from_matrix(seen.mount[:3, :3] @ estimated.rotation.T).as_rotvec()
    shift_m = seen.mount[:3, 3] - estimated.translation_m
    return np.append(turn, shift_m), seen.delay_s - calibration.solution.state.delay_s


@pytest.fixture(scope="module")
def usual():
    """A session, its calibration, with exposures in which the corners move by a tenth of their residuals."""
    seen = seen_by_a_moving_robot(np.random.default_rng(5))
    return seen, calibrated(seen, exposure_s=0.0002)


@pytest.mark.parametrize(
    ("eye_to_hand", "rate_hz", "delay_s"), [(False, 10.0, -0.35), (True, 500.0, 0.41)], ids=["in-hand", "to-hand"]
)
def test_mount_and_delay_are_as_accurate_as_reported(eye_to_hand, rate_hz, delay_s, rng):
    seen = seen_by_a_moving_robot(rng, eye_to_hand=eye_to_hand, rate_hz=rate_hz, delay_s=delay_s)

    calibration = calibrated(seen, eye_to_hand)

    error, delay_error_s = errors_of(calibration, seen)
    assert np.abs(error / np.sqrt(np.diag(calibration.covariance)[:6])).max() < 4.5
    assert abs(delay_error_s) < 4.5 * calibration.delay_sd_s
    assert calibration.delay_sd_s < 1e-3
    assert calibration.is_delay_known
    assert calibration.mount.delay_s == calibration.solution.state.delay_s
    assert calibration.mount.delay_sd_s == pytest.approx(
        np.hypot(calibration.delay_sd_s, calibration.solution.stamp_sd_s)
    )
    verdict = mount_verdict(calibration)
    sign = "-" if delay_s < 0.0 else "+"
    assert f"the robot's stamps are those of the camera {sign} " in " ".join(mount_summary(calibration, verdict))
    assert mount_quality(calibration, verdict)["delay"]["is_determined"]


def test_stamps_that_scatter_are_told_from_errors_of_the_robot(rng):
    """As those that a computer gives to images when they arrive."""
    seen = seen_by_a_moving_robot(rng, robot=(1e-4, 5e-5))
    late_s = rng.normal(0, 3e-3, len(seen.views))
    seen = seen._replace(stamps_s=(seen.stamps_s + late_s).tolist())

    calibration = calibrated(seen)

    assert calibration.solution.stamp_sd_s == pytest.approx(3e-3, rel=0.5)
    assert calibration.solution.sigmas.rotation_rad < 2e-4
    error, delay_error_s = errors_of(calibration, seen)
    assert abs(delay_error_s) < 4.0 * calibration.delay_sd_s
    assert np.abs(error / np.sqrt(np.diag(calibration.covariance)[:6])).max() < 4.5
    assert "use the camera's own stamps" in " ".join(mount_verdict(calibration).advice)


def test_a_given_mount_is_compared_with_its_delay(usual):
    _, calibration = usual
    given = replace(calibration.mount, delay_s=calibration.mount.delay_s + 0.01)

    comparison = compared_mount(calibration, given)

    assert comparison.sigmas > 4.0
    assert "its delay by 10.00 ms" in comparison_lines(comparison, mount_verdict(calibration))[0]


def test_a_robot_that_halts_at_each_view_leaves_the_delay_open(rng):
    seen = seen_by_a_moving_robot(rng, still=True)

    calibration = calibrated(seen)

    assert calibration.open_delay is not None
    error, delay_error_s = errors_of(calibration, seen)
    assert abs(delay_error_s) < 2.5 * calibration.delay_sd_s
    assert calibration.delay_sd_s > 0.05
    assert np.abs(error / np.sqrt(np.diag(calibration.covariance)[:6])).max() < 4.5
    verdict = mount_verdict(calibration)
    assert verdict.grade is Grade.IMPROVABLE
    assert "is not determined" in " ".join(mount_summary(calibration, verdict))
    assert "leave out --moving" in " ".join(verdict.advice)


def test_a_mistyped_pose_is_left_out_and_its_line_named(rng):
    seen = seen_by_a_moving_robot(rng, rate_hz=25.0)
    wrong = int(np.argmin(np.abs(seen.robot_s - seen.stamps_s[6] - seen.delay_s)))
    seen.poses[wrong, 1, 3] += 0.05

    calibration = calibrated(seen)

    assert list(calibration.rejected) == ["view06"]
    assert f"poses.csv:{wrong + 2}: the robot's pose is " in calibration.rejected["view06"]


@pytest.mark.parametrize(
    ("clock", "words"),
    [
        (lambda robot_s: robot_s + 2.0, r"those of the camera \+2\.[01] s.*use NTP"),
        (lambda robot_s: robot_s - robot_s[0], "the views are stamped .*likely the clocks are not synchronised"),
        (lambda robot_s: 1e3 * (robot_s - robot_s[0] + 10.0), "likely the robot's stamps are in milliseconds"),
    ],
    ids=["seconds apart", "since start", "milliseconds"],
)
def test_clocks_that_are_too_far_apart_are_refused_with_the_likely_cause(clock, words, rng):
    seen = seen_by_a_moving_robot(rng, rate_hz=50.0)

    with pytest.raises(DataError, match=words):
        stations_of(seen._replace(robot_s=clock(seen.robot_s)))


def as_wxyz(pose):
    quaternion = np.roll(Rotation.from_matrix(pose[:3, :3]).as_quat(), 1)
    return matrix(Rotation.from_quat(quaternion).as_rotvec(), pose[:3, 3])


@pytest.mark.parametrize(
    ("change", "cause"),
    [(as_wxyz, "the quaternions are wxyz"), (np.linalg.inv, "inverted")],
    ids=["quaternion", "inverted"],
)
def test_poses_read_by_another_convention_are_refused_with_the_likely_cause(change, cause, rng):
    seen = seen_by_a_moving_robot(rng, rate_hz=50.0, delay_s=0.3, views=8)
    seen = seen._replace(poses=np.array([change(pose) for pose in seen.poses]))

    with pytest.raises(DataError, match=cause):
        calibrated(seen)


def test_views_without_poses_of_the_robot_around_them_are_named(rng):
    seen = seen_by_a_moving_robot(rng, rate_hz=50.0)
    late = seen.robot_s > seen.stamps_s[2]

    stations, problems = stations_of(seen._replace(robot_s=seen.robot_s[late], poses=seen.poses[late]))

    assert [problem.location for problem in problems][:2] == ["view00", "view01"]
    assert "the robot's poses begin" in str(problems[0])
    assert len(stations) == len(seen.views) - len(problems)


def test_an_exposure_that_is_too_long_for_the_motion_is_flagged(usual):
    _, calibration = usual
    stations = tuple(replace(one, sighting=replace(one.sighting, exposure_s=0.05)) for one in calibration.stations)
    words = "expose shorter or move slower"

    assert words not in " ".join(mount_verdict(calibration).advice)
    assert words in " ".join(mount_verdict(replace(calibration, stations=stations)).advice)


def test_motion_at_the_views_is_noticed_where_rest_is_assumed(rng):
    moving, resting = (seen_by_a_moving_robot(rng, delay_s=0.0, rate_hz=50.0, still=still) for still in (False, True))

    assert "the robot moves at 10 of 10 views" in motion_finding(moving.stamps_s, motion_of(moving))
    assert not motion_finding(resting.stamps_s, motion_of(resting))


def test_a_tool_that_always_moves_alike_makes_the_delay_part_of_the_mount(rng):
    """A constant twist of the tool displaces all poses alike for all delays, as another mount does."""
    seen = seen_by_a_moving_robot(rng, rate_hz=50.0, delay_s=0.0, robot=(0.0, 0.0))
    poses, stamps_s = [], []
    twist = np.array([0.1, -0.05, 0.1, 0.05, 0.02, 0.0])
    middle_s = [int(np.argmin(np.abs(seen.robot_s - stamp_s))) for stamp_s in seen.stamps_s]
    for number, index in enumerate(middle_s):
        for step in np.arange(-40, 41):
            after_s = 0.02 * step + seen.robot_s[index] - seen.stamps_s[number]
            poses.append(seen.poses[index] @ matrix(after_s * twist[:3], after_s * twist[3:]))
            stamps_s.append(seen.stamps_s[number] + after_s)
    order = np.argsort(stamps_s)
    seen = seen._replace(robot_s=np.array(stamps_s)[order], poses=np.array(poses)[order])

    calibration = calibrated(seen)

    assert calibration.delay_sd_s > 0.02
    error, delay_error_s = errors_of(calibration, seen)
    assert abs(delay_error_s) < 4.0 * calibration.delay_sd_s
    assert np.abs(error / np.sqrt(np.diag(calibration.covariance)[:6])).max() < 4.0


@pytest.mark.slow
def test_the_nees_of_mount_and_delay_is_in_its_band(rng):
    """Over delays, rates of the poses, qualities of the robot and of the stamps, and both places of the camera."""
    runs, of_mount, of_delay = 12, [], []
    for run in range(runs):
        eye_to_hand = bool(run % 2)
        seen = seen_by_a_moving_robot(
            rng, eye_to_hand=eye_to_hand, delay_s=rng.uniform(-0.45, 0.45), rate_hz=(10.0, 30.0, 125.0, 500.0)[run % 4],
            robot=((3.5e-4, 1e-4), (1e-4, 3e-5), (1e-3, 4e-4))[run % 3], views=(10, 15, 20)[run // 4 % 3],
            period_s=(3.0, 6.0)[run // 2 % 2],
        )  # fmt: skip
        late_s = (0.0, 1e-3, 5e-3)[run // 3 % 3] * rng.normal(size=len(seen.views))
        seen = seen._replace(stamps_s=(seen.stamps_s + late_s).tolist())
        calibration = calibrated(seen, eye_to_hand)
        error, delay_error_s = errors_of(calibration, seen)
        of_mount.append(error @ np.linalg.solve(calibration.covariance[:6, :6], error) / 6)
        of_delay.append((delay_error_s / calibration.delay_sd_s) ** 2)
    for nees, degrees_of_freedom in ((of_mount, 6), (of_delay, 1)):
        low, high = chi_squared([0.005, 0.995], runs * degrees_of_freedom) / (runs * degrees_of_freedom)
        assert low < np.mean(nees) < high
