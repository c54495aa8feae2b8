"""Cameras of photographs and renders, against their reference results."""

from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np
import pytest
import scipy.io

from ringpose.calibrate.boards.diagnostics import NoBoard
from ringpose.calibrate.boards.views import find_board
from ringpose.calibrate.camera.assessment import camera_assessment
from ringpose.calibrate.camera.parameters import CameraModel, parameters_of
from ringpose.calibrate.camera.pipeline import assessed_camera, calibrate_camera
from ringpose.calibrate.camera.quality import camera_summary, camera_verdict
from ringpose.geometry.rays import fold_px
from ringpose.types.board import Board, BoardView, BoardViews
from ringpose.types.calibration import CameraAssessment, CameraCalibration, Grade

K2 = CameraModel(fix_k3=True)
SAMPLES = Board(kind="chessboard", squares_x=10, squares_y=7, square_m=0.025)
ETNA = Board(kind="chessboard", squares_x=8, squares_y=7, square_m=0.01)
UBA = Board(kind="chessboard", squares_x=12, squares_y=8, square_m=0.021167, square_y_m=0.021125)


def calibrated(paths: Sequence[Path], board: Board, model: CameraModel) -> CameraAssessment:
    images = {path.stem: cv2.imread(str(path), cv2.IMREAD_GRAYSCALE) for path in sorted(paths)}
    found = [find_board(image, board, name) for name, image in images.items()]
    views = [view for view in found if not isinstance(view, NoBoard)]
    height, width = next(iter(images.values())).shape
    return camera_assessment(calibrate_camera(views, width, height, model), model)


def deviations_from(calibration: CameraCalibration, reference: Sequence[float]) -> np.ndarray:
    """Errors in reported standard deviations."""
    sigmas = np.array(list(calibration.standard_deviations.values()))[: len(reference)]
    error = parameters_of(calibration.camera)[: len(reference)] - reference
    return np.abs(error) / np.where(sigmas > 0, sigmas, 1.0)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("names", "reference", "tolerance_px"),
    [("left[01]*.jpg", [534.15, 534.15], 2.0), ("right[01]*.jpg", [534.96, 534.40], 3.0)],
)
def test_own_corners_fit_opencvs_samples_better_than_the_reference(names, reference, tolerance_px, shared_data):
    paths = list((shared_data / "real" / "opencv_samples_stereo").glob(names))

    calibration = calibrated(paths, SAMPLES, CameraModel()).calibration

    assert len(calibration.used) == 13
    assert calibration.rms_px < 0.2  # reference: 0.235; of the left ones 0.234 with one view less
    assert parameters_of(calibration.camera)[:2] == pytest.approx(reference, abs=tolerance_px)


def test_four_views_whose_k3_folds_the_image_give_a_camera_with_k3_held(shared_data):
    paths = [shared_data / "real" / "opencv_samples_stereo" / f"left0{number}.jpg" for number in (1, 2, 3, 4)]
    views = [find_board(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), SAMPLES, path.stem) for path in paths]

    found = assessed_camera(BoardViews(views=views, image_width=640, image_height=480))

    assert fold_px(found.calibration.camera) is None
    assert found.calibration.standard_deviations["k3"] == 0
    assert deviations_from(found.calibration, [534.13, 534.19, 342.84, 233.72]).max() < 5  # of all views but one
    assert "folded_share" in [check.name for check in camera_verdict(found, 4).poor]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("folder", "reference", "rms_px"),
    [
        ("root", [2422.3, 2427.65, 693.72, 474.42], 0.2919),
        ("calib2", [2446.88, 2453.64, 651.92, 535.12], 0.2789),
        ("calib3", [2418.99, 2422.75, 659.91, 532.28], 0.6542),
    ],
)
def test_etnas_cameras_are_within_a_sigma_of_the_reference(folder, reference, rms_px, shared_data):
    paths = list((shared_data / "real" / "etna_laser_robot" / folder).glob("*.png"))

    assessment = calibrated(paths, ETNA, K2)

    assert deviations_from(assessment.calibration, reference).max() < 1
    assert assessment.calibration.rms_px < rms_px + 0.01
    assert camera_verdict(assessment, len(paths)).grade is not Grade.GOOD


@pytest.mark.slow
def test_ubas_camera_is_within_three_sigmas_of_the_published_one(shared_data):
    folder = shared_data / "real" / "uba_laser_plane"

    calibration = calibrated(list((folder / "color").glob("*.png")), UBA, K2).calibration

    published = [819.580391, 820.87185144, 589.72908798, 355.78486577, 0.0981042148, -0.182481427]
    assert len(calibration.used) == 14
    assert deviations_from(calibration, published).max() < 3
    assert calibration.rms_px < 0.1926


@pytest.mark.slow
def test_the_toolboxs_own_corners_give_its_own_camera_and_uncertainties(shared_data):
    toolbox = scipy.io.loadmat(shared_data / "real" / "uba_laser_plane" / "Calib_Results.mat")
    views = [
        BoardView(
            name=f"image{number}",
            ids=np.arange(77),
            points_board_m=toolbox[f"X_{number}"].T / 1000,
            points_px=np.ascontiguousarray(toolbox[f"x_{number}"].T),
        )
        for number in range(1, 15)
    ]

    found = calibrate_camera(views, 1152, 768, CameraModel(fix_k3=True, keep_all=True))

    fc, cc, kc = (toolbox[key].ravel() for key in ("fc", "cc", "kc"))
    published_sigma = np.concatenate([toolbox[key].ravel() for key in ("fc_error", "cc_error")]) / 3
    assert parameters_of(found.camera)[:4] == pytest.approx([*fc, *cc], abs=0.002)
    assert parameters_of(found.camera)[4:8] == pytest.approx(kc[:4], abs=1e-5)
    assert list(found.standard_deviations.values())[:4] == pytest.approx(published_sigma, rel=0.05)


def test_three_views_of_circles_give_a_plausible_camera(shared_data):
    folder = shared_data / "real" / "opencv_extra_calib" / "asymmetric_circles"
    board = Board(kind="asymmetric_circles", squares_x=7, squares_y=13, spacing_m=0.02)

    assessment = calibrated(
        [folder / f"acircles{number}.png" for number in (1, 2, 3)],
        board,
        CameraModel(fix_k3=True, zero_tangential=True),
    )

    assert assessment.calibration.rms_px < 0.3
    verdict = camera_verdict(assessment, 3)
    assert verdict.grade is Grade.REDO
    # 7 circles in each of 13 rows 20 mm apart: (2 * 6 + 1) * 20 and 12 * 20 mm
    assert any("260.0 x 240.0 mm" in line for line in camera_summary(assessment, verdict))
