"""Why an image shows no usable board, in words and numbers."""

from dataclasses import dataclass, field
from enum import Enum

import cv2
import numpy as np

from ringpose.calibrate.board_points import marker_corners
from ringpose.calibrate.chessboard import largest_grid
from ringpose.calibrate.chessboard_extent import Extent, chessboard_extent
from ringpose.calibrate.markers import Markers, find_markers, marker_dictionary
from ringpose.types.arrays import Array, Float64, UInt8
from ringpose.types.board import Board

SMALLEST_PX = 32
"""Sides of an image in which no board is looked for; OpenCV's finder fails below 15."""

DARK_DN = 25.0
"""Share of the 8-bit range that the brightest hundredth of an image must reach for a board to be visible at all."""

BRIGHT_SHARE = 0.5
"""Share of saturated pixels above which the image is called overexposed."""

BLURRED_PX = 4.0
"""Standard deviation of the steepest edges above which an image is called blurred: sharp photographs have 0.8 to 2."""

SHARP_PX, BLURRED_CELLS = 2.0, 1 / 3
"""Markers whose edges are wider than the first, and than this share of their cells, are too blurred to be read."""

_FAMILIES = tuple(
    (name, int(getattr(cv2.aruco, name)))
    for name in ("DICT_4X4_250", "DICT_5X5_250", "DICT_6X6_250", "DICT_7X7_250", "DICT_APRILTAG_36h11")
)
_FEWEST_MARKERS = 3
"""Of a family that nobody asked for, or of mirrored ones: a pattern, or blur, may pass for one or two."""

_SMOOTHING_PX = 1.0
_STEEPEST = 99.9
_DARK_TO_BRIGHT = (2, 98)


class BoardFailure(Enum):
    """Why no board was found; the value is the sentence the user reads."""

    TOO_SMALL = "the image is too small"
    TOO_DARK = "too dark"
    SATURATED = "overexposed"
    FEW_MARKERS = "too few of the board's markers found"
    OTHER_MARKERS = "markers found, but not those of this board; is it the right board file"
    MIRRORED = "the image is mirrored: its mirror image shows the board's markers; turn the camera's flip off"
    OTHER_LAYOUT = "the markers do not lie as on the board of the board file"
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


def too_small(grey: UInt8[Array, "row column"]) -> NoBoard | None:
    """Said of an image in which no board has room."""
    if min(grey.shape) >= SMALLEST_PX:
        return None
    return NoBoard(failure=BoardFailure.TOO_SMALL, found=f"{grey.shape[1]} x {grey.shape[0]} pixels")


def unusable(grey: UInt8[Array, "row column"], seen: NoBoard) -> NoBoard | None:
    """What is wrong with an image, whatever the board.

    A part of the board that is seen in an overexposed one says why the rest is not.
    """
    bright = float(np.percentile(grey, 99))
    if bright < DARK_DN:
        return NoBoard(failure=BoardFailure.TOO_DARK, found=f"99 % of the pixels are at most {bright:.0f} of 255")
    full = float(np.mean(grey == 255))
    if full > BRIGHT_SHARE and not len(seen.points_px):
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
    """Why a chessboard, which must be seen whole, is not found."""
    width_px = edge_width_px(grey)
    grid = largest_grid(grey)
    if grid is not None:
        return _partial(grey, grid, board, width_px)
    other = markers_of_others(grey)
    if other:
        return NoBoard(failure=BoardFailure.OTHER_MARKERS, found=other)
    failure = BoardFailure.BLURRED if BLURRED_PX < width_px < np.inf else BoardFailure.NOT_WHOLE
    return NoBoard(failure=failure, found=edge_width_in_words(width_px))


def edge_width_in_words(width_px: float) -> str:
    """What was measured of the edges."""
    return f"edges are {width_px:.1f} px wide" if np.isfinite(width_px) else "nothing has contrast"


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
        return NoBoard(failure=BoardFailure.OTHER_MARKERS, found=f"numbers {_numbers(markers)}")
    if len(find_markers(np.ascontiguousarray(grey[:, ::-1]), marker_dictionary(board)).ids) >= _FEWEST_MARKERS:
        return NoBoard(failure=BoardFailure.MIRRORED)
    other = markers_of_others(grey)
    if other:
        return NoBoard(failure=BoardFailure.OTHER_MARKERS, found=other)
    width_px = edge_width_px(grey)
    blurred = ""
    if width_px > BLURRED_PX:
        blurred = f", {edge_width_in_words(width_px)}" + ": blurred" * bool(np.isfinite(width_px))
    return NoBoard(failure=BoardFailure.FEW_MARKERS, found=f"0 of {wanted}{blurred}")


