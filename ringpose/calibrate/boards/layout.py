"""Markers of a board, positions of its corners in the board frame, and checks of the markers seen against them.

The board frame has its origin in the top-left outer corner, x to the right and y down. Corners of a chessboard or
ChArUco board are numbered as in OpenCV, row by row; a marker's corner has the number 4 * marker + corner, clockwise
from the marker's top left.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import cv2
import numpy as np

from ringpose.calibrate.acceptance import BOARD_LIMITS, check
from ringpose.calibrate.boards.patterns.markers import Markers
from ringpose.errors import DataError
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import Board, BoardView
from ringpose.types.calibration import Check

MAX_CENTER_ERROR = 0.25
"""Maximum median distance of the markers' centres from the board's, in sides of a marker: 0.02 with distortion, above 1
for another board."""

CORNER_ERROR_PX = 1.0
"""Bound of the inward bias of unrefined corners: blurred markers 40 px wide become 1.3 px too narrow."""

_FIRST = np.array([1.0, 1.0, 0.0])
"""Position of the first corner or circle, in squares or spacings."""

_MIN_MARKERS = 4
"""Minimum number of markers with which the layout is checked."""

_MAX_SQUARES = 40
"""Largest number of columns that is tried when the markers do not fit the board file."""


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
    found, needed = len(dictionary.bytesList), marker_count(board)
    if found < needed:
        finding = f'dictionary "{board.dictionary}" has {found} markers, the board has {needed}'
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


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkerLayout:
    """Agreement of the detected markers with the board, in the board frame fitted to their centres."""

    center_error: float
    """Median distance of a marker's centre from its position on the board, in sides of a marker."""
    size_ratio: tuple[float, float]
    """Median width and height of the markers over those of the board; 1 if the deviation is not significant."""


def marker_layout(board: Board, markers: Markers) -> MarkerLayout | None:
    """Agreement of the board's own markers with the board; None if they are too few or collinear."""
    center_m = marker_corners(board)[markers.ids][..., :2].mean(axis=1)
    if len(center_m) < _MIN_MARKERS or np.linalg.matrix_rank(center_m - center_m.mean(axis=0), tol=1e-6) < 2:
        return None
    # Intersections of the markers' diagonals: projections of their centres in any perspective.
    corners = markers.corners_px
    along, across, offset = corners[:, 2] - corners[:, 0], corners[:, 3] - corners[:, 1], corners[:, 1] - corners[:, 0]
    determinant = along[:, 0] * across[:, 1] - along[:, 1] * across[:, 0]
    share = (offset[:, 0] * across[:, 1] - offset[:, 1] * across[:, 0]) / determinant
    centers_px = corners[:, 0] + share[:, None] * along
    board_from_image: Any = cv2.findHomography(centers_px, center_m)[0]
    if board_from_image is None:
        return None
    found_m = cv2.perspectiveTransform(centers_px[None], board_from_image)[0]
    corners_m = cv2.perspectiveTransform(corners.reshape(1, -1, 2), board_from_image).reshape(-1, 4, 2)
    side_m, side_px = board.marker_m or 1.0, np.median(np.linalg.norm(np.diff(corners, axis=1), axis=-1))
    ratios = []
    for start, end in (([0, 3], [1, 2]), ([0, 1], [3, 2])):  # horizontal sides, vertical sides
        ratio = float(np.median(np.linalg.norm(corners_m[:, end] - corners_m[:, start], axis=-1) / side_m))
        # For markers of this size, the bias of the corners can explain smaller deviations.
        ratios.append(ratio if abs(ratio - 1) * side_px > 2 * CORNER_ERROR_PX else 1.0)
    center_error = float(np.median(np.linalg.norm(found_m - center_m, axis=-1))) / side_m
    return MarkerLayout(center_error=center_error, size_ratio=(ratios[0], ratios[1]))


def other_layout(board: Board, markers: Markers) -> str | None:
    """If the markers do not lie as on the board: the numbers of squares that would fit, as text; else None."""
    layout = marker_layout(board, markers)
    if layout is None or layout.center_error < MAX_CENTER_ERROR:
        return None
    for other in _other_boards(board, int(markers.ids.max())):
        found = marker_layout(other, markers)
        if found is not None and found.center_error < MAX_CENTER_ERROR:
            legacy = f", legacy_pattern: {str(other.legacy_pattern).lower()}" * (other.kind == "charuco")
            return f"but as with squares_x: {other.squares_x}, squares_y: {other.squares_y}{legacy}"
    return "nor with any other squares_x"


def _other_boards(board: Board, last: int) -> Iterator[Board]:
    """Boards that have a marker with the number `last`, for comparison with an image that does not fit the board file.

    First the board itself, then with rows and columns exchanged, then with other numbers of columns; a ChArUco board
    in both of OpenCV's patterns.
    """
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
    """Check of the markers' size relative to their spacing; empty for boards without markers."""
    ratios = [view.marker_size_ratio for view in views if view.marker_size_ratio is not None]
    if not ratios:
        return ()
    width, height = np.median(ratios, axis=0).tolist()
    advice = (
        f"relative to their spacing the markers are {width:.2f} times as wide and {height:.2f} times as high as "
        "marker_m: measure the print, a size in the board file is wrong"
    )
    return (check(BOARD_LIMITS, "marker_size_error", max(abs(width - 1), abs(height - 1)), advice),)
