"""Where a board's corners and markers are, in the board frame: origin top-left outer corner, x right, y down.

A chessboard's or ChArUco board's corner has the number that it has in OpenCV, row by row; a marker's corner
has the number 4 * marker + corner, clockwise from its top-left.

Whether a board's markers lie, and are as large, as the board file says.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from ringpose.calibrate.boards.markers import Markers
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import Board, BoardView
from ringpose.types.verdict import Check

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


MAX_MISFIT = 0.25
"""Of the markers' middles from their places, in markers' sides; 0.02 through a lens, above 1 on another board."""

MAX_SIZE_ERROR = 0.03
"""Of the markers' size by their distances: unrefined corners make them 0.01 too small."""

REDO_SIZE_ERROR = 0.1

CORNER_ERROR_PX = 1.0
"""By which a corner may lie inside its marker: unrefined ones of blurred markers 40 px wide make these 1.3 px too
narrow."""

_MIN_COUNT = 4

_MAX_SQUARES = 40


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkerLayout:
    """The markers as seen, in the board frame that their middles tell."""

    misfit: float
    """Median distance of a middle from where the board has it, in markers' sides."""
    size_ratio: tuple[float, float]
    """Median width and height of the markers over those of the board; 1 where that is no more than corners err."""


def marker_layout(board: Board, markers: Markers) -> MarkerLayout | None:
    """How the board's own markers lie; None if they are too few, or in one line."""
    place = marker_corners(board)[markers.ids][..., :2]
    middle = place.mean(axis=1)
    if len(middle) < _MIN_COUNT or np.linalg.matrix_rank(middle - middle.mean(axis=0), tol=1e-6) < 2:
        return None
    seen_px = _middles(markers.corners_px)
    homography: Any = cv2.findHomography(seen_px, middle)[0]
    if homography is None:
        return None
    found = cv2.perspectiveTransform(seen_px[None], homography)[0]
    corners = cv2.perspectiveTransform(markers.corners_px.reshape(1, -1, 2), homography).reshape(-1, 4, 2)
    side = board.marker_m or 1.0
    width = np.linalg.norm(corners[:, [1, 2]] - corners[:, [0, 3]], axis=-1) / side
    height = np.linalg.norm(corners[:, [3, 2]] - corners[:, [0, 1]], axis=-1) / side
    return MarkerLayout(
        misfit=float(np.median(np.linalg.norm(found - middle, axis=-1))) / side,
        size_ratio=(_told(width, markers), _told(height, markers)),
    )


def _told(ratios: Float64[Array, "marker side=2"], markers: Markers) -> float:
    """Their median, as far as it is beyond what the corners' own errors make of such small markers."""
    side_px = np.median(np.linalg.norm(np.diff(markers.corners_px, axis=1), axis=-1))
    ratio = float(np.median(ratios))
    return ratio if abs(ratio - 1) * side_px > 2 * CORNER_ERROR_PX else 1.0


def _middles(corners: Float64[Array, "marker corner=4 xy=2"]) -> Float64[Array, "marker xy=2"]:
    """Where the diagonals cross, which is the middle in any perspective."""
    along, across = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1]
    offset = corners[:, 1] - corners[:, 0]
    turn = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    share = (offset[:, 0] * across[:, 1] - offset[:, 1] * across[:, 0]) / turn
    middles: Float64[Array, "marker xy=2"] = corners[:, 0] + share[:, None] * along
    return middles


def other_layout(board: Board, markers: Markers) -> str | None:
    """What is to be said where the markers lie otherwise than on the board: the numbers of squares that would fit."""
    layout = marker_layout(board, markers)
    if layout is None or layout.misfit < MAX_MISFIT:
        return None
    for other in _others(board, int(markers.ids.max())):
        found = marker_layout(other, markers)
        if found is not None and found.misfit < MAX_MISFIT:
            legacy = f", legacy_pattern: {str(other.legacy_pattern).lower()}" * (other.kind == "charuco")
            return f"but as with squares_x: {other.squares_x}, squares_y: {other.squares_y}{legacy}"
    return "nor with any other squares_x"


def _others(board: Board, last: int) -> Iterator[Board]:
    """Boards whose markers are numbered otherwise: the same lying, then other numbers of squares in a row."""
    if not board.squares_x or not board.squares_y:
        return
    swapped = (board.squares_y, board.squares_x)
    counts = [(board.squares_x, board.squares_y), swapped, *((x, board.squares_y) for x in range(2, _MAX_SQUARES))]
    for squares_x, squares_y in counts:
        for legacy in (board.legacy_pattern, not board.legacy_pattern) if board.kind == "charuco" else (False,):
            other = replace(board, squares_x=squares_x, squares_y=squares_y, legacy_pattern=legacy)
            if last < len(marker_corners(other)):
                yield other


def marker_size_findings(views: Sequence[BoardView]) -> tuple[Check, ...]:
    """Whether the markers are as large as the board file says, beside their distances; nothing on other boards."""
    ratios = [view.marker_size_ratio for view in views if view.marker_size_ratio is not None]
    if not ratios:
        return ()
    width, height = np.median(ratios, axis=0).tolist()
    finding = Check(
        name="marker_size_error",
        value=max(abs(width - 1), abs(height - 1)),
        pass_limit=MAX_SIZE_ERROR,
        fail_limit=REDO_SIZE_ERROR,
        advice=f"by their distances the markers are {width:.2f} times as wide and {height:.2f} times as high as "
        "marker_m says: measure the print, a size in the board file is wrong",
    )
    return (finding,)
