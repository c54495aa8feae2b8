"""A calibration board: its markers, the positions of its corners, and its black cells, in the board frame.

The board frame has its origin in the top-left outer corner, x to the right and y down. Corners of a chessboard or
ChArUco board are numbered as in OpenCV, row by row; a marker's corner has the number 4 * marker + corner, clockwise
from the marker's top left.
"""

import math
from typing import Any

import cv2
import numpy as np

from ringpose.errors import DataError
from ringpose.types.arrays import Array, Float64, UInt8
from ringpose.types.board import Board

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
    available, needed = len(dictionary.bytesList), marker_count(board)
    if available < needed:
        finding = f'dictionary "{board.dictionary}" has {available} markers, the board has {needed}'
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
    if board.kind == "four_markers":
        return 4
    squares = (board.squares_x or 0) * (board.squares_y or 0)
    if board.kind == "aruco_grid":
        return squares
    return squares // 2 if board.kind == "charuco" else 0


def corner_points(board: Board) -> Float64[Array, "corner xyz=3"]:
    """All the board's corners (or circle centres) in metres, in the order of their numbers."""
    columns, rows = board.squares_x or 0, board.squares_y or 0
    corners: Float64[Array, "corner xyz=3"]
    if board.kind in ("chessboard", "charuco"):
        corners = np.array([*board.square_size_m, 0.0]) * (_lattice(columns - 1, rows - 1) + _FIRST)
        return corners
    if board.kind == "asymmetric_circles":  # as in OpenCV: circles of a row two spacings apart, odd rows shifted by one
        lattice = _lattice(columns, rows)
        lattice[:, 0] = 2 * lattice[:, 0] + lattice[:, 1] % 2
        corners = (board.spacing_m or 0.0) * (lattice + _FIRST)
        return corners
    return marker_corners(board).reshape(-1, 3)


def marker_corners(board: Board) -> Float64[Array, "marker corner=4 xyz=3"]:
    """The corners of the board's markers in metres, clockwise from the top left; none on a plain chessboard."""
    side, lattice = board.marker_m or 0.0, _lattice(board.squares_x or 0, board.squares_y or 0)
    if board.kind == "four_markers":  # clockwise from the top left, each `margin_m` inside the outline
        left = top = board.margin_m or 0.0
        right, bottom = (board.width_m or 0.0) - left - side, (board.height_m or 0.0) - top - side
        origins = np.array([[left, top, 0.0], [right, top, 0.0], [right, bottom, 0.0], [left, bottom, 0.0]])
    elif board.kind == "aruco_grid":
        origins = (side + (board.gap_m or 0.0)) * lattice
    elif board.kind == "charuco":  # one in the middle of each white square, row by row
        lattice = lattice[[is_white(int(x), int(y), board) for x, y, _ in lattice]]
        rim = ((board.square_m or 0.0) - side) / 2
        origins = (board.square_m or 0.0) * lattice + [rim, rim, 0.0]
    else:
        return np.empty((0, 4, 3))
    return origins[:, None] + side * np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


def is_white(column: int, row: int, board: Board) -> bool:
    """Whether a square is white: the top-left one is black, on a legacy ChArUco board of even rows white."""
    legacy_white = board.kind == "charuco" and board.legacy_pattern and (board.squares_y or 0) % 2 == 0
    return (column + row) % 2 == (0 if legacy_white else 1)


def _lattice(columns: int, rows: int) -> Float64[Array, "point xyz=3"]:
    """Points (column, row, 0), row by row."""
    row, column = np.mgrid[0:rows, 0:columns]
    return np.stack([column.ravel(), row.ravel(), np.zeros(row.size)], axis=1).astype(np.float64)


def outline_m(board: Board) -> tuple[float, float]:
    """Width and height of the board's printed face in metres."""
    if board.kind == "four_markers":
        return board.width_m or 0.0, board.height_m or 0.0
    columns, rows = board.squares_x or 0, board.squares_y or 0
    if board.kind == "aruco_grid":
        marker, gap = board.marker_m or 0.0, board.gap_m or 0.0
        return columns * marker + (columns - 1) * gap, rows * marker + (rows - 1) * gap
    if board.kind == "asymmetric_circles":
        spacing = board.spacing_m or 0.0
        return (2 * columns + 1) * spacing, (rows + 1) * spacing
    width, height = board.square_size_m
    return columns * width, rows * height


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
            np.append(positions, side_m * np.arange(count + 1))
            for positions, side_m, count in zip(lines, board.square_size_m, counts, strict=True)
        ]
    print_x, print_y = (np.unique(positions.round(12)) for positions in lines)
    middle_x, middle_y = ((positions[1:] + positions[:-1]) / 2 for positions in (print_x, print_y))
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
