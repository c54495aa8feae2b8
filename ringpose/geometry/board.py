"""A calibration board: its markers, the positions of its corners, and its black cells, in the board frame.

The board frame has its origin in the top-left outer corner, x to the right and y down. Corners of a chessboard or
ChArUco board are numbered as in OpenCV, row by row; a marker's corner has the number 4 * marker + corner, clockwise
from the marker's top left, the markers of a map in the order of its list. On an AprilGrid it has that of Kalibr: row by
row from the lower left, across all markers.
"""

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import cv2
import numpy as np

from ringpose.errors import DataError
from ringpose.types.arrays import Array, Float64, Int64, UInt8
from ringpose.types.board import Board, BoardKind

FLATTENED = 1e-6
"""Deviation from an upright square, in sides, that is the rounding of numbers in a file, not a turn of the marker."""

_FIRST = np.array([1.0, 1.0, 0.0])
"""Position of the first corner or circle, in squares or spacings."""


def marker_dictionary(board: Board) -> cv2.aruco.Dictionary:
    """The board's dictionary, predefined in OpenCV or read from a file; it has all the board's markers."""
    name = board.dictionary or ""
    if board.marker_bits:
        dictionary = _custom_dictionary(board.marker_bits)
    elif name.startswith("DICT_") and hasattr(cv2.aruco, name):
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))
    else:
        remedy = "give one of OpenCV's, for example DICT_4X4_50, or a dictionary file"
        raise DataError("board", f'no dictionary "{name}"', remedy)
    available, needed = len(dictionary.bytesList), max(marker_ids(board), default=-1) + 1
    if available < needed:
        finding = f'dictionary "{board.dictionary}" has {available} markers, the board has {needed}'
        if board.markers:
            finding = f'dictionary "{board.dictionary}" has markers 0 to {available - 1}, the board has {needed - 1}'
        raise DataError("board", finding, "give a larger dictionary, or correct the number of squares")
    return dictionary


