"""Layout of boards on pages."""

import numpy as np
import pytest

from ringpose.geometry.board import outline_m
from ringpose.report.board_print import A4_BOARDS, RIM_M, board_drawing
from ringpose.types.board import Board

CHESSBOARD = Board(kind="chessboard", squares_x=9, squares_y=6, square_m=0.04)


@pytest.mark.parametrize("board", A4_BOARDS.values(), ids=A4_BOARDS.keys())
def test_the_default_boards_fit_on_a4(board):
    drawing = board_drawing(board)

    assert drawing.page == "A4 landscape"
    assert (drawing.width_m, drawing.height_m) == (0.297, 0.21)


def test_a_board_is_drawn_on_the_smallest_page_that_holds_it_or_on_one_of_its_own_size():
    drawing = board_drawing(Board(kind="chessboard", squares_x=10, squares_y=10, square_m=0.2))

    assert board_drawing(CHESSBOARD).page == "A3 landscape"
    assert drawing.page == "of its own size"
    assert drawing.width_m > 2.0


def test_all_is_on_the_page_and_the_rim_around_the_board_is_white():
    drawing = board_drawing(CHESSBOARD)

    x, y, width, height = drawing.rectangles_m.T
    assert x.min() > 0
    assert y.min() > 0
    assert (x + width).max() < drawing.width_m
    assert (y + height).max() < drawing.height_m
    left, top = drawing.origin_m
    size = outline_m(CHESSBOARD)
    beside = (x + width < left + 1e-9) | (y > top + size[1] - 1e-9)
    gap = np.maximum(left - (x + width), y - (top + size[1]))[beside]
    assert gap.min() > RIM_M - 2e-4


def test_rulers_have_a_tick_every_ten_millimetres():
    drawing = board_drawing(CHESSBOARD)

    thin = drawing.rectangles_m[(drawing.rectangles_m[:, 2] < 1e-3)]
    middles = np.sort(thin[:, 0] + thin[:, 2] / 2) - drawing.origin_m[0]
    assert middles == pytest.approx(0.01 * np.arange(37), abs=1e-12)
