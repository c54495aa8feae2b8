"""Rendered views of boards."""

import functools
import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from drawn_boards import FOUR
from known_views import projected_px, rotation

from ringpose.types.board import BoardView
from ringpose.types.image import Shot


@pytest.fixture(scope="session")
def rendered_plane_views(shared_data) -> Callable[[str], list[tuple[Shot, BoardView]]]:
    """The rendered shots of the four-marker board whose files are named so, and the board in each."""
    from ringpose.calibrate.boards.views import find_board
    from ringpose.files.images.shots import read_shot
    from ringpose.types.image import board_image

    @functools.cache  # finding a board takes a fifth of a second
    def view(path: Path) -> tuple[Shot, BoardView]:
        shot = read_shot(path)
        return shot, find_board(board_image(shot), FOUR, shot.name)

    return lambda names: [view(path) for path in sorted((shared_data / "rendered/calib_b/planes").glob(names))]


@pytest.fixture
def rendered_truth(shared_data) -> Callable[[str, np.ndarray], np.ndarray]:
    """True pixels of board points in a rendered calibration view."""
    lines = (shared_data / "rendered" / "calib_b" / "truth.jsonl").read_text().splitlines()
    truths = {truth["view"]: truth for truth in map(json.loads, lines)}

    def pixels(view: str, points_m: np.ndarray) -> np.ndarray:
        turn = rotation(truths[view]["camera_from_board_rvec"])
        return projected_px(points_m @ turn.T + np.array(truths[view]["camera_from_board_tvec_m"]))

    return pixels
