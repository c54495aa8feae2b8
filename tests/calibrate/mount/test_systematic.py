"""The mount on a six-axis arm whose joint angles, links and gears have errors: they are alike in neighbouring poses."""

from typing import NamedTuple

import numpy as np
import pytest
from calibrated import chi_squared
from known_views import CHESSBOARD, TRUE_CAMERA, board_view
from scipy.spatial.transform import Rotation

from ringpose.calibrate.mount.closed_form import Transform
from ringpose.calibrate.mount.pipeline import calibrate_mount
from ringpose.calibrate.mount.quality import mount_quality, mount_summary, mount_verdict
from ringpose.calibrate.mount.stations import Station
from ringpose.geometry.board import corner_points
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.types.options import PoseFrame
from ringpose.types.rig import RobotPoses

CORNERS_M = corner_points(CHESSBOARD)[::4].copy()
MIDDLE_M = np.array([0.15, 0.125, 0.0])


class Arm(NamedTuple):
    """A robot by Denavit and Hartenberg."""

    links: np.ndarray
    """a, alpha, d, offset of each joint."""
    middle: np.ndarray
    """The joints' places in the middle of a session."""
    sliding: tuple[bool, ...] = (False,) * 6
    """Which joints slide."""


ARM = Arm(  # of 1.2 m reach
    np.array([
        [0.15, -np.pi / 2, 0.4865, 0.0], [0.475, 0.0, 0.0, -np.pi / 2], [0.0, -np.pi / 2, 0.0, 0.0],
        [0.0, np.pi / 2, 0.6, 0.0], [0.0, -np.pi / 2, 0.0, 0.0], [0.0, 0.0, 0.065, np.pi],
    ]),
    np.array([0.2, 0.4, 0.1, 0.1, 0.9, 0.3]),
)  # fmt: skip
OFFSET_WRIST = Arm(  # 0.85 m, as collaborative arms have it
    np.array([
        [0.0, np.pi / 2, 0.1625, 0.0], [-0.425, 0.0, 0.0, 0.0], [-0.3922, 0.0, 0.0, 0.0],
        [0.0, np.pi / 2, 0.1333, 0.0], [0.0, -np.pi / 2, 0.0997, 0.0], [0.0, 0.0, 0.0996, 0.0],
    ]),
    np.array([0.3, -1.4, 1.6, -1.8, -1.4, 0.3]),
)  # fmt: skip
LARGE = Arm(  # 2 m, with a wrist whose axes meet
    np.array([
        [0.175, -np.pi / 2, 0.495, 0.0], [0.9, 0.0, 0.0, -np.pi / 2], [0.175, -np.pi / 2, 0.0, 0.0],
        [0.0, np.pi / 2, 0.96, 0.0], [0.0, -np.pi / 2, 0.0, 0.0], [0.0, 0.0, 0.135, np.pi],
    ]),
    np.array([1.0, 0.3, 0.4, -0.6, 0.8, 0.2]),
)  # fmt: skip
SCARA = Arm(  # two parallel axes, a column, and a wrist of three axes
    np.array([
        [0.325, 0.0, 0.4, 0.0], [0.275, 0.0, 0.0, 0.0], [0.0, 0.0, 0.0, 0.0],
        [0.0, -np.pi / 2, 0.0, 0.0], [0.0, np.pi / 2, 0.0, 0.0], [0.0, np.pi, 0.1, 0.0],
    ]),
    np.array([0.4, -0.9, 0.15, 0.3, 0.4, 0.5]),
    (False, False, True, False, False, False),
)  # fmt: skip
LENGTH_SD_M, ANGLE_SD_RAD, GEAR_SD_RAD = 2e-4, 3e-4, 2e-4
SESSIONS = 60
REPEATABILITY = (8e-5, 4e-5)
"""Of an ABB IRB 1600 (Slamani, Nubiola and Bonev 2012), whose error before a calibration is 17 to 32 times larger."""


def matrix(vector, place_m) -> np.ndarray:
    made = np.eye(4)
    made[:3, :3], made[:3, 3] = Rotation.from_rotvec(vector).as_matrix(), place_m
    return made