def charuco_failure(grey: UInt8[Array, "row column"], board: Board, corners: int, own: Markers) -> NoBoard:
    """Why too few corners are seen between a board's markers: their cells tell how wide edges may be."""
    points_px = own.corners_px.reshape(-1, 2)
    found = f"{corners} corners, {len(own.ids)} of {len(marker_corners(board))} markers"
    sides_px = np.linalg.norm(np.roll(own.corners_px, 1, axis=1) - own.corners_px, axis=-1)
    cell_px = float(np.median(sides_px)) / (marker_dictionary(board).markerSize + 2)
    width_px = float(np.median([edge_width_px(_around(grey, corners_px)) for corners_px in own.corners_px]))
    failure = BoardFailure.FEW_CORNERS
    if SHARP_PX < width_px < np.inf and width_px > BLURRED_CELLS * cell_px:
        failure = BoardFailure.BLURRED
        found = f"{edge_width_in_words(width_px)}, the markers' cells {cell_px:.1f} px; {found}"
    return NoBoard(failure=failure, found=found, points_px=points_px)


def _around(grey: UInt8[Array, "row column"], corners_px: Float64[Array, "corner=4 xy=2"]) -> UInt8[Array, "_ _"]:
    """The upright rectangle that holds a marker."""
    (left, top), (right, bottom) = np.floor(corners_px.min(axis=0)), np.ceil(corners_px.max(axis=0))
    return grey[max(int(top), 0) : int(bottom) + 1, max(int(left), 0) : int(right) + 1]


def _numbers(markers: Markers) -> str:
    return ", ".join(str(number) for number in markers.ids[:6])


def markers_of_others(grey: UInt8[Array, "row column"]) -> str:
    """The largest family of OpenCV's markers that an image shows, with numbers; empty if fewer than three are seen."""
    families = [(name, find_markers(grey, cv2.aruco.getPredefinedDictionary(number))) for name, number in _FAMILIES]
    name, markers = max(families, key=lambda family: len(family[1].ids))
    return f"{name}, numbers {_numbers(markers)}" if len(markers.ids) >= _FEWEST_MARKERS else ""


def _partial(
    grey: UInt8[Array, "row column"],
    grid: Float64[Array, "corner_row corner_column xy=2"],
    board: Board,
    width_px: float,
) -> NoBoard:
    """A part of a chessboard, or another one, was found."""
    extent = chessboard_extent(grey, grid)
    wanted = (board.squares_x or 0, board.squares_y or 0)
    rows, columns = sorted(grid.shape[:2])
    few, many = sorted(wanted)
    found = f"{columns} x {rows} of {many - 1} x {few - 1} inner corners, {edge_width_in_words(width_px)}"
    failure = _partial_failure(extent, wanted, blurred=bool(width_px > BLURRED_PX))
    if failure is BoardFailure.OTHER_SIZE:
        fewer, more = sorted(extent.squares)
        found += f"; it ends at {more} x {fewer} squares, squares_x and squares_y are {wanted[0]} and {wanted[1]}"
    return NoBoard(failure=failure, found=found, points_px=grid.reshape(-1, 2))


def _partial_failure(extent: Extent, wanted: tuple[int, int], *, blurred: bool) -> BoardFailure:
    """By the squares that are seen and those that the board has, along either side."""
    across, down = extent.squares
    missing = [
        (columns - across, rows - down)
        for columns, rows in (wanted, wanted[::-1])
        if columns >= across and rows >= down
    ]
    if not missing:
        return BoardFailure.OTHER_SIZE
    if any(_beyond_the_rim(side, extent) for side in missing):
        return BoardFailure.CUT_OFF
    if blurred:
        return BoardFailure.BLURRED
    return BoardFailure.OTHER_SIZE if extent.whole and all(any(side) for side in missing) else BoardFailure.COVERED


def _beyond_the_rim(missing: tuple[int, int], extent: Extent) -> bool:
    """Whether all squares that are missing may lie outside the image."""
    if not any(missing):
        return extent.pierced
    return all(cut or not squares for squares, cut in zip(missing, extent.cut, strict=True))


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
