"""What an image shows of a calibration board, or why it shows none."""

from dataclasses import dataclass
from enum import Enum

import cv2
import numpy as np

from ringpose.calibrate.board_points import corner_points, marker_corners
from ringpose.calibrate.chessboard import chessboard_corners, refined_corners
from ringpose.calibrate.marker_sides import corners_from_sides
from ringpose.calibrate.markers import Markers, find_markers, marker_dictionary
from ringpose.types.arrays import Array, Float64, Int64, UInt, UInt8
from ringpose.types.board import Board, BoardView

MINIMUM_CORNERS = 6
"""A view with fewer corners says too little: four fix a pose, and six leave something to judge it by."""

DARK_DN = 25.0
"""Share of the 8-bit range that the brightest hundredth of an image must reach for a board to be visible at all."""

BRIGHT_SHARE = 0.5
"""Share of saturated pixels above which the image is called overexposed."""

BLURRED_DN = 1.5
"""Root mean square of the Laplacian below which an image is called blurred."""


WHITE_PER_GAP = 0.9
"""Half-window on a ChArUco board, in widths of the white rim around its markers: a window that reaches a marker
is five times worse (0.02 -> 0.1 px)."""


class BoardFailure(Enum):
    """Why no board was found; the value is the sentence the user reads."""

    TOO_DARK = "too dark"
    SATURATED = "overexposed"
    FEW_MARKERS = "too few of the board's markers found"
    OTHER_MARKERS = "markers found, but not those of this board; is it the right board file"
    FEW_CORNERS = "too few of the board's corners found"
    NOT_WHOLE = "the pattern is not found; all of it must be in the image, and its size must be that of the board file"
    BLURRED = "blurred: the pattern is not found"


@dataclass(frozen=True, slots=True, kw_only=True)
class NoBoard:
    """An image without a usable board."""

    failure: BoardFailure
    found: str = ""
    """What was found instead, with its number."""

    @property
    def value(self) -> str:
        """The sentence the user reads."""
        return f"{self.failure.value} ({self.found})" if self.found else self.failure.value


def find_board(image: UInt[Array, "row column"], board: Board, name: str) -> BoardView | NoBoard:
    """The corners of the board that the image shows, in pixels and in the board frame, or the reason for none."""
    grey = grey_8_bit(image)
    if board.kind in ("charuco", "four_markers", "aruco_grid"):
        seen = _marker_view(grey, board)
    else:
        seen = _pattern_view(grey, board)
    if isinstance(seen, NoBoard):
        return _unusable(grey) or seen
    ids, points_px = seen
    return BoardView(name=name, ids=ids, points_board_m=corner_points(board)[ids], points_px=points_px)


def grey_8_bit(image: UInt[Array, "row column"]) -> UInt8[Array, "row column"]:
    """The image as OpenCV's detectors want it: deeper images are scaled so that their brightest pixel is white."""
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image)
    scale = 255.0 / max(int(image.max(initial=0)), 1)
    return np.rint(image * scale).astype(np.uint8)


_Corners = tuple[Int64[Array, "corner"], Float64[Array, "corner xy=2"]]


def _unusable(grey: UInt8[Array, "row column"]) -> NoBoard | None:
    """What is wrong with an image in which nothing could be found, whatever the board."""
    bright = float(np.percentile(grey, 99))
    if bright < DARK_DN:
        return NoBoard(failure=BoardFailure.TOO_DARK, found=f"99 % of the pixels are below {bright:.0f} of 255")
    full = float(np.mean(grey == 255))
    if full > BRIGHT_SHARE:
        return NoBoard(failure=BoardFailure.SATURATED, found=f"{100 * full:.0f} % of the pixels are saturated")
    return None


def _pattern_view(grey: UInt8[Array, "row column"], board: Board) -> _Corners | NoBoard:
    """A chessboard or a grid of circles: found whole or not at all."""
    columns, rows = board.squares_x or 0, board.squares_y or 0
    if board.kind == "chessboard":
        corners = chessboard_corners(grey, columns - 1, rows - 1)
    else:
        corners = _circle_centers(grey, columns, rows)
    if corners is None:
        sharpness = float(np.sqrt(np.mean(np.asarray(cv2.Laplacian(grey, cv2.CV_64F)) ** 2)))
        if sharpness < BLURRED_DN:
            return NoBoard(failure=BoardFailure.BLURRED, found=f"rms of the Laplacian {sharpness:.2f}")
        return NoBoard(failure=BoardFailure.NOT_WHOLE)
    return np.arange(len(corners), dtype=np.int64), corners


