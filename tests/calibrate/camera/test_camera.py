"""Intrinsic parameters from exact, noisy and photographed corners."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from known_views import CHESSBOARD, TRUE_CAMERA, board_view, chessboard_views

from ringpose.calibrate.boards.views import find_board
from ringpose.calibrate.camera.assessment import camera_assessment
from ringpose.calibrate.camera.parameters import CameraModel, parameters_of
from ringpose.calibrate.camera.pipeline import calibrate_camera
from ringpose.calibrate.camera.quality import camera_verdict
from ringpose.errors import DataError
from ringpose.geometry.board import corner_points
from ringpose.types.board import Board, BoardView
from ringpose.types.calibration import Grade

SAMPLES = Board(kind="chessboard", squares_x=10, squares_y=7, square_m=0.025)
NOISE_PX = 0.05


@pytest.fixture
def views(rng):
    """Makes views, exact by default."""
    return lambda number, noise_px=0.0: chessboard_views(rng, number, noise_px)


def test_exact_corners_give_the_exact_camera(views):
    found = calibrate_camera(views(8), 1600, 1200)

    error = np.abs(parameters_of(found.camera) - parameters_of(TRUE_CAMERA))
    assert error[:4].max() < 0.005  # px: OpenCV takes corners in single precision
    assert error[4:].max() < 0.005
    assert found.rms_px < 1e-4


def test_exact_corners_give_a_rational_camera_with_the_same_projection(views):
    found = calibrate_camera(views(12), 1600, 1200, CameraModel(distortion_model="rational_polynomial"))

    rays = np.array([[x, y, 1.0] for x in (-0.3, 0.0, 0.3) for y in (-0.2, 0.0, 0.2)])
    true, _ = cv2.projectPoints(
        rays, np.zeros(3), np.zeros(3), TRUE_CAMERA.camera_matrix, parameters_of(TRUE_CAMERA)[4:]
    )
    matrix, coefficients = found.camera.camera_matrix, found.camera.distortion_coefficients
    seen, _ = cv2.projectPoints(rays, np.zeros(3), np.zeros(3), matrix, coefficients)
    assert len(coefficients) == 8
    assert np.abs(seen - true).max() < 0.01


def test_sigma_is_the_noise_of_the_corners(views):
    assert calibrate_camera(views(10, NOISE_PX), 1600, 1200).sigma_px == pytest.approx(NOISE_PX, rel=0.06)


def test_covariance_agrees_with_the_standard_deviations_of_opencv(views):
    noisy = views(10, NOISE_PX)

    found = calibrate_camera(noisy, 1600, 1200)

    points = [view.points_board_m.astype(np.float32) for view in noisy]
    pixels = [view.points_px.astype(np.float32) for view in noisy]
    extended = cv2.calibrateCameraExtended(points, pixels, (1600, 1200), np.eye(3), np.zeros(5))
    reference = np.asarray(extended[5]).ravel()[:9]
    assert np.array(list(found.standard_deviations.values())) == pytest.approx(reference, rel=0.01)


def test_more_noise_never_shrinks_the_covariance(views):
    quiet, loud = (calibrate_camera(views(10, noise_px), 1600, 1200) for noise_px in (0.02, 0.2))

    assert all(loud.standard_deviations[name] > quiet.standard_deviations[name] for name in quiet.standard_deviations)


@pytest.mark.slow
def test_errors_have_the_covariance_that_is_reported(views):
    runs = 25
    normalised = []
    for _ in range(runs):
        found = calibrate_camera(views(8, NOISE_PX), 1600, 1200)
        error = parameters_of(found.camera) - parameters_of(TRUE_CAMERA)
        normalised.append(error @ np.linalg.solve(found.camera.covariance.data, error))

    assert np.mean(normalised) == pytest.approx(9, abs=1.96 * np.sqrt(2 * 9 / runs))


def test_held_parameters_stay_zero_without_variance(views):
    found = calibrate_camera(views(8, NOISE_PX), 1600, 1200, CameraModel(fix_k3=True, zero_tangential=True))

    deviations = found.standard_deviations
    assert found.camera.distortion_coefficients[2:].tolist() == [0.0, 0.0, 0.0]
    assert [deviations[name] for name in ("p1", "p2", "k3")] == [0.0, 0.0, 0.0]
    assert deviations["k1"] > 0


def with_moved_corners(view: BoardView, corners: slice, offset_px: tuple[float, float]) -> BoardView:
    moved = view.points_px.copy()
    moved[corners] += offset_px
    return replace(view, points_px=moved)


def test_a_view_of_a_bent_board_is_rejected_with_its_name(views):
    noisy = views(8, NOISE_PX)
    noisy[3] = with_moved_corners(noisy[3], slice(20), (2.0, 2.0))

    found = calibrate_camera(noisy, 1600, 1200)

    assert [view.name for view in found.views if view.rejected] == ["v3"]
    assert "times the median" in found.views[3].rejected


def test_a_corner_far_off_is_left_out_and_its_view_is_used(views):
    noisy = views(8, NOISE_PX)
    noisy[3] = with_moved_corners(noisy[3], slice(17, 18), (0.0, 0.6))

    found = calibrate_camera(noisy, 1600, 1200)

    left_out = {view.name: np.flatnonzero(view.left_out).tolist() for view in found.views if view.left_out.any()}
    assert left_out == {"v3": [17]}
    assert not found.views[3].rejected


def test_a_lens_that_the_model_does_not_describe_loses_few_corners(views):
    bent = []
    for view in views(8):
        offset = view.points_px - [800.0, 600.0]
        far = np.maximum(np.linalg.norm(offset, axis=1, keepdims=True) - 300, 0) / 300
        bent.append(replace(view, points_px=view.points_px + 40 * offset / 1000 * far**6))

    found = calibrate_camera(bent, 1600, 1200)

    assert np.mean(np.concatenate([view.left_out for view in found.views])) <= 0.05


def test_nothing_is_rejected_on_request(views):
    noisy = views(8, NOISE_PX)
    noisy[3] = replace(noisy[3], points_px=noisy[3].points_px * [1.003, 0.997])

    found = calibrate_camera(noisy, 1600, 1200, CameraModel(keep_all=True))

    assert len(found.used) == 8


def test_three_views_from_one_pose_leave_the_focal_length_undetermined(rng):
    points = corner_points(CHESSBOARD)
    facing = (np.eye(3), np.array([-0.15, -0.12, 0.5]))
    same = [board_view(points, facing, f"v{i}", NOISE_PX * rng.standard_normal((len(points), 2))) for i in range(3)]

    with pytest.raises(DataError, match="tilted"):
        calibrate_camera(same, 1600, 1200)


def wide_window(folder) -> list[BoardView]:
    """Corners as the reference has them: OpenCV's classic finder, refined in a window larger than some squares."""
    views = []
    for path in sorted(folder.glob("left[01]*.jpg")):
        image = cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)
        _, corners = cv2.findChessboardCorners(image, (9, 6))
        refined = cv2.cornerSubPix(image, corners.reshape(-1, 1, 2), (11, 11), (-1, -1), (3, 30, 0.01))
        pixels = refined.reshape(-1, 2).astype(np.float64)
        views.append(
            BoardView(name=path.stem, ids=np.arange(54), points_board_m=corner_points(SAMPLES), points_px=pixels)
        )
    return views


