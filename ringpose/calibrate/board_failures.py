"""Why an image shows no usable board, in words and numbers."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import Enum

import cv2
import numpy as np

from ringpose.calibrate.board_points import marker_corners
from ringpose.calibrate.chessboard import largest_grid
from ringpose.calibrate.markers import Markers
from ringpose.types.arrays import Array, Float64, UInt8
from ringpose.types.board import Board

DARK_DN = 25.0
"""Share of the 8-bit range that the brightest hundredth of an image must reach for a board to be visible at all."""

BRIGHT_SHARE = 0.5
"""Share of saturated pixels above which the image is called overexposed."""

BLURRED_PX = 4.0
"""Standard deviation of the steepest edges above which an image is called blurred: sharp photographs have 0.8 to 2."""

BEYOND = 1.9
"""Squares from the last corner that is found to the end of what the next one would need to be found."""

_MOST_ROWS = 20
_SMOOTHING_PX = 1.0
_STEEPEST = 99.9
_DARK_TO_BRIGHT = (2, 98)


class BoardFailure(Enum):
    """Why no board was found; the value is the sentence the user reads."""

    TOO_DARK = "too dark"
    SATURATED = "overexposed"
    FEW_MARKERS = "too few of the board's markers found"
    OTHER_MARKERS = "markers found, but not those of this board; is it the right board file"
    FEW_CORNERS = "too few of the board's corners found"
    CUT_OFF = "the board is cut off by the image's rim"
    COVERED = "part of the pattern is covered or glares"
    OTHER_SIZE = "a pattern of another size than that of the board file"
    NOT_WHOLE = "the pattern is not found; all of it must be in the image, and its size must be that of the board file"
    BLURRED = "blurred"


@dataclass(frozen=True, slots=True, kw_only=True)
class NoBoard:
    """An image without a usable board."""

    failure: BoardFailure
    found: str = ""
    """What was found instead, with its number."""
    points_px: Float64[Array, "point xy=2"] = field(default_factory=lambda: np.empty((0, 2)), compare=False)
    """Corners that were found all the same."""

    @property
    def value(self) -> str:
        """The sentence the user reads."""
        return f"{self.failure.value} ({self.found})" if self.found else self.failure.value


def unusable(grey: UInt8[Array, "row column"]) -> NoBoard | None:
    """What is wrong with an image in which nothing could be found, whatever the board."""
    bright = float(np.percentile(grey, 99))
    if bright < DARK_DN:
        return NoBoard(failure=BoardFailure.TOO_DARK, found=f"99 % of the pixels are below {bright:.0f} of 255")
    full = float(np.mean(grey == 255))
    if full > BRIGHT_SHARE:
        return NoBoard(failure=BoardFailure.SATURATED, found=f"{100 * full:.0f} % of the pixels are saturated")
    return None


def edge_width_px(grey: UInt8[Array, "row column"]) -> float:
    """Standard deviation of the steepest edges' blur: contrast over slope, the measurement's own smoothing included.

    Infinite for an image without contrast.
    """
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _SMOOTHING_PX)
    slope = np.hypot(*(cv2.Sobel(smooth, cv2.CV_32F, dx, 1 - dx, scale=1 / 8) for dx in (1, 0)))
    steepest = float(np.percentile(slope, _STEEPEST))
    dark, bright = np.percentile(grey, _DARK_TO_BRIGHT)
    return float(bright - dark) / (np.sqrt(2 * np.pi) * steepest) if steepest > 0 else float("inf")


def pattern_failure(grey: UInt8[Array, "row column"], board: Board) -> NoBoard:
    """Why a pattern that must be seen whole is not found."""
    width_px = edge_width_px(grey)
    grid = largest_grid(grey) if board.kind == "chessboard" else None
    if grid is not None:
        return _partial(grid, board, grey.shape, width_px)
    failure = BoardFailure.BLURRED if width_px > BLURRED_PX else BoardFailure.NOT_WHOLE
    return NoBoard(failure=failure, found=_measured(width_px))


def _measured(width_px: float) -> str:
    return f"edges are {width_px:.1f} px wide"


def marker_failure(grey: UInt8[Array, "row column"], board: Board, markers: Markers, own: Markers) -> NoBoard:
    """Why too few markers of the board are seen: too blurred, those of another board, or the rest out of the image."""
    wanted = len(marker_corners(board))
    points_px = own.corners_px.reshape(-1, 2)
    if len(own.ids):
        outside = _outside(own, board, (grey.shape[0], grey.shape[1]))
        where = f", {outside} of the others are outside the image" if outside else ""
        return NoBoard(
            failure=BoardFailure.FEW_MARKERS, found=f"{len(own.ids)} of {wanted}{where}", points_px=points_px
        )
    if len(markers.ids):
        numbers = ", ".join(str(number) for number in markers.ids[:6])
        return NoBoard(failure=BoardFailure.OTHER_MARKERS, found=f"numbers {numbers}")
    width_px = edge_width_px(grey)
    blurred = f", edges are {width_px:.1f} px wide: blurred" if width_px > BLURRED_PX else ""
    return NoBoard(failure=BoardFailure.FEW_MARKERS, found=f"0 of {wanted}{blurred}")


def _partial(
    grid: Float64[Array, "corner_row corner_column xy=2"], board: Board, shape: tuple[int, ...], width_px: float
) -> NoBoard:
    """A part of a chessboard, or another one, was found."""
    rows, columns = sorted(grid.shape[:2])
    wanted = sorted(((board.squares_x or 0) - 1, (board.squares_y or 0) - 1))
    found = f"{columns} x {rows} of {wanted[1]} x {wanted[0]} inner corners, {_measured(width_px)}"
    size = np.array([shape[1], shape[0]], dtype=np.float64)
    if rows > wanted[0] or columns > wanted[1]:
        failure = BoardFailure.OTHER_SIZE
    elif not any(_fits(grid, missing, size) for missing in (wanted, wanted[::-1])):
        failure = BoardFailure.CUT_OFF
    else:
        failure = BoardFailure.BLURRED if width_px > BLURRED_PX else BoardFailure.COVERED
    return NoBoard(failure=failure, found=found, points_px=grid.reshape(-1, 2))


def _fits(
    grid: Float64[Array, "corner_row corner_column xy=2"], wanted: Sequence[int], size: Float64[Array, "xy=2"]
) -> bool:
    """Whether the image has room for what a grid of so many rows and columns has beyond the one found."""
    missing = [count - own for count, own in zip(wanted, grid.shape[:2], strict=True)]
    return all(0 <= less <= _room(side, size) for less, side in zip(missing, (grid, grid.swapaxes(0, 1)), strict=True))


def _room(grid: Float64[Array, "corner_row corner_column xy=2"], size: Float64[Array, "xy=2"]) -> int:
    """How many more rows of corners, with the squares beyond them, fit into the image before and after those found."""
    return sum(_rows_beyond(side[0], side[0] - side[1], size) for side in (grid, grid[::-1]))


def _rows_beyond(
    last: Float64[Array, "corner_column xy=2"],
    step: Float64[Array, "corner_column xy=2"],
    size: Float64[Array, "xy=2"],
) -> int:
    reached = last + (np.arange(_MOST_ROWS)[:, None, None] + BEYOND) * step
    inside = ((reached > 0) & (reached < size - 1)).all(axis=(1, 2))
    return int(np.argmin(inside)) if not inside.all() else _MOST_ROWS


def _outside(own: Markers, board: Board, shape: tuple[int, int]) -> int:
    """How many of the board's other markers would lie outside the image, by the homography of those seen."""
    place = marker_corners(board)[..., :2]
    seen = place[own.ids].reshape(-1, 2)
    homography, _ = cv2.findHomography(seen, own.corners_px.reshape(-1, 2))
    others = np.delete(place, own.ids, axis=0)
    if homography is None or not len(others):
        return 0
    expected = cv2.perspectiveTransform(others.reshape(1, -1, 2), homography).reshape(-1, 4, 2)
    inside = (expected > 0) & (expected < np.array([shape[1] - 1, shape[0] - 1]))
    return int(np.sum(~inside.all(axis=(1, 2))))
