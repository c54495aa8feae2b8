"""Boards that are flat, and boards that are bowed by a tenth of a millimetre in every view."""

from collections.abc import Sequence
from dataclasses import replace

import pytest
from known_views import board_view, true_poses

from ringpose.calibrate.camera.assessment import bow_finding, camera_assessment
from ringpose.calibrate.camera.bundle_adjustment import CameraSolution, camera_solution
from ringpose.calibrate.camera.parameters import PLUMB_BOB
from ringpose.calibrate.camera.pipeline import calibrate_camera
from ringpose.geometry.board import corner_points
from ringpose.types.board import Board, BoardView
from ringpose.types.calibration import Grade

POINTS = corner_points(Board(kind="chessboard", squares_x=12, squares_y=10, square_m=0.025))
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
    flat = views(rng, [0.0] * 10)

    assert bow_finding(flat, solved(flat), PLUMB_BOB).grade is Grade.GOOD


def test_a_bowed_board_is_reported_with_its_height(rng):
    bowed = views(rng, [1e-4] * 10)

    finding = bow_finding(bowed, solved(bowed), PLUMB_BOB)

    height_mm = float(finding.advice.split("about ")[1].split(" mm")[0])
    assert finding.grade is not Grade.GOOD
    assert height_mm == pytest.approx(0.1, abs=0.03)


def test_a_board_that_bends_differently_in_each_view_is_not_reported_as_bowed(rng):
    """The mean of ten bows is significant against the corners' noise, but not against the views' disagreement."""
    bending = views(rng, [1e-4, -1e-4, 3e-5, -6e-5, 8e-5, 1e-4, -4e-5, -7e-5, 9e-5, -5e-5])
    found = calibrate_camera(bending, 1600, 1200)

    by_noise = bow_finding(bending, solved(bending), PLUMB_BOB)
    finding = camera_assessment(found, PLUMB_BOB).board[-1]

    assert by_noise.grade is not Grade.GOOD
    assert finding.grade is Grade.GOOD