def _custom_dictionary(marker_bits: tuple[str, ...]) -> cv2.aruco.Dictionary:
    """A dictionary that corrects up to (d - 1) / 2 wrong bits, d the minimum Hamming distance of its markers."""
    side = math.isqrt(len(marker_bits[0]))
    bits = np.array([[int(bit) for bit in marker] for marker in marker_bits], dtype=np.uint8).reshape(-1, side, side)
    rows = [cv2.aruco.Dictionary.getByteListFromBits(marker) for marker in bits]
    # The minimum over two markers in any rotation, and over a marker and itself rotated.
    rotated = np.stack([np.rot90(bits, turns, axes=(1, 2)) for turns in range(4)])
    distance = np.sum(rotated[:, :, None] != bits, axis=(-2, -1))
    distance[0][np.diag_indices(len(bits))] = bits[0].size
    return cv2.aruco.Dictionary(np.concatenate(rows), side, (int(distance.min()) - 1) // 2)


def marker_count(board: Board) -> int:
    """Number of markers on the board; zero for boards without markers."""
    return len(marker_corners(board)) if board.dictionary else 0


def marker_ids(board: Board) -> Sequence[int]:
    """The numbers of the board's markers in its dictionary, in the order of `marker_corners`."""
    return [marker.id for marker in board.markers] or range(marker_count(board))


def corner_points(board: Board) -> Float64[Array, "corner xyz=3"]:
    """All the board's corners (or circle centres) in metres, in the order of their numbers."""
    return LAYOUTS[board.kind].corners(board)


def marker_corners(board: Board) -> Float64[Array, "marker corner=4 xyz=3"]:
    """The corners of the board's markers in metres, clockwise from the top left; separate squares are like markers."""
    return LAYOUTS[board.kind].markers(board)


def corner_numbers(board: Board) -> Int64[Array, "marker corner=4"]:
    """The numbers of the corners of the board's markers, in the order of `marker_corners`."""
    return LAYOUTS[board.kind].numbers(board)


def black_rectangles(board: Board) -> Float64[Array, "rectangle corner=4 xyz=3"]:
    """The corners of what is printed in black beside the markers, clockwise from the top left."""
    return LAYOUTS[board.kind].black(board)


def outline_m(board: Board) -> tuple[float, float]:
    """Width and height of the board's printed face in metres."""
    return LAYOUTS[board.kind].outline_m(board)


def is_white(column: int, row: int, board: Board) -> bool:
    """Whether a square is white: the top-left one is black, on a legacy ChArUco board of even rows white."""
    legacy_white = board.kind == "charuco" and board.legacy_pattern and (board.squares_y or 0) % 2 == 0
    return (column + row) % 2 == (0 if legacy_white else 1)


def _lattice(columns: int | None, rows: int | None) -> Float64[Array, "point xyz=3"]:
    """Points (column, row, 0), row by row."""
    row, column = np.mgrid[0 : rows or 0, 0 : columns or 0]
    return np.stack([column.ravel(), row.ravel(), np.zeros(row.size)], axis=1).astype(np.float64)


def _squares_at(origins: Float64[Array, "square xyz=3"], side_m: float) -> Float64[Array, "square corner=4 xyz=3"]:
    """The corners of upright squares, clockwise from the top left, where that is given."""
    return origins[:, None] + side_m * np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


# The corners and markers of each kind of board


def _inner_corners(board: Board) -> Float64[Array, "corner xyz=3"]:
    corners: Float64[Array, "corner xyz=3"] = np.array([*board.square_size_m, 0.0]) * (
        _lattice((board.squares_x or 1) - 1, (board.squares_y or 1) - 1) + _FIRST
    )
    return corners


def _asymmetric_centers(board: Board) -> Float64[Array, "circle xyz=3"]:
    """As in OpenCV: circles of a row two spacings apart, odd rows shifted by one."""
    lattice = _lattice(board.squares_x, board.squares_y)
    lattice[:, 0] = 2 * lattice[:, 0] + lattice[:, 1] % 2
    return board.circle_spacing_m * (lattice + _FIRST)


def _symmetric_centers(board: Board) -> Float64[Array, "circle xyz=3"]:
    return board.circle_spacing_m * (_lattice(board.squares_x, board.squares_y) + _FIRST)


def _corners_of_markers(board: Board) -> Float64[Array, "corner xyz=3"]:
    corners = marker_corners(board)
    points = np.empty((4 * len(corners), 3))
    points[corner_numbers(board)] = corners
    return points


def _numbered_by_marker(board: Board) -> Int64[Array, "marker corner=4"]:
    return np.arange(4 * len(marker_corners(board))).reshape(-1, 4)


def _none(_: Board) -> Float64[Array, "rectangle corner=4 xyz=3"]:
    return np.empty((0, 4, 3))


def _charuco_markers(board: Board) -> Float64[Array, "marker corner=4 xyz=3"]:
    """One in the middle of each white square, row by row."""
    square, side = board.square_m or 0.0, board.marker_m or 0.0
    white = [
        point for point in _lattice(board.squares_x, board.squares_y) if is_white(int(point[0]), int(point[1]), board)
    ]
    rim = (square - side) / 2
    return _squares_at(square * np.reshape(white, (-1, 3)) + [rim, rim, 0.0], side)


def _four_markers(board: Board) -> Float64[Array, "marker corner=4 xyz=3"]:
    """Clockwise from the top left, each `margin_m` inside the outline."""
    side, left = board.marker_m or 0.0, board.margin_m or 0.0
    right, bottom = (board.width_m or 0.0) - left - side, (board.height_m or 0.0) - left - side
    origins = np.array([[left, left, 0.0], [right, left, 0.0], [right, bottom, 0.0], [left, bottom, 0.0]])
    return _squares_at(origins, side)


def _grid_of_squares(board: Board) -> Float64[Array, "square corner=4 xyz=3"]:
    """Markers, or separate squares, with gaps between them."""
    side = board.marker_m or board.square_m or 0.0
    return _squares_at((side + (board.gap_m or 0.0)) * _lattice(board.squares_x, board.squares_y), side)


def _given_markers(board: Board) -> Float64[Array, "marker corner=4 xyz=3"]:
    corners = np.array([marker.corners_m for marker in board.markers]).reshape(-1, 4, 2)
    return np.concatenate([corners, np.zeros((*corners.shape[:2], 1))], axis=-1)


def _april_markers(board: Board) -> Float64[Array, "marker corner=4 xyz=3"]:
    """Row by row from the lower left, turned by half a turn against OpenCV's pictures of them: as Kalibr draws them."""
    gap, rows = board.gap_m or 0.0, (board.squares_y or 0)
    upwards = _lattice(board.squares_x, rows)
    downwards = upwards * [1, -1, 0] + [0, rows - 1, 0]
    origins = ((board.marker_m or 0.0) + gap) * downwards + [gap, gap, 0]
    return np.roll(_squares_at(origins, board.marker_m or 0.0), 2, axis=1)


def _april_numbers(board: Board) -> Int64[Array, "marker corner=4"]:
    """Row by row from the lower left, a row through the lower or the upper corners of all markers beside each other."""
    columns = board.squares_x or 0
    column, row, _ = _lattice(columns, board.squares_y).astype(np.int64).T
    lower_left = 4 * columns * row + 2 * column
    return np.stack([lower_left + 1, lower_left, lower_left + 2 * columns, lower_left + 2 * columns + 1], axis=1)


# What is printed beside the markers


def _chessboard_squares(board: Board) -> Float64[Array, "rectangle corner=4 xyz=3"]:
    lattice = _lattice(board.squares_x, board.squares_y)
    black = lattice[[not is_white(int(x), int(y), board) for x, y, _ in lattice]]
    return _squares_at(black, 1.0) * [*board.square_size_m, 0.0]


def _april_squares(board: Board) -> Float64[Array, "rectangle corner=4 xyz=3"]:
    """Small squares at the corners of the markers, which make chessboard corners of them."""
    gap = board.gap_m or 0.0
    lattice = _lattice((board.squares_x or 0) + 1, (board.squares_y or 0) + 1)
    return _squares_at(((board.marker_m or 0.0) + gap) * lattice, gap)


# The outline of each kind of board


def _squares_outline(board: Board) -> tuple[float, float]:
    width, height = board.square_size_m
    return (board.squares_x or 0) * width, (board.squares_y or 0) * height


def _grid_outline(board: Board) -> tuple[float, float]:
    marker, gap = board.marker_m or board.square_m or 0.0, board.gap_m or 0.0
    columns, rows = board.squares_x or 0, board.squares_y or 0
    return columns * marker + (columns - 1) * gap, rows * marker + (rows - 1) * gap


def _map_outline(board: Board) -> tuple[float, float]:
    width_m, height_m, _ = marker_corners(board).max(axis=(0, 1))
    return float(width_m), float(height_m)


def _april_outline(board: Board) -> tuple[float, float]:
    """With the small squares beyond the outer markers."""
    width_m, height_m = _grid_outline(board)
    return width_m + 2 * (board.gap_m or 0.0), height_m + 2 * (board.gap_m or 0.0)


def _circles_outline(board: Board) -> tuple[float, float]:
    """One spacing beyond the outermost centres."""
    width, height = corner_points(board)[:, :2].max(axis=0) + board.circle_spacing_m
    return float(width), float(height)


def _given_outline(board: Board) -> tuple[float, float]:
    return board.width_m or 0.0, board.height_m or 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Layout:
    """What distinguishes a kind of board."""

    pattern: Literal["chessboard", "charuco", "markers", "aprilgrid", "circles", "squares"]
    """What is searched in an image."""
    keys: tuple[tuple[str, ...], ...]
    """The keys of its board file: of each tuple exactly one must be there."""
    optional: tuple[str, ...] = ()
    """Further sizes in its board file."""
    min_count: int = 1
    """Minimum number of squares, markers or circles a side."""
    corners: Callable[[Board], Float64[Array, "corner xyz=3"]] = _corners_of_markers
    markers: Callable[[Board], Float64[Array, "marker corner=4 xyz=3"]] = _none
    numbers: Callable[[Board], Int64[Array, "marker corner=4"]] = _numbered_by_marker
    border_cells: int = 1
    """Width of the markers' black border."""
    black: Callable[[Board], Float64[Array, "rectangle corner=4 xyz=3"]] = _none
    outline_m: Callable[[Board], tuple[float, float]]


_COUNTS = (("squares_x",), ("squares_y",))

LAYOUTS: Mapping[BoardKind, Layout] = {
    "charuco": Layout(
        pattern="charuco",
        keys=(*_COUNTS, ("square_m",), ("marker_m",), ("dictionary",)),
        min_count=2,
        corners=_inner_corners,
        markers=_charuco_markers,
        black=_chessboard_squares,
        outline_m=_squares_outline,
    ),
    "chessboard": Layout(
        pattern="chessboard",
        keys=(*_COUNTS, ("square_m",)),
        optional=("square_y_m",),
        min_count=4,
        corners=_inner_corners,
        black=_chessboard_squares,
        outline_m=_squares_outline,
    ),
    "four_markers": Layout(
        pattern="markers",
        keys=(("width_m",), ("height_m",), ("marker_m",), ("margin_m",), ("dictionary",)),
        markers=_four_markers,
        outline_m=_given_outline,
    ),
    "aruco_grid": Layout(
        pattern="markers",
        keys=(*_COUNTS, ("marker_m",), ("gap_m",), ("dictionary",)),
        markers=_grid_of_squares,
        outline_m=_grid_outline,
    ),
    "marker_map": Layout(
        pattern="markers",
        keys=(("markers",), ("dictionary",)),
        markers=_given_markers,
        outline_m=_map_outline,
    ),
    "aprilgrid": Layout(
        pattern="aprilgrid",
        keys=(*_COUNTS, ("marker_m",), ("gap_m",), ("dictionary",)),
        markers=_april_markers,
        numbers=_april_numbers,
        border_cells=2,
        black=_april_squares,
        outline_m=_april_outline,
    ),
    "separate_squares": Layout(
        pattern="squares",
        keys=(*_COUNTS, ("square_m",), ("gap_m",)),
        min_count=2,
        markers=_grid_of_squares,
        black=_grid_of_squares,
        outline_m=_grid_outline,
    ),
    "asymmetric_circles": Layout(
        pattern="circles",
        keys=(*_COUNTS, ("spacing_m", "spacing_in_row_m", "spacing_diagonal_m")),
        min_count=2,
        corners=_asymmetric_centers,
        outline_m=_circles_outline,
    ),
    "symmetric_circles": Layout(
        pattern="circles",
        keys=(*_COUNTS, ("spacing_m",)),
        min_count=2,
        corners=_symmetric_centers,
        outline_m=_circles_outline,
    ),
}
"""The kinds of boards."""


class _Block(NamedTuple):
    """A printed rectangle of cells."""

    left_m: float
    top_m: float
    cell_m: tuple[float, float]
    """Width and height of a cell."""
    white: UInt8[Array, "cell_y cell_x"]


def board_print(
    board: Board,
) -> tuple[Float64[Array, "line_x"], Float64[Array, "line_y"], UInt8[Array, "cell_y cell_x"]]:
    """Lines along x and y at which the print may change, and which of the cells between and outside them are black."""
    blocks = [*_black_squares(board), *_printed_markers(board)]
    lines = []
    for axis, length_m in enumerate(outline_m(board)):
        edges = [block[axis] + block.cell_m[axis] * np.arange(block.white.shape[1 - axis] + 1) for block in blocks]
        lines.append(np.unique(np.concatenate([*edges, [0.0, length_m]]).round(12)))
    print_x, print_y = lines
    middle_x, middle_y = ((positions[1:] + positions[:-1]) / 2 for positions in lines)
    black = np.zeros((len(print_y) + 1, len(print_x) + 1), dtype=np.uint8)
    for left_m, top_m, cell_m, white in blocks:
        column, row = (middle_x - left_m) / cell_m[0], (middle_y - top_m) / cell_m[1]
        across, down = (
            np.flatnonzero((place > 0) & (place < count))
            for place, count in ((column, white.shape[1]), (row, white.shape[0]))
        )
        pattern = white[row[down].astype(int)[:, None], column[across].astype(int)]
        black[1 + down[:, None], 1 + across] = 1 - pattern
    return print_x, print_y, black


def _black_squares(board: Board) -> Iterator[_Block]:
    """What is printed beside the markers."""
    for (left_m, top_m, _), _, (right_m, bottom_m, _), _ in black_rectangles(board):
        yield _Block(left_m, top_m, (right_m - left_m, bottom_m - top_m), np.zeros((1, 1), dtype=np.uint8))


def _printed_markers(board: Board) -> Iterator[_Block]:
    """The markers with their black borders, turned so that their corners are where they are given."""
    if not marker_count(board):
        return
    aruco: Any = cv2.aruco
    dictionary, border = marker_dictionary(board), LAYOUTS[board.kind].border_cells
    size = dictionary.markerSize + 2 * border
    for number, corners in zip(marker_ids(board), marker_corners(board), strict=True):
        from_rim = np.minimum(corners - corners.min(axis=0), corners.max(axis=0) - corners)
        if np.abs(from_rim).max() > FLATTENED * np.ptp(corners[:, 0]):
            remedy = "draw the board with another program; it is found in images all the same"
            raise DataError("board", f"marker {number} is turned, only upright ones are drawn", remedy)
        picture = aruco.generateImageMarker(dictionary, number, size, borderBits=border)
        quarter_turns = int(np.argmin(corners[:, :2].sum(axis=1)))  # own number of the corner at the top left
        side_m = float(np.ptp(corners[:, 0]))
        left_m, top_m, _ = corners.min(axis=0)
        yield _Block(left_m, top_m, (side_m / size,) * 2, (np.rot90(picture, quarter_turns) > 127).astype(np.uint8))
