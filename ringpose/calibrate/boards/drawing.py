"""A calibration board laid out on a page at true scale, with rulers to check the print by."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from ringpose.calibrate.boards.layout import corner_points, is_white, marker_corners, marker_dictionary, outline_m
from ringpose.types.arrays import Array, Float64, UInt8
from ringpose.types.board import Board

PAGES_M = {
    "A4": (0.210, 0.297),
    "A3": (0.297, 0.420),
    "A2": (0.420, 0.594),
    "A1": (0.594, 0.841),
    "A0": (0.841, 1.189),
}
"""Short and long side of the pages that are tried, in metres, the smallest first."""

RIM_M = 0.010
"""Width of the white rim around the board: markers at its edge need it, and printers do not print to the edge."""

RULER_M = 0.014
"""Width of the strips below and to the left of the board, beyond the rim, for the rulers with their numbers."""

TEXT_M = 0.008
"""Height of the strip below the lower ruler, for the description of the board."""

CIRCLE_SHARE = 0.5
"""Diameter of the circles of a circle grid over the spacing of their rows."""

A4_BOARDS = {
    "charuco": Board(
        kind="charuco", squares_x=9, squares_y=6, square_m=0.027, marker_m=0.02, dictionary="DICT_5X5_100"
    ),
    "four_markers": Board(
        kind="four_markers", width_m=0.25, height_m=0.165, marker_m=0.045, margin_m=0.005, dictionary="DICT_4X4_50"
    ),
}
"""Boards that fit on a page of A4, by kind."""

_LETTERS_M = 0.0028
_TICK_M = 0.00015


@dataclass(frozen=True, slots=True, kw_only=True)
class Label:
    """A line of text; its left end and base line."""

    x_m: float
    y_m: float
    text: str
    height_m: float = _LETTERS_M


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardDrawing:
    """Black shapes on a white page; origin at the page's top-left corner, x right, y down."""

    page: str
    """The page's name, or its size."""
    width_m: float
    height_m: float
    rectangles_m: Float64[Array, "rectangle side=4"]
    """x, y, width, height; none overlaps another."""
    circles_m: Float64[Array, "circle side=3"]
    """Centre x, y and radius."""
    labels: tuple[Label, ...]
    origin_m: tuple[float, float]
    """Position of the board frame's origin on the page."""


def board_drawing(board: Board) -> BoardDrawing:
    """The board in the middle of the smallest page that holds it with its rulers, in portrait or landscape."""
    width_m, height_m = outline_m(board)
    needed_m = (width_m + 2 * RIM_M + RULER_M, height_m + 2 * RIM_M + RULER_M + TEXT_M)
    page, page_m = _page(needed_m)
    origin_m = ((page_m[0] - needed_m[0]) / 2 + RULER_M + RIM_M, (page_m[1] - needed_m[1]) / 2 + RIM_M)
    below_m = origin_m[1] + height_m + RIM_M
    across, numbers_x = _ruler(origin_m[0], below_m, width_m)
    down, numbers_y = _ruler(origin_m[1], origin_m[0] - RIM_M, height_m)
    shift = np.array([*origin_m, 0.0, 0.0])
    circles_m = np.empty((0, 3))
    if board.kind == "asymmetric_circles":
        centers_m = corner_points(board)[:, :2] + origin_m
        circles_m = np.column_stack([centers_m, np.full(len(centers_m), CIRCLE_SHARE * (board.spacing_m or 0.0) / 2)])
    upright = np.column_stack([down[:, 1] - down[:, 3], down[:, 0], down[:, 3], down[:, 2]])
    names = tuple(
        Label(x_m=origin_m[0] - RIM_M - 0.0125, y_m=number.x_m + _LETTERS_M, text=number.text) for number in numbers_y
    )
    words = Label(x_m=origin_m[0], y_m=below_m + RULER_M + _LETTERS_M, text=_description(board, page, page_m))
    return BoardDrawing(
        page=page,
        width_m=page_m[0],
        height_m=page_m[1],
        rectangles_m=np.concatenate([_black_rectangles(board) + shift, across, upright]),
        circles_m=circles_m,
        labels=(*numbers_x, *names, words),
        origin_m=origin_m,
    )


def _page(needed_m: tuple[float, float]) -> tuple[str, tuple[float, float]]:
    """Name and size of the smallest page that holds an area of this width and height."""
    for name, (short, long) in PAGES_M.items():
        for page_m, way in (((short, long), "portrait"), ((long, short), "landscape")):
            if needed_m[0] <= page_m[0] and needed_m[1] <= page_m[1]:
                return f"{name} {way}", page_m
    return "of its own size", needed_m


