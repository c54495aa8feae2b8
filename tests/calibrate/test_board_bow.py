"""Boards that are flat, and boards that are bowed by a tenth of a millimetre in every view."""

import pytest

from ringpose.calibrate.board_bow import FLAT_SIGMAS, bow_finding
from ringpose.calibrate.board_points import corner_points
from ringpose.calibrate.camera import calibrate_camera
from ringpose.calibrate.camera_model import PLUMB_BOB
from ringpose.types.board import Board, BoardView
from ringpose.types.verdict import Finding

POINTS = corner_points(Board(kind="chessboard", squares_x=12, squares_y=10, square_m=0.025))
NOISE_PX = 0.02


@pytest.fixture
def found(rng, board_view, true_poses):
    """What is said of a board of this height in the middle of its width."""

    def finding(height_m: float) -> Finding:
        bowed = POINTS.copy()
        bowed[:, 2] = height_m * (1 - ((POINTS[:, 0] - 0.15) / 0.125) ** 2)
        views = []
        for index, pose in enumerate(true_poses(rng, 10)):
            seen = board_view(bowed, pose, f"v{index}", NOISE_PX * rng.standard_normal((len(POINTS), 2)))
            views.append(BoardView(name=seen.name, ids=seen.ids, points_board_m=POINTS, points_px=seen.points_px))
        return bow_finding(views, calibrate_camera(views, 1600, 1200).camera, PLUMB_BOB)

    return finding


def test_a_flat_board_is_not_called_bowed(found):
    assert found(0.0).value < FLAT_SIGMAS


def test_a_bowed_board_is_called_so_with_its_height(found):
    finding = found(1e-4)

    height_mm = float(finding.advice.split("about ")[1].split(" mm")[0])
    assert finding.value > FLAT_SIGMAS
    assert height_mm == pytest.approx(0.1, abs=0.03)
