"""Reasons why an image shows no grid of circles: the number of circles, and their rows and columns."""

from dataclasses import replace

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


def test_the_rows_and_columns_of_another_circle_grid_are_reported():
    found = find_board(drawn(5, 9, 200), BOARD, "other")

    assert found.failure is BoardFailure.OTHER_SIZE
    assert found.found.startswith("45 circles are seen, the board has 4 x 11 = 44")
    assert "they lie as 5 x 9 would" in found.found


@pytest.mark.parametrize("kept", [np.s_[:, :210], np.s_[:250]], ids=["columns", "rows"])
def test_part_of_the_circles_is_not_taken_for_another_board(kept):
    found = find_board(drawn(4, 11, 200)[kept].copy(), BOARD, "part")

    assert found.failure is BoardFailure.NOT_WHOLE
    assert int(found.found.split()[0]) in range(20, 26)


def test_a_clean_white_print_is_not_reported_as_overexposed():
    found = find_board(drawn(4, 11, 255), replace(BOARD, squares_x=5, squares_y=9), "clean")

    assert found.failure is BoardFailure.OTHER_SIZE
    assert "they lie as 4 x 11 would" in found.found


def test_an_even_image_is_not_reported_as_blurred():
    found = find_board(np.full((480, 640), 128, np.uint8), BOARD, "even")

    assert found.failure is BoardFailure.NOT_WHOLE
    assert found.found.endswith("nothing has contrast")
