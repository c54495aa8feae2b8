"""Where on a board stripes are trusted."""

import numpy as np
import pytest

from ringpose.calibrate.board_surface import BoardSurface
from ringpose.types.board import Board, BoardPose


@pytest.fixture
def surface(true_camera) -> BoardSurface:
    """Half a metre away and facing the camera: 0.28 mm a pixel."""
    pose = BoardPose(name="b", rotation=np.eye(3), translation_m=np.array([-0.1, -0.1, 0.5]), residual_rms_px=0.0)
    board = Board(kind="chessboard", squares_x=6, squares_y=5, square_m=0.03)
    return BoardSurface(board=board, pose=pose, camera=true_camera)


def usable_at(surface, project_px, place_m) -> bool:
    point = np.array([[*place_m, 0.0]]) + surface.pose.translation_m
    return bool(surface.usable(project_px(point))[0])


@pytest.mark.parametrize(
    ("place_m", "usable"),
    [
        ((0.045, 0.015), True),  # middle of a light square
        ((0.015, 0.015), False),  # of the dark one in the corner
        ((0.075, 0.045), True),
        ((0.045, 0.045), False),
        ((0.031, 0.015), False),  # 1 mm beside an edge
        ((0.045, 0.029), False),
        ((0.2, 0.015), False),  # beside the board
    ],
)
def test_only_light_squares_away_from_their_edges_are_used(place_m, usable, surface, true_camera):
    from ringpose.geometry.rays import project

    assert usable_at(surface, lambda point: project(point, true_camera), place_m) is usable