def _ruler(start_m: float, beside_m: float, length_m: float) -> tuple[Float64[Array, "tick side=4"], list[Label]]:
    """Ticks every 10 mm along x from `start_m`, hanging below `beside_m`, and numbers in millimetres every 50."""
    steps = np.arange(int(length_m / 0.01 + 1e-6) + 1)
    place = start_m + 0.01 * steps
    height = np.where(steps % 5 == 0, 0.006, 0.003)
    ticks = np.column_stack([place - _TICK_M / 2, np.full(len(steps), beside_m), np.full(len(steps), _TICK_M), height])
    numbers = [
        Label(x_m=float(x) + 0.0006, y_m=beside_m + 0.0095, text=f"{10 * int(step)}{' mm' if step == 0 else ''}")
        for x, step in zip(place, steps, strict=True)
        if step % 5 == 0
    ]
    return ticks, numbers


def _description(board: Board, page: str, page_m: tuple[float, float]) -> str:
    """A line of text with the board's kind and sizes; the rulers show whether the print has another scale."""
    sizes = {
        key.removesuffix("_m"): f"{1e3 * value:g} mm"
        for key in ("square_m", "square_y_m", "marker_m", "gap_m", "spacing_m", "width_m", "height_m", "margin_m")
        if (value := getattr(board, key)) is not None
    }
    counts = f" {board.squares_x} x {board.squares_y}" if board.squares_x else ""
    text = ", ".join([f"{board.kind}{counts}", *([board.dictionary] if board.dictionary else [])])
    text += "".join(f", {key} {size}" for key, size in sizes.items())
    return f"{text}. Page {page}, {1e3 * page_m[0]:.0f} x {1e3 * page_m[1]:.0f} mm: print at 100 %, then measure."


def _black_rectangles(board: Board) -> Float64[Array, "rectangle side=4"]:
    """x, y, width and height in the board frame of the black parts of the print, neighbours in a row joined."""
    x_m, y_m, cells = board_print(board)
    rectangles = []
    for row, black in enumerate(cells[1:-1]):
        ends = np.flatnonzero(np.diff(black.astype(np.int8))).reshape(-1, 2)
        rectangles += [(x_m[a], y_m[row], x_m[b] - x_m[a], y_m[row + 1] - y_m[row]) for a, b in ends]
    return np.array(rectangles, dtype=np.float64).reshape(-1, 4)


def board_print(
    board: Board,
) -> tuple[Float64[Array, "line_x"], Float64[Array, "line_y"], UInt8[Array, "cell_y cell_x"]]:
    """Lines along x and y at which the print may change, and which of the cells between and outside them are black."""
    width_m, height_m = outline_m(board)
    bits = _marker_bits(board)
    origins_m = marker_corners(board)[:, 0, :2] if len(bits) else np.empty((0, 2))
    bit_m = (board.marker_m or 0.0) / bits.shape[1]
    within_m = bit_m * np.arange(bits.shape[1] + 1)
    lines = [
        np.append((origins_m[:, [axis]] + within_m).ravel(), [0.0, length_m])
        for axis, length_m in enumerate((width_m, height_m))
    ]
    if board.square_m is not None:
        counts = (board.squares_x or 0, board.squares_y or 0)
        lines = [
            np.append(each, side_m * np.arange(count + 1))
            for each, side_m, count in zip(lines, board.square_size_m, counts, strict=True)
        ]
    print_x, print_y = (np.unique(each.round(12)) for each in lines)
    middle_x, middle_y = ((each[1:] + each[:-1]) / 2 for each in (print_x, print_y))
    black = np.zeros((len(print_y) + 1, len(print_x) + 1), dtype=np.uint8)
    if board.square_m is not None:
        columns, rows = (
            np.floor(middle / side).astype(int)
            for middle, side in zip((middle_x, middle_y), board.square_size_m, strict=True)
        )
        squares = np.array([[not is_white(x, y, board) for x in range(counts[0])] for y in range(counts[1])])
        black[1:-1, 1:-1] = squares[rows[:, None], columns]
    for (x_m, y_m), marker in zip(origins_m, bits, strict=True):
        column, row = ((middle - start) / bit_m for middle, start in ((middle_x, x_m), (middle_y, y_m)))
        across, down = (np.flatnonzero((place > 0) & (place < len(marker))) for place in (column, row))
        pattern = marker[row[down].astype(int)[:, None], column[across].astype(int)]
        black[1 + down[:, None], 1 + across] = 1 - pattern
    return print_x, print_y, black


def _marker_bits(board: Board) -> UInt8[Array, "marker bit_y bit_x"]:
    """Whether each cell of each marker, including its black border, is white."""
    count = 0 if board.marker_m is None else len(marker_corners(board))
    if count == 0:
        return np.zeros((0, 1, 1), dtype=np.uint8)
    aruco: Any = cv2.aruco
    dictionary = marker_dictionary(board)
    size = dictionary.markerSize + 2
    markers = [aruco.generateImageMarker(dictionary, number, size) for number in range(count)]
    return (np.stack(markers) > 127).astype(np.uint8)
