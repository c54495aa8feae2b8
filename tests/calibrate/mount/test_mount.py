"""The mount of simulated views, whose truth is known."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from known_views import CHESSBOARD, TRUE_CAMERA, board_view
from scipy.spatial.transform import Rotation

from ringpose.calibrate.mount.adjustment import RobotSigmas, ViewNumbers, robot_sigmas
from ringpose.calibrate.mount.closed_form import Transform
from ringpose.calibrate.mount.pipeline import calibrate_mount
from ringpose.calibrate.mount.quality import compared_mount, comparison_verdict, mount_verdict
from ringpose.calibrate.mount.stations import Station
from ringpose.errors import DataError
from ringpose.geometry.board import corner_points
from ringpose.geometry.robot_conventions import convention_named
from ringpose.types.calibration import Grade
from ringpose.types.rig import ParameterCovariance, camera_parameters

CORNERS_M = corner_points(CHESSBOARD)[::4].copy()
MIDDLE_M = np.array([0.15, 0.125, 0.0])
ROBOT_RAD, ROBOT_M = np.radians(0.02), 1e-4


def transform(vector, place_m=(0.0, 0.0, 0.0)):
    return Transform(Rotation.from_rotvec(vector).as_matrix(), np.array(place_m, dtype=np.float64))


def world(
    rng, views, *, robot=(ROBOT_RAD, ROBOT_M), noise_px=0.1, eye_to_hand=False, turn=(0.45, 0.45, 0.8), spread=1.0
):
    """The true mount, and views whose robot poses have independent errors in the tool frame.

    `spread`: 0 if all views look at the board's middle from one distance.
    """
    mount = transform(rng.normal(0, 1, 3), rng.normal(0, 0.05, 3))
    board = transform(rng.normal(0, 1, 3), rng.normal(0, 0.5, 3))
    stations = []
    for number in range(views):
        rotation = Rotation.from_rotvec(rng.uniform(-1, 1, 3) * turn).as_matrix()
        middle_m = np.array([*rng.uniform(-0.02, 0.02, 2), rng.uniform(-0.1, 0.1)]) * spread + [0.0, 0.0, 0.5]
        seen = Transform(rotation, middle_m - rotation @ MIDDLE_M)
        # mount @ seen = tool_from_base @ board, or base_from_tool @ board
        moving = mount.after(seen).after(board.inverse())
        true = moving if eye_to_hand else moving.inverse()
        error = transform(rng.normal(0, robot[0], 3), rng.normal(0, robot[1], 3))
        noise = rng.normal(0, noise_px, (len(CORNERS_M), 2))
        view = board_view(CORNERS_M, tuple(seen), name=f"view{number:02d}", noise_px=noise)
        stations.append(
            Station(view=view, base_from_tool=true.after(error.inverse()), location=f"poses.csv:{number + 1}")
        )
    return mount, stations


def error_of(calibration, mount):
    estimated = calibration.solution.state.mount
    turn = Rotation.from_matrix(mount.rotation @ estimated.rotation.T).as_rotvec()
    return np.append(turn, mount.translation_m - estimated.translation_m)


def changed(station, change):
    return replace(station, base_from_tool=change(station.base_from_tool))


@pytest.mark.parametrize("eye_to_hand", [False, True])
def test_exact_views_give_the_true_mount(eye_to_hand, rng):
    mount, stations = world(rng, 5, robot=(0.0, 0.0), noise_px=0.0, eye_to_hand=eye_to_hand)

    calibration = calibrate_mount(stations, TRUE_CAMERA, eye_to_hand=eye_to_hand)

    np.testing.assert_allclose(error_of(calibration, mount), 0.0, atol=1e-6)
    assert calibration.without.distance_m.max() < 1e-6


def test_noisy_views_are_as_accurate_as_reported(rng):
    mount, stations = world(rng, 12, robot=(1e-3, 1e-4))

    calibration = calibrate_mount(stations, TRUE_CAMERA)

    error = error_of(calibration, mount)
    sd = np.sqrt(np.diag(calibration.covariance)[:6])
    assert np.abs(error / sd).max() < 4.0
    assert np.all(sd < [1e-3] * 3 + [1e-3] * 3)


@pytest.mark.skipif(not hasattr(cv2, "calibrateHandEye"), reason="OpenCV 5.0 has no calibrateHandEye in Python")
def test_the_mount_is_that_of_opencvs_closed_form_within_its_errors(rng):
    _, stations = world(rng, 10)
    solution = calibrate_mount(stations, TRUE_CAMERA).solution

    poses = [station.base_from_tool for station in stations]
    _, park_m = cv2.calibrateHandEye(
        [pose.rotation for pose in poses], [pose.translation_m for pose in poses],
        [board.rotation for board in solution.boards], [board.translation_m for board in solution.boards],
        method=cv2.CALIB_HAND_EYE_PARK,
    )  # fmt: skip

    np.testing.assert_allclose(park_m.ravel(), solution.state.mount.translation_m, atol=2e-3)


def test_the_result_does_not_depend_on_the_order_of_the_views(rng):
    _, stations = world(rng, 6)

    first = calibrate_mount(stations, TRUE_CAMERA)
    second = calibrate_mount([stations[index] for index in (3, 0, 5, 1, 4, 2)], TRUE_CAMERA)

    np.testing.assert_array_equal(first.solution.state.mount.translation_m, second.solution.state.mount.translation_m)
    np.testing.assert_array_equal(first.covariance, second.covariance)


def test_the_robots_error_is_estimated_from_enough_views(rng):
    _, stations = world(rng, 20, robot=(2e-3, 5e-4))

    sigmas = calibrate_mount(stations, TRUE_CAMERA).solution.sigmas

    assert sigmas.rotation_rad == pytest.approx(2e-3, rel=0.4)
    assert sigmas.translation_m == pytest.approx(5e-4, rel=0.4)


def test_the_robots_error_is_that_of_the_greatest_restricted_likelihood(rng):
    """Searle, Casella, McCulloch, Variance Components, 1992, Eq. 6.66, of all numbers at once."""
    views, common = 8, 12
    true = RobotSigmas(rotation_rad=2e-3, translation_m=5e-4)
    design = rng.normal(size=(views, 6, common))
    noise = np.repeat([2e-4, 2e-4], 3) * rng.uniform(0.5, 2.0, (views, 6))
    z = rng.normal(size=(views, 6)) * np.sqrt(true.variances + noise**2)
    numbers = ViewNumbers(
        z=z, covariance=np.einsum("vi,ij->vij", noise**2, np.eye(6)), wrt_common=design,
        wrt_error=np.tile(np.eye(6), (views, 1, 1)),
        wrt_stamp=np.zeros((views, 6)), wrt_camera=np.zeros((views, 6, 9)),
        camera_information=np.zeros((views, common, common)), camera_gradient=np.zeros((views, common)),
    )  # fmt: skip

    sigmas = robot_sigmas(numbers, np.zeros((common, common)))

    def minus_log_likelihood(rotation_rad: float, translation_m: float) -> float:
        variance = (RobotSigmas(rotation_rad, translation_m).variances + noise**2).ravel()
        x, weighted = design.reshape(-1, common), design.reshape(-1, common) / variance[:, None]
        information = x.T @ weighted
        projection = np.diag(1 / variance) - weighted @ np.linalg.solve(information, weighted.T)
        return 0.5 * (np.log(variance).sum() + np.linalg.slogdet(information)[1] + z.ravel() @ projection @ z.ravel())

    least = minus_log_likelihood(*sigmas)
    for factors in ((1.03, 1.0), (1 / 1.03, 1.0), (1.0, 1.03), (1.0, 1 / 1.03)):
        assert least < minus_log_likelihood(*np.multiply(sigmas, factors))


def test_an_unsure_focal_length_widens_the_mount_along_the_optical_axis(rng):
    """The boards, at 0.4 to 0.6 m, would be further away by the same ratio."""
    _, stations = world(rng, 6)
    ratio_sd = 2e-3
    sd_px = np.zeros(9)
    sd_px[:2] = ratio_sd * TRUE_CAMERA.camera_matrix[[0, 1], [0, 1]]
    unsure = ParameterCovariance(parameters=camera_parameters(5), data=np.outer(sd_px, sd_px))

    exact = calibrate_mount(stations, TRUE_CAMERA).covariance
    widened = calibrate_mount(stations, replace(TRUE_CAMERA, covariance=unsure)).covariance

    assert np.linalg.eigvalsh(widened - exact).min() > -1e-12
    assert 0.4 * ratio_sd < np.sqrt(np.trace((widened - exact)[3:6, 3:6])) < 0.8 * ratio_sd


def test_a_camera_with_a_wrong_focal_length_is_refined_with_the_mount(rng):
    mount, stations = world(rng, 8, robot=(1e-5, 1e-6))
    wrong = replace(TRUE_CAMERA, camera_matrix=TRUE_CAMERA.camera_matrix * np.array([[1.005], [1.005], [1.0]]))

    calibration = calibrate_mount(stations, wrong, refine_camera=True)

    refined = calibration.solution.state.camera.camera_matrix
    np.testing.assert_allclose(np.diag(refined)[:2], np.diag(TRUE_CAMERA.camera_matrix)[:2], rtol=5e-4)
    assert np.linalg.norm(error_of(calibration, mount)[3:]) < 1e-3


def test_turns_about_one_axis_are_refused_and_the_missing_one_named(rng):
    _, stations = world(rng, 6, turn=(0.0, 0.0, 0.8))

    with pytest.raises(
        DataError, match=r"turned about one axis.*add views that are turned about the tool's [xyz] axis"
    ):
        calibrate_mount(stations, TRUE_CAMERA)
    with pytest.raises(DataError, match="at least 3 are needed"):
        calibrate_mount(stations[:2], TRUE_CAMERA)


@pytest.mark.parametrize("shift_m", [0.1, 0.004])
def test_a_mistyped_pose_is_left_out_and_its_axis_named(shift_m, rng):
    mount, stations = world(rng, 9)
    stations[4] = changed(
        stations[4], lambda pose: Transform(pose.rotation, pose.translation_m + np.array([0.0, shift_m, 0.0]))
    )

    calibration = calibrate_mount(stations, TRUE_CAMERA)

    assert list(calibration.rejected) == ["view04"]
    assert "poses.csv:5" in calibration.rejected["view04"]
    assert "its y is mistyped" in calibration.rejected["view04"]
    assert np.linalg.norm(error_of(calibration, mount)[3:]) < 1e-3


def test_a_board_that_slipped_is_named_with_the_views(rng):
    _, stations = world(rng, 10)
    for index in range(6, 10):
        stations[index] = changed(
            stations[index], lambda pose: Transform(pose.rotation, pose.translation_m + np.array([5e-3, 0, 0]))
        )

    calibration = calibrate_mount(stations, TRUE_CAMERA)

    assert calibration.board_moved.startswith("the board was moved between view05 and view06, by about ")
    assert mount_verdict(calibration).grade is Grade.REDO


def as_wxyz(pose):
    return Transform(
        Rotation.from_quat(np.roll(Rotation.from_matrix(pose.rotation).as_quat(), 1)).as_matrix(), pose.translation_m
    )


def read_as_zyx(pose):
    angles = Rotation.from_matrix(pose.rotation).as_euler("xyz")
    return Transform(Rotation.from_euler("ZYX", angles).as_matrix(), pose.translation_m)


@pytest.mark.parametrize(
    ("change", "convention", "cause"),
    [
        (lambda pose: Transform(pose.rotation, 1e3 * pose.translation_m), "m,xyzw", "positions are in millimetres"),
        (lambda pose: Transform(pose.rotation, 1e-3 * pose.translation_m), "mm,xyzw", "positions are in metres"),
        (lambda pose: Transform(pose.rotation, 1e2 * pose.translation_m), "m,xyzw", "in centimetres"),
        (
            lambda pose: Transform(pose.rotation, pose.translation_m / 0.0254),
            "m,xyzw",
            "in inches and are read as metres",
        ),
        (lambda pose: Transform(pose.rotation, pose.translation_m / 25.4), "mm,xyzw", "in inches and are read as mill"),
        (as_wxyz, "m,xyzw", "the quaternions are wxyz"),
        (read_as_zyx, "kuka", "the angles are of the order xyz"),
        (lambda pose: pose.inverse(), "kuka", "inverted"),
    ],
    ids=["millimetres", "metres", "centimetres", "inches as m", "inches as mm", "quaternion", "angles", "inverted"],
)
def test_poses_read_by_another_convention_are_refused_with_the_likely_cause(change, convention, cause, rng):
    _, stations = world(rng, 8)

    with pytest.raises(DataError, match=cause):
        calibrate_mount(
            [changed(station, change) for station in stations], TRUE_CAMERA, convention=convention_named(convention)
        )


def test_a_pose_that_was_written_for_each_view_is_refused(rng):
    _, stations = world(rng, 6)

    with pytest.raises(DataError, match=r"turned against each other by at most 0 degrees.*the same pose was written"):
        calibrate_mount([changed(one, lambda _: stations[0].base_from_tool) for one in stations], TRUE_CAMERA)


def test_poses_that_fit_no_mount_are_refused_with_their_least_error(rng):
    _, stations = world(rng, 8)
    scattered = [
        changed(one, lambda pose: Transform(pose.rotation, pose.translation_m + rng.normal(0, 0.3, 3)))
        for one in stations
    ]

    with pytest.raises(DataError, match="its error would be 50 mm or more and"):
        calibrate_mount(scattered, TRUE_CAMERA)


def test_a_board_of_another_size_is_noticed(rng):
    _, stations = world(rng, 10)
    larger = [replace(one, view=replace(one.view, points_board_m=1.03 * one.view.points_board_m)) for one in stations]

    calibration = calibrate_mount(larger, TRUE_CAMERA)

    assert calibration.board_scale[0] == pytest.approx(-0.03 / 1.03, abs=0.003)


@pytest.mark.parametrize("views", [3, 12])
def test_views_of_one_point_from_one_distance_do_not_show_the_unit_of_the_robot(views, rng):
    mount, stations = world(rng, views, spread=0.0)

    calibration = calibrate_mount(stations, TRUE_CAMERA)

    assert np.linalg.norm(error_of(calibration, mount)[3:]) < 3e-3
    assert "a wrong unit would not be seen" in " ".join(mount_verdict(calibration).advice)


def test_views_from_other_distances_show_the_unit_of_the_robot(rng):
    _, stations = world(rng, 12)

    advice = mount_verdict(calibrate_mount(stations, TRUE_CAMERA)).advice

    assert "a wrong unit would not be seen" not in " ".join(advice)


def test_a_given_mount_is_judged(rng):
    mount, stations = world(rng, 10)
    calibration = calibrate_mount(stations, TRUE_CAMERA)
    turned = Transform(mount.rotation @ Rotation.from_rotvec([0.02, 0, 0]).as_matrix(), mount.translation_m)

    def compared(given):
        return compared_mount(
            calibration, replace(calibration.mount, carrier_from_camera=given.matrix, root=np.zeros((6, 6)))
        )

    assert compared(mount).sigmas < 3.0
    assert comparison_verdict(compared(mount)).grade is Grade.GOOD
    assert compared(turned).sigmas > 8.0


def test_a_given_mount_that_is_too_uncertain_is_not_good(rng):
    mount, stations = world(rng, 10)
    calibration = calibrate_mount(stations, TRUE_CAMERA)
    wrong = Transform(mount.rotation, mount.translation_m + np.array([0.1, 0.0, 0.0]))

    given = replace(calibration.mount, carrier_from_camera=wrong.matrix, root=0.1 * np.eye(6))
    verdict = comparison_verdict(compared_mount(calibration, given))

    assert verdict.grade is Grade.REDO
    assert "too uncertain" in " ".join(verdict.advice)


@pytest.mark.slow
@pytest.mark.parametrize("order", [(5, 2, 7, 0, 3, 6, 1, 4), (1, 0, 2, 3, 4, 5, 6, 7)])
def test_poses_in_another_order_than_the_images_give_no_mount_unnamed(order, rng):
    _, stations = world(rng, 8)
    shuffled = [
        replace(one, base_from_tool=stations[index].base_from_tool) for one, index in zip(stations, order, strict=True)
    ]

    try:
        calibration = calibrate_mount(shuffled, TRUE_CAMERA)
    except DataError:
        return
    assert set(calibration.rejected) == {stations[0].name, stations[1].name}


@pytest.mark.slow
@pytest.mark.parametrize(("views", "eye_to_hand", "lowest"), [(12, False, 0.7), (12, True, 0.7), (6, False, 0.4)])
def test_the_nees_of_the_mount_is_in_its_band(views, eye_to_hand, lowest, rng):
    nees = []
    for _ in range(100):
        mount, stations = world(rng, views, eye_to_hand=eye_to_hand)
        calibration = calibrate_mount(stations, TRUE_CAMERA, eye_to_hand=eye_to_hand)
        error = error_of(calibration, mount)
        nees.append(error @ np.linalg.solve(calibration.covariance[:6, :6], error) / 6)

    # 99 % of chi-squared with 600 degrees of freedom, from 0.86; less, as few views do not exclude a systematic error
    assert lowest < np.mean(nees) < 1.157