def test_left02_with_its_badly_refined_corner_is_rejected(shared_data):
    found = calibrate_camera(wide_window(shared_data / "real" / "opencv_samples_stereo"), 640, 480)

    assert [view.name for view in found.views if view.rejected] == ["left02"]
    assert found.rms_px < 0.2341  # the reference's, which does not reject single corners


def test_the_reference_is_reproduced_from_its_own_corners(shared_data):
    views = wide_window(shared_data / "real" / "opencv_samples_stereo")

    found = calibrate_camera([view for view in views if view.name != "left02"], 640, 480, CameraModel(keep_all=True))

    assert found.rms_px == pytest.approx(0.2341, abs=0.001)
    assert parameters_of(found.camera)[:4] == pytest.approx([534.13, 534.19, 342.84, 233.72], abs=0.05)


def bouguet_views(path) -> list[BoardView]:
    """The corner list of calib1.dat: size, views of 7 x 5 board points, then as many views of pixels."""
    numbers = []
    for line in path.read_text().split("#")[0].splitlines():
        numbers += [float(word) for word in line.split()]
    width, height, views = int(numbers[2]), int(numbers[3]), int(numbers[4])
    count = width * height
    points = np.array(numbers[5 : 5 + 3 * count * views]).reshape(views, count, 3)
    pixels = np.array(numbers[5 + 3 * count * views :][: 2 * count * views]).reshape(views, count, 2)
    return [
        BoardView(name=str(i), ids=np.arange(count), points_board_m=points[i], points_px=pixels[i])
        for i in range(views)
    ]


def test_bouguets_corner_list_gives_bouguets_camera(shared_data):
    views = bouguet_views(shared_data / "real" / "opencv_extra_calib" / "calib1.dat")

    found = calibrate_camera(views, 640, 480, CameraModel(fix_k3=True, keep_all=True))

    assert parameters_of(found.camera)[:4] == pytest.approx([809.948, 806.560, 361.996, 214.394], abs=0.01)
    assert found.camera.distortion_coefficients[:4] == pytest.approx([-0.12821, -0.39441, -0.00435, -0.00732], abs=1e-4)


@pytest.mark.slow
def test_rendered_camera_lies_within_three_reported_sigmas_of_the_truth(shared_data):
    board = Board(kind="charuco", squares_x=11, squares_y=8, square_m=0.025, marker_m=0.018, dictionary="DICT_5X5_100")
    paths = sorted((shared_data / "rendered" / "calib_b" / "camera").glob("*.png"))
    views = [find_board(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), board, path.stem) for path in paths]

    found = calibrate_camera(views, 1600, 1200)

    error = parameters_of(found.camera) - parameters_of(TRUE_CAMERA)
    assert np.abs(error / np.array(list(found.standard_deviations.values()))).max() < 3
    assert error @ np.linalg.solve(found.camera.covariance.data, error) < 21.7  # 99 % of chi2 with 9
    assert np.abs(error[:4]).max() < 0.4
    assessed = camera_assessment(found, CameraModel())
    assert camera_verdict(assessed, len(views)).grade is Grade.GOOD
