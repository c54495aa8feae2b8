"""Printable boards, rasterised by poppler and detected at their true scale."""

import subprocess
from dataclasses import replace
from math import ceil

import cv2
import numpy as np
import pytest
from needed import needed_program

from ringpose.calibrate.boards.views import find_board
from ringpose.errors import DataError
from ringpose.report.board_print import A4_BOARDS, board_drawing, pdf
from ringpose.types.board import Board, BoardMarker, BoardView

BOARDS = {
    **A4_BOARDS,
    "chessboard": Board(kind="chessboard", squares_x=8, squares_y=5, square_m=0.03),
    "aruco_grid": Board(
        kind="aruco_grid", squares_x=3, squares_y=2, marker_m=0.06, gap_m=0.02, dictionary="DICT_4X4_50"
    ),
    "marker_map": Board(
        kind="marker_map",
        dictionary="DICT_4X4_50",
        markers=(
            BoardMarker(id=30, corners_m=((0.0, 0.0), (0.06, 0.0), (0.06, 0.06), (0.0, 0.06))),
            BoardMarker(id=4, corners_m=((0.2, 0.05), (0.2, 0.1), (0.15, 0.1), (0.15, 0.05))),  # turned clockwise
        ),
    ),
    "separate_squares": Board(kind="separate_squares", squares_x=6, squares_y=5, square_m=0.02, gap_m=0.015),
    "aprilgrid": Board(
        kind="aprilgrid", squares_x=4, squares_y=3, marker_m=0.04, gap_m=0.012, dictionary="DICT_APRILTAG_36h11"
    ),
    "asymmetric_circles": Board(kind="asymmetric_circles", squares_x=4, squares_y=7, spacing_m=0.02),
}
INCH_M = 0.0254


def misplaced_m(image: np.ndarray, board: Board, dots_per_inch: float) -> float:
    """Maximum distance of detected corners from those of the drawing, in metres on the page."""
    found = find_board(image, board, "page")
    assert isinstance(found, BoardView)
    position_m = (found.points_px + 0.5) * INCH_M / dots_per_inch
    true_m = found.points_board_m[:, :2] + board_drawing(board).origin_m
    return float(np.abs(position_m - true_m).max())


SLOW = ("chessboard", "aruco_grid", "aprilgrid", "marker_map", "separate_squares")
"""Boards whose shapes, squares and markers, the other boards have, too."""


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.slow) if kind in SLOW else kind for kind in BOARDS]
)
def test_a_pdf_page_shows_the_board_at_true_scale(kind, tmp_path):
    (tmp_path / "board.pdf").write_bytes(pdf(board_drawing(BOARDS[kind])))
    dots_per_inch = 100 if kind in ("asymmetric_circles", "separate_squares") else 150

    program = [needed_program("pdftoppm", "poppler-utils"), "-r", str(dots_per_inch), "-gray", "-singlefile"]
    subprocess.run([*program, tmp_path / "board.pdf", tmp_path / "page"], check=True)

    image = cv2.imread(str(tmp_path / "page.pgm"), cv2.IMREAD_GRAYSCALE)
    assert image.shape == (ceil(0.21 / INCH_M * dots_per_inch), ceil(0.297 / INCH_M * dots_per_inch))
    assert misplaced_m(image, BOARDS[kind], dots_per_inch) < 4e-5


def test_a_marker_that_is_turned_is_not_drawn_upright():
    marker = BoardMarker(id=30, corners_m=((0.03, 0.0), (0.06, 0.03), (0.03, 0.06), (0.0, 0.03)))
    board = Board(kind="marker_map", dictionary="DICT_4X4_50", markers=(marker,))

    with pytest.raises(DataError, match="marker 30 is turned"):
        board_drawing(board)


def test_the_pdf_requests_printing_without_scaling():
    assert b"/PrintScaling /None" in pdf(board_drawing(BOARDS["charuco"]))


def test_characters_missing_in_the_font_are_replaced():
    board = replace(BOARDS["charuco"], dictionary="板\udc80.yml", marker_bits=("0" * 16,) * 27)

    assert pdf(board_drawing(board)).startswith(b"%PDF-1.7")