def _circle_centers(grey: UInt8[Array, "row column"], columns: int, rows: int) -> Float64[Array, "corner xy=2"] | None:
    flags = cv2.CALIB_CB_ASYMMETRIC_GRID | cv2.CALIB_CB_CLUSTERING
    found, centers = cv2.findCirclesGrid(grey, (columns, rows), flags=flags)
    return np.asarray(centers, dtype=np.float64).reshape(-1, 2) if found else None


def _marker_view(grey: UInt8[Array, "row column"], board: Board) -> _Corners | NoBoard:
    """A board with markers: part of it is enough."""
    all_markers = len(marker_corners(board))
    if board.kind == "charuco":
        seen, found = _charuco_corners(grey, board)
    else:
        seen, found = _marker_corners(grey, board)
    ids = seen[0]
    if len(ids) >= MINIMUM_CORNERS:
        return seen
    if not found:
        return _no_markers(grey, board)
    if board.kind == "charuco":
        return NoBoard(failure=BoardFailure.FEW_CORNERS, found=f"{len(ids)} corners, {found} of {all_markers} markers")
    return NoBoard(failure=BoardFailure.FEW_MARKERS, found=f"{found} of {all_markers}")


def _marker_corners(grey: UInt8[Array, "row column"], board: Board) -> tuple[_Corners, int]:
    """Corners of the board's own markers, and how many markers there are."""
    markers = find_markers(grey, marker_dictionary(board))
    own = (markers.ids < len(marker_corners(board))) & _single(markers)
    ids = (4 * markers.ids[own, None] + np.arange(4)).ravel()
    corners = [corners_from_sides(grey, corners) for corners in markers.corners_px[own]]
    return (ids, np.reshape(corners, (-1, 2)).astype(np.float64)), int(own.sum())


def _single(markers: Markers) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Markers whose number occurs once: of two with one number, nobody knows which is the board's."""
    _, position, count = np.unique(markers.ids, return_inverse=True, return_counts=True)
    single: np.ndarray[tuple[int], np.dtype[np.bool_]] = count[position] == 1
    return single


def _charuco_corners(grey: UInt8[Array, "row column"], board: Board) -> tuple[_Corners, int]:
    """Chessboard corners between the board's markers, refined, and how many markers there are."""
    size = (board.squares_x or 0, board.squares_y or 0)
    pattern = cv2.aruco.CharucoBoard(size, board.square_m or 0.0, board.marker_m or 0.0, marker_dictionary(board))
    pattern.setLegacyPattern(board.legacy_pattern)
    corners, ids, _, marker_ids = cv2.aruco.CharucoDetector(pattern).detectBoard(grey)
    found = 0 if marker_ids is None else len(marker_ids)
    if ids is None or not len(ids):
        return (np.empty(0, dtype=np.int64), np.empty((0, 2))), found
    numbers = np.asarray(ids).ravel().astype(np.int64)
    positions = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    share = WHITE_PER_GAP * ((board.square_m or 1.0) - (board.marker_m or 0.0)) / (2 * (board.square_m or 1.0))
    half_window_px = share * _square_px(numbers, positions, size[0] - 1)
    return (numbers, refined_corners(grey, positions, half_window_px)), found


def _square_px(ids: Int64[Array, "n"], positions: Float64[Array, "n xy=2"], columns: int) -> float:
    """Shortest distance of neighbouring corners, in pixels."""
    place = np.stack([ids % columns, ids // columns], axis=-1)
    neighbours = np.abs(place[:, None] - place).sum(axis=-1) == 1
    if not neighbours.any():
        return 0.0
    return float(np.linalg.norm(positions[:, None] - positions, axis=-1)[neighbours].min())


def _no_markers(grey: UInt8[Array, "row column"], board: Board) -> NoBoard:
    """Why none of the board's markers is seen: none at all, or those of another board."""
    others = find_markers(grey, marker_dictionary(board)).ids
    if len(others):
        numbers = ", ".join(str(number) for number in others[:6])
        return NoBoard(failure=BoardFailure.OTHER_MARKERS, found=f"numbers {numbers}")
    return NoBoard(failure=BoardFailure.FEW_MARKERS, found=f"0 of {len(marker_corners(board))}")