def difference(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Rotation vector and translation between two poses, in their frame."""
    return np.append(Rotation.from_matrix(one[:3, :3] @ other[:3, :3].T).as_rotvec(), one[:3, 3] - other[:3, 3])


def base_from_tool(joints: np.ndarray, arm: Arm, gear=(0.0, 0.0)) -> np.ndarray:
    """Denavit and Hartenberg's product; `gear`: amplitudes and phases of an error once a revolution."""
    pose = np.broadcast_to(np.eye(4), (len(joints), 4, 4))
    angles = np.where(arm.sliding, 0.0, joints + gear[0] * np.sin(joints + gear[1])) + arm.links[:, 3]
    lengths_m = np.where(arm.sliding, joints, 0.0) + arm.links[:, 2]
    for (a, alpha, _, _), angle, d in zip(arm.links, angles.T, lengths_m.T, strict=True):
        c, s = np.cos(angle), np.sin(angle)
        ca, sa = np.full_like(c, np.cos(alpha)), np.full_like(c, np.sin(alpha))
        zero, one = np.zeros_like(c), np.ones_like(c)
        rows = [[c, -s * ca, s * sa, a * c], [s, c * ca, -c * sa, a * s], [zero, sa, ca, d], [zero, zero, zero, one]]
        pose = pose @ np.moveaxis(np.array(rows), 2, 0)
    return pose


def joints_of(poses: np.ndarray, arm: Arm) -> np.ndarray:
    """Inverse kinematics of the nominal arm by Newton's method, of the poses for which it converges."""
    joints = np.repeat(arm.middle[None], len(poses), axis=0)

    def twists(moved):
        now = np.linalg.inv(base_from_tool(moved, arm)) @ poses
        return np.concatenate([Rotation.from_matrix(now[:, :3, :3]).as_rotvec(), now[:, :3, 3]], axis=1)

    for _ in range(40):
        now = twists(joints)
        jacobian = np.stack([(now - twists(joints + 1e-6 * each)) / 1e-6 for each in np.eye(6)], axis=-1)
        step = np.linalg.solve(jacobian + 1e-12 * np.eye(6), now[..., None])[..., 0]
        joints = joints + np.clip(step, -0.3, 0.3)
    return joints[np.abs(twists(joints)).max(axis=1) < 1e-8]


MOUNT = matrix([0.1, -0.2, 0.4], [0.03, -0.02, 0.08])
IN_FRONT = MOUNT @ matrix([0, 0, 0], np.array([0, 0, 0.5]) - MIDDLE_M)
"""tool_from_board in the middle of a session."""


class Session(NamedTuple):
    stations: list[Station]
    board: np.ndarray
    """In the base."""
    reported: np.ndarray
    """Of one more pose of the robot, beside those of the views ..."""
    seen: np.ndarray
    """... and the board in the camera there."""


def session(rng, views: int, systematic: float = 1.0, arm: Arm = ARM) -> Session:
    """Views by an arm with drawn errors, `systematic` times as large as of an arm that is not calibrated."""
    board = base_from_tool(arm.middle[None], arm)[0] @ IN_FRONT
    joints = np.zeros((0, 6))
    while len(joints) < views + 1:
        count = views + 5
        turns = Rotation.from_rotvec(rng.uniform(-1, 1, (count, 3)) * [0.4, 0.4, 0.7]).as_matrix()
        middles_m = np.column_stack([rng.uniform(-0.02, 0.02, (count, 2)), rng.uniform(0.4, 0.6, count)])
        wanted = np.broadcast_to(np.eye(4), (count, 4, 4)).copy()
        wanted[:, :3, :3], wanted[:, :3, 3] = turns, middles_m - turns @ MIDDLE_M
        joints = np.concatenate([joints, joints_of(board @ np.linalg.inv(MOUNT @ wanted), arm)])
    joints = joints[: views + 1]
    sds = systematic * np.array([LENGTH_SD_M, ANGLE_SD_RAD, LENGTH_SD_M, ANGLE_SD_RAD])
    gear = systematic * rng.normal(0, GEAR_SD_RAD, 6), rng.uniform(0, 2 * np.pi, 6)
    true = base_from_tool(joints, arm._replace(links=arm.links + sds * rng.normal(size=(6, 4))), gear)
    true = true @ np.array([matrix(*(sd * rng.normal(size=3) for sd in REPEATABILITY)) for _ in true])
    seen, reported = np.linalg.inv(true @ MOUNT) @ board, base_from_tool(joints, arm)
    stations = [
        Station(
            view=board_view(
                CORNERS_M, (one[:3, :3], one[:3, 3]), f"view{number:02d}", rng.normal(0, 0.1, (len(CORNERS_M), 2))
            ),
            base_from_tool=Transform(pose[:3, :3], pose[:3, 3]),
        )
        for number, (one, pose) in enumerate(zip(seen[:-1], reported[:-1], strict=True))
    ]
    return Session(stations, board, reported[-1], seen[-1])


def base_errors(calibration, made: Session) -> tuple[float, float]:
    """NEES of place and orientation of the board in the base, by another pose of the robot."""
    poses = RobotPoses(
        stamp_s=np.array([0.0, 0.2]), position_m=made.reported[None, :3, 3].repeat(2, 0),
        rotation=made.reported[None, :3, :3].repeat(2, 0),
    )  # fmt: skip
    matrix_found, root = CameraMotion(poses=poses, mount=calibration.mount).in_frame(PoseFrame.BASE, 0.1)
    found = matrix_found @ made.seen
    lever_m = matrix_found[:3, :3] @ (made.seen @ [*MIDDLE_M, 1.0])[:3]
    at_middle = np.eye(6)
    at_middle[3:, :3] = np.cross(np.eye(3), lever_m).T
    root = at_middle @ root
    covariance = root @ root.T
    turn_rad = difference(made.board, found)[:3]
    shift_m = (made.board @ [*MIDDLE_M, 1.0] - found @ [*MIDDLE_M, 1.0])[:3]
    return (
        shift_m @ np.linalg.solve(covariance[3:, 3:], shift_m) / 3,
        turn_rad @ np.linalg.solve(covariance[:3, :3], turn_rad) / 3,
    )


def mount_nees(calibration) -> float:
    error = difference(MOUNT, calibration.solution.state.mount.matrix)
    return error @ np.linalg.solve(calibration.covariance[:6, :6], error) / 6


def test_errors_of_joints_and_links_are_recognised_and_widen_the_covariance(rng):
    made = session(rng, 15, systematic=2.0)

    calibration = calibrate_mount(made.stations, TRUE_CAMERA)

    found = calibration.systematic
    assert found.probability > 0.95
    assert found.repeatability.translation_m < 0.5 * found.systematic.translation_m
    by_likelihood = calibration.solution.covariance
    assert np.trace(calibration.covariance[3:6, 3:6]) > 4.0 * np.trace(by_likelihood[3:6, 3:6])
    assert mount_nees(calibration) < 3.0
    assert max(base_errors(calibration, made)) < 5.0
    verdict = mount_verdict(calibration)
    assert "it depends on the robot's pose" in " ".join(mount_summary(calibration, verdict))
    assert mount_quality(calibration, verdict)["robot_error"]["systematic"]["translation_sd_m"] > 1e-4


def test_an_arm_that_only_repeats_badly_has_no_systematic_error(rng):
    found = [calibrate_mount(session(rng, 20, systematic=0.0).stations, TRUE_CAMERA).systematic for _ in range(3)]

    assert sorted(each.probability for each in found)[1] < 0.05


def test_few_views_that_do_not_show_the_kind_of_error_report_it_and_widen_the_covariance(rng):
    calibrations = [calibrate_mount(session(rng, 6, systematic=1.0).stations, TRUE_CAMERA) for _ in range(4)]

    unsure = [each for each in calibrations if 0.05 < each.systematic.probability < 0.95]
    assert unsure
    for calibration in unsure:
        assert "the views do not show whether it depends on the robot's pose" in " ".join(
            mount_summary(calibration, mount_verdict(calibration))
        )
        alone = calibration.solution.covariance
        assert np.trace(calibration.covariance[3:6, 3:6]) > np.trace(alone[3:6, 3:6])


def nees_of(rng, arm: Arm, views: int, systematic: float) -> np.ndarray:
    """Means over `SESSIONS`: of the mount, and of place and orientation of the board in the base."""
    nees = []
    for _ in range(SESSIONS):
        made = session(rng, views, systematic, arm)
        calibration = calibrate_mount(made.stations, TRUE_CAMERA)
        nees.append((mount_nees(calibration), *base_errors(calibration, made)))
    return np.mean(nees, axis=0)


def limits(probability: float) -> np.ndarray:
    """Band of the means by chi-squared, of 6, 3 and 3 degrees of freedom."""
    tail = 0.5 - probability / 2
    freedom = SESSIONS * np.array([6, 3, 3])
    return np.array([chi_squared([tail, 1 - tail], count) / count for count in freedom.tolist()]).T


@pytest.mark.slow
def test_the_nees_with_systematic_errors_is_in_its_band(rng):
    """Errors of half a millimetre, by arms whose lengths are not those of the family that the covariance assumes."""
    nees = np.array([nees_of(rng, arm, 8, 1.0) for arm in (OFFSET_WRIST, LARGE)])

    low, high = limits(0.99)
    assert np.sum((nees < low) | (nees > high)) <= 1
    assert np.all((nees > low - 0.1) & (nees < high + 0.1))


@pytest.mark.slow
def test_the_covariance_of_an_arm_of_another_kind_is_not_too_small(rng):
    assert np.all(nees_of(rng, SCARA, 12, 1.0) < limits(0.99)[1])


@pytest.mark.slow
def test_the_covariance_of_an_arm_that_only_repeats_badly_is_at_most_somewhat_too_large(rng):
    nees = nees_of(rng, ARM, 12, 0.0)

    assert np.all((nees > 0.4) & (nees < limits(0.99)[1]))
