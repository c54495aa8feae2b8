"""Reasons why an image shows no grid of circles: the number of circles, and their rows and columns."""

import cv2
import numpy as np
import pytest

from ringpose.calibrate.boards.diagnostics import BoardFailure
from ringpose.calibrate.boards.views import find_board
from ringpose.types.board import Board

BOARD = Board(kind="asymmetric_circles", squares_x=4, squares_y=11, spacing_m=0.02)


def drawn(columns: int, rows: int, white: int) -> np.ndarray:
    """Every second row half a step to the right, 40 pixels a step of the rows."""
    image = np.full((40 * rows + 40, 80 * columns + 80), white, np.uint8)
    for row in range(rows):
        for column in range(columns):
            cv2.circle(image, (80 * column + 40 * (row % 2) + 50, 40 * row + 40), 14, 20, -1)
    return image


@pytest.mark.parametrize(
    ("image", "text"),
    [
        (drawn(5, 9, 255), "45 circles are seen, the board has 4 x 11 = 44"),
        (np.full((480, 640), 128, np.uint8), "0 circles are seen, the board has 4 x 11 = 44, nothing has contrast"),
    ],
    ids=["another grid", "even image"],
)
def test_the_number_of_circles_is_reported(image, text):
    found = find_board(image, BOARD, "x")

    assert found.failure is BoardFailure.NOT_WHOLE
    assert found.found.startswith(text)


@pytest.mark.parametrize("kept", [np.s_[:, :210], np.s_[:250]], ids=["columns", "rows"])
def test_the_number_of_circles_of_part_of_a_grid_is_reported(kept):
    found = find_board(drawn(4, 11, 200)[kept].copy(), BOARD, "part")

    assert found.failure is BoardFailure.NOT_WHOLE
    assert int(found.found.split()[0]) in range(20, 26)
