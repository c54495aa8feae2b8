"""Boards that are flat, and boards that are bowed by a tenth of a millimetre in every view."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from known_views import CHESSBOARD, TRUE_CAMERA, board_view, true_poses

from ringpose.calibrate.camera.assessment import bow_error, camera_assessment
from ringpose.calibrate.camera.bundle_adjustment import CameraSolution, camera_solution
from ringpose.calibrate.camera.parameters import PLUMB_BOB, CameraModel, parameters_of
from ringpose.calibrate.camera.pipeline import calibrate_camera
from ringpose.calibrate.camera.quality import camera_verdict
from ringpose.geometry.board import corner_points
from ringpose.types.board import BoardView
from ringpose.types.calibration import CameraCalibration, Grade

POINTS = corner_points(CHESSBOARD)
NOISE_PX = 0.02


def views(rng, heights_m: Sequence[float]) -> list[BoardView]:
    """Views of a board of these heights in the middle of its width, taken for flat."""
    found = []
    for index, pose in enumerate(true_poses(rng, len(heights_m))):
        bowed = POINTS.copy()
        bowed[:, 2] = heights_m[index] * (1 - ((POINTS[:, 0] - 0.15) / 0.125) ** 2)
        view = board_view(bowed, pose, f"v{index}", NOISE_PX * rng.standard_normal((len(POINTS), 2)))
        found.append(replace(view, points_board_m=POINTS))
    return found


def solved(boards: Sequence[BoardView]) -> CameraSolution:
    return camera_solution(boards, calibrate_camera(boards, 1600, 1200).camera, PLUMB_BOB)


def test_a_flat_board_is_not_reported_as_bowed(rng):
    flat = views(rng, [0.0] * 8)

    assert bow_error(flat, solved(flat), PLUMB_BOB).finding.grade is Grade.GOOD


def test_a_bowed_board_is_reported_with_its_height(rng):
    bowed = views(rng, [1e-4] * 8)

    finding, _ = bow_error(bowed, solved(bowed), PLUMB_BOB)

    height_mm = float(finding.advice.split("about ")[1].split(" mm")[0])
    assert finding.grade is not Grade.GOOD
    assert height_mm == pytest.approx(0.1, abs=0.03)


def test_a_board_that_bends_differently_in_each_view_is_not_reported_as_bowed(rng):
    """The mean of ten bows is significant against the corners' noise, but not against the views' disagreement."""
    bending = views(rng, [1e-4, -1e-4, 3e-5, -6e-5, 8e-5, 1e-4, -4e-5, -7e-5, 9e-5, -5e-5])
    found = calibrate_camera(bending, 1600, 1200)

    by_noise, _ = bow_error(bending, solved(bending), PLUMB_BOB)
    finding = camera_assessment(found, PLUMB_BOB).board[-1]

    assert by_noise.grade is not Grade.GOOD
    assert finding.grade is Grade.GOOD


def normalised_error(found: CameraCalibration) -> float:
    """NEES of the camera's parameters."""
    error = parameters_of(found.camera) - parameters_of(TRUE_CAMERA)
    return float(error @ np.linalg.solve(found.covariance.data, error)) / len(error)


def test_the_covariance_contains_the_error_by_a_bow(rng):
    bowed = views(rng, [3e-4] * 8)
    found = calibrate_camera(bowed, 1600, 1200)

    assessed = camera_assessment(found, PLUMB_BOB)

    assert normalised_error(found) > 20
    assert normalised_error(assessed.calibration) < 3.1  # the 99.9 % bound of nine parameters


def test_a_bow_that_causes_the_uncertainty_is_the_advice_against_it(rng):
    found = calibrate_camera(views(rng, [3e-4] * 12), 1600, 1200)

    verdict = camera_verdict(camera_assessment(found, PLUMB_BOB), 12)

    uncertain = [each for each in verdict.poor if each.name in ("focal_sigma_share", "projection_sigma_px")]
    assert uncertain
    assert all("the board is not flat" in each.advice for each in uncertain)


def test_the_covariance_contains_half_of_the_difference_of_two_halves_of_the_views(rng):
    """A sheet that is bent one way in one half of the views, and the other way in the rest."""
    bending = views(rng, [3e-4, -3e-4] * 4)
    found = calibrate_camera(bending, 1600, 1200, CameraModel(keep_all=True))
    odd, even = (parameters_of(solved(bending[first::2]).camera) for first in (0, 1))

    assessed = camera_assessment(found, CameraModel(keep_all=True)).calibration

    half = np.abs(odd - even) / 2
    assert half[0] > 3 * found.standard_deviations["fx"]
    assert np.all(np.sqrt(np.diag(assessed.covariance.data)) > half)
    assert normalised_error(found) > 3.1  # the 99.9 % bound of nine parameters
    assert normalised_error(assessed) < 3.1


SHAPES = {
    "bent about an axis": lambda x, y: 1 - x**2,
    "bent about a diagonal": lambda x, y: 1 - (x + y) ** 2 / 2,
    "saddle": lambda x, y: x * y,
    "dish": lambda x, y: 1 - (x**2 + y**2) / 2,
}


@pytest.mark.slow
@pytest.mark.parametrize("shape", SHAPES)
def test_the_standard_deviations_of_a_bent_board_are_as_wide_as_the_errors(shape, rng):
    bent = POINTS.copy()
    bent[:, 2] = 3e-4 * SHAPES[shape]((POINTS[:, 0] - 0.15) / 0.125, (POINTS[:, 1] - 0.125) / 0.1)
    normalised, errors_px, sds_px = [], [], []
    for _ in range(8):
        poses = true_poses(rng, 8)
        drawn = [board_view(bent, pose, "v", 0.05 * rng.standard_normal((len(POINTS), 2))) for pose in poses]
        boards = [replace(view, points_board_m=POINTS) for view in drawn]
        found = camera_assessment(calibrate_camera(boards, 1600, 1200), PLUMB_BOB).calibration
        normalised.append(normalised_error(found))
        errors_px.append(found.camera.camera_matrix[0, 0] - TRUE_CAMERA.camera_matrix[0, 0])
        sds_px.append(found.standard_deviations["fx"])

    assert np.mean(normalised) < 1.5
    assert 0.8 < np.sqrt(np.mean(np.square(sds_px)) / np.mean(np.square(errors_px))) < 2.5


def test_noise_alone_does_not_inflate_the_covariance(rng):
    found = calibrate_camera(views(rng, [0.0] * 8), 1600, 1200)

    assessed = camera_assessment(found, PLUMB_BOB)

    assert np.array_equal(assessed.calibration.covariance.data, found.covariance.data)
