"""Rendered views of boards."""

import json
from collections.abc import Callable

import numpy as np
import pytest
from drawn_boards import FOUR
from known_views import projected_px, rotation

from ringpose.types.board import BoardView
from ringpose.types.image import Shot


@pytest.fixture(scope="session")
def rendered_plane_views(shared_data) -> list[tuple[Shot, BoardView]]:
    """The rendered shots of the four-marker board, and the board in each; finding it takes most of a second."""
    from ringpose.calibrate.boards.views import find_board
    from ringpose.files.images.shots import read_shot
    from ringpose.types.image import board_image

    shots = [read_shot(path) for path in sorted((shared_data / "rendered" / "calib_b" / "planes").glob("*.npz"))]
    return [(shot, find_board(board_image(shot), FOUR, shot.name)) for shot in shots]


@pytest.fixture
def rendered_truth(shared_data) -> Callable[[str, np.ndarray], np.ndarray]:
    """True pixels of board points in a rendered calibration view."""
    lines = (shared_data / "rendered" / "calib_b" / "truth.jsonl").read_text().splitlines()
    truths = {truth["view"]: truth for truth in map(json.loads, lines)}

    def pixels(view: str, points_m: np.ndarray) -> np.ndarray:
        turn = rotation(truths[view]["camera_from_board_rvec"])
        return projected_px(points_m @ turn.T + np.array(truths[view]["camera_from_board_tvec_m"]))

    return pixels
