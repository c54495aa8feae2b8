"""Printed boards, rasterised by others and found again at their true scale."""

import re
import struct
import subprocess
from math import ceil
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest

from ringpose.calibrate.board_drawing import A4_BOARDS, board_drawing
from ringpose.calibrate.board_views import find_board
from ringpose.errors import UsageError
from ringpose.files.board_prints import write_board_print
from ringpose.types.board import Board, BoardView

BOARDS = {
    **A4_BOARDS,
    "chessboard": Board(kind="chessboard", squares_x=8, squares_y=5, square_m=0.03),
    "aruco_grid": Board(
        kind="aruco_grid", squares_x=3, squares_y=2, marker_m=0.06, gap_m=0.02, dictionary="DICT_4X4_50"
    ),
    "asymmetric_circles": Board(kind="asymmetric_circles", squares_x=4, squares_y=7, spacing_m=0.02),
}
INCH_M = 0.0254


def misplaced_m(image: np.ndarray, board: Board, dots_per_inch: float) -> float:
    """How far corners of the page lie from where the drawing has them; the board must be found in it."""
    found = find_board(image, board, "page")
    assert isinstance(found, BoardView)
    place_m = (found.points_px + 0.5) * INCH_M / dots_per_inch
    wanted_m = found.points_board_m[:, :2] + board_drawing(board).origin_m
    return float(np.abs(place_m - wanted_m).max())


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=pytest.mark.slow) if kind == "chessboard" else kind for kind in BOARDS]
)
def test_a_pdf_page_shows_the_board_at_true_scale(kind, tmp_path, needed_program):
    write_board_print(tmp_path / "board.pdf", board_drawing(BOARDS[kind]))
    dots_per_inch = 80 if kind == "asymmetric_circles" else 300

    program = [needed_program("pdftoppm"), "-r", str(dots_per_inch), "-gray", "-singlefile"]
    subprocess.run([*program, tmp_path / "board.pdf", tmp_path / "page"], check=True)

    image = cv2.imread(str(tmp_path / "page.pgm"), cv2.IMREAD_GRAYSCALE)
    assert image.shape == (ceil(0.21 / INCH_M * dots_per_inch), ceil(0.297 / INCH_M * dots_per_inch))
    assert misplaced_m(image, BOARDS[kind], dots_per_inch) < 4e-5


@pytest.mark.parametrize("kind", A4_BOARDS)
def test_a_png_says_600_dots_per_inch_and_has_them(kind, tmp_path):
    write_board_print(tmp_path / "board.png", board_drawing(BOARDS[kind]))

    data = (tmp_path / "board.png").read_bytes()
    place = data.index(b"pHYs")
    across, down, unit = struct.unpack(">IIB", data[place + 4 : place + 13])
    assert (across, down, unit) == (23622, 23622, 1)
    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert misplaced_m(image, BOARDS[kind], 600) < 1e-5


def test_an_svg_gives_its_lengths_in_millimetres(tmp_path):
    board = BOARDS["four_markers"]
    write_board_print(tmp_path / "board.svg", board_drawing(board))

    root = ElementTree.parse(tmp_path / "board.svg").getroot()
    assert (root.get("width"), root.get("height")) == ("297.0000mm", "210.0000mm")
    assert root.get("viewBox") == "0 0 297.0000 210.0000"
    path = root.find("{http://www.w3.org/2000/svg}path").get("d")
    assert misplaced_m(painted(path, 297, 210, 8), board, 8 * 25.4) < 4e-5


def painted(path: str, width: int, height: int, scale: int) -> np.ndarray:
    """The rectangles of an SVG path, so many pixels a millimetre."""
    image = np.full((height * scale, width * scale), 255, np.uint8)
    number = r"(-?[\d.]+)"
    for words in re.findall(rf"M{number} {number}h{number}v{number}h{number}z", path):
        x, y, across, down, _ = (round(float(word) * scale) for word in words)
        image[y : y + down, x : x + across] = 0
    return image


def test_any_other_suffix_is_wrong_usage(tmp_path):
    with pytest.raises(UsageError, match=r"no \.pdf, \.svg or \.png"):
        write_board_print(tmp_path / "board.doc", board_drawing(BOARDS["charuco"]))
