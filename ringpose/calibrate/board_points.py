"""Where a board's corners and markers are, in the board frame: origin top-left outer corner, x right, y down.

A chessboard's or ChArUco board's corner has the number that it has in OpenCV, row by row; a marker's corner
has the number 4 * marker + corner, clockwise from its top-left.
"""

import numpy as np

from ringpose.types.arrays import Array, Float64
from ringpose.types.board import Board

_FIRST = np.array([1.0, 1.0, 0.0])
"""Place of the first corner or circle, in squares or spacings."""


def corner_points(board: Board) -> Float64[Array, "corner xyz=3"]:
    """All the board's corners (or circle centres) in metres, at the index that is their number."""
    if board.kind == "chessboard" or board.kind == "charuco":
        return _inner_corners(board)
    if board.kind == "asymmetric_circles":
        return _circle_centers(board)
    return marker_corners(board).reshape(-1, 3)


def marker_corners(board: Board) -> Float64[Array, "marker corner=4 xyz=3"]:
    """The corners of the board's markers in metres, clockwise from the top left; none on a plain chessboard."""
    if board.kind == "four_markers":
        origins = _four_origins(board)
    elif board.kind == "aruco_grid":
        origins = _grid_origins(board)
    elif board.kind == "charuco":
        origins = _charuco_origins(board)
    else:
        return np.empty((0, 4, 3))
    side = board.marker_m or 0.0
    return origins[:, None] + side * np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


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


def _inner_corners(board: Board) -> Float64[Array, "corner xyz=3"]:
    columns, rows = (board.squares_x or 0) - 1, (board.squares_y or 0) - 1
    corners: Float64[Array, "corner xyz=3"] = np.array([*board.square_size_m, 0.0]) * (_lattice(columns, rows) + _FIRST)
    return corners


def _circle_centers(board: Board) -> Float64[Array, "corner xyz=3"]:
    """OpenCV's asymmetric grid: odd rows shifted by one spacing, circles of a row two spacings apart."""
    lattice = _lattice(board.squares_x or 0, board.squares_y or 0)
    lattice[:, 0] = 2 * lattice[:, 0] + lattice[:, 1] % 2
    centers: Float64[Array, "corner xyz=3"] = (board.spacing_m or 0.0) * (lattice + _FIRST)
    return centers


def _four_origins(board: Board) -> Float64[Array, "marker xyz=3"]:
    """Marker 0 top-left, 1 top-right, 2 bottom-right, 3 bottom-left, each `margin_m` inside the outline."""
    near = board.margin_m or 0.0
    right = (board.width_m or 0.0) - near - (board.marker_m or 0.0)
    below = (board.height_m or 0.0) - near - (board.marker_m or 0.0)
    return np.array([[near, near, 0.0], [right, near, 0.0], [right, below, 0.0], [near, below, 0.0]])


def _grid_origins(board: Board) -> Float64[Array, "marker xyz=3"]:
    pitch = (board.marker_m or 0.0) + (board.gap_m or 0.0)
    return pitch * _lattice(board.squares_x or 0, board.squares_y or 0)


def _charuco_origins(board: Board) -> Float64[Array, "marker xyz=3"]:
    """One marker in the middle of each white square, row by row."""
    lattice = _lattice(board.squares_x or 0, board.squares_y or 0)
    lattice = lattice[[is_white(int(x), int(y), board) for x, y, _ in lattice]]
    square, marker = board.square_m or 0.0, board.marker_m or 0.0
    return square * lattice + [(square - marker) / 2, (square - marker) / 2, 0.0]


def is_white(column: int, row: int, board: Board) -> bool:
    """Whether a square is white: the top-left one is black, on a legacy ChArUco board of even rows white."""
    legacy_white = board.kind == "charuco" and board.legacy_pattern and (board.squares_y or 0) % 2 == 0
    return (column + row) % 2 == (0 if legacy_white else 1)


def _lattice(columns: int, rows: int) -> Float64[Array, "point xyz=3"]:
    row, column = np.mgrid[0:rows, 0:columns]
    return np.stack([column.ravel(), row.ravel(), np.zeros(row.size)], axis=1).astype(np.float64)
