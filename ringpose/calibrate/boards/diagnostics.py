"""Diagnostics for images without a usable board: the reason as text, with the measured numbers."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any, NamedTuple

import cv2
import numpy as np

from ringpose.calibrate.boards.chessboard import Grid, largest_grid
from ringpose.calibrate.boards.circles import brightened, opencv_ellipse_centers
from ringpose.calibrate.boards.image_patch import GreyImage
from ringpose.calibrate.boards.layout import corner_points, marker_corners
from ringpose.calibrate.boards.markers import Markers, find_markers, marker_dictionary
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import Board

MIN_SIZE_PX = 32
"""Minimum side of an image for board detection; OpenCV's detectors fail below 15."""

DARK_DN = 25.0
"""Minimum 99th percentile of an 8-bit image in which a board can be visible."""

BRIGHT_SHARE = 0.5
"""Share of saturated pixels above which an image is overexposed."""

BLURRED_PX = 4.0
"""Standard deviation of the steepest edges above which an image is blurred: sharp photographs have 0.8 to 2."""

SHARP_PX, BLURRED_CELLS = 2.0, 1 / 3
"""Markers are too blurred to be decoded if their edges are wider than the first, and than this share of a cell."""

_FAMILIES = tuple(
    (name, int(getattr(cv2.aruco, name)))
    for name in ("DICT_4X4_250", "DICT_5X5_250", "DICT_6X6_250", "DICT_7X7_250", "DICT_APRILTAG_36h11")
)

_MIN_MARKERS = 3
"""Minimum number of markers of another dictionary, or of mirrored ones: one or two may be false detections."""

MIN_GRID = 2
"""Minimum number of circles along a side of the grids that are tried."""

MAX_MISFIT = 0.2
"""Maximum rms misfit of a grid of circles in spacings: distortion causes less, wrong rows are off by a half or more."""

MIN_CONTINUATION = 0.5
"""Contrast of neighbouring squares beyond the corners found, over that of the squares found, above which they are
squares of the board."""

SURE_CONTINUATION = 0.8
"""The same for squares beyond rows without contrast; at most the reciprocal."""

MAX_COVERED_ROWS = 2
"""Number of rows without contrast, covered by an object, beyond which squares are still searched."""

_MAX_ROWS = 20
"""Number of rows of squares that are searched beyond the corners found."""

_SQUARE_SMOOTHING = 0.15
"""Standard deviation of the smoothing before that, in sides of a square."""

_SMOOTHING_PX = 1.0

_STEEPEST = 99.9
"""Percentile of the gradient that is taken as that of the steepest edges."""

_DARK_TO_BRIGHT = (2, 98)
"""Percentiles of the grey values whose difference is the contrast."""


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
    """What was found instead, with numbers."""
    points_px: Float64[Array, "point xy=2"] = field(default_factory=lambda: np.empty((0, 2)), compare=False)
    """Corners that were found nevertheless."""

    @property
    def value(self) -> str:
        """The reason as a sentence for the user, with what was found instead."""
        return f"{self.failure.value} ({self.found})" if self.found else self.failure.value


def too_small(grey: GreyImage) -> NoBoard | None:
    """The failure of an image that is too small for any board."""
    if min(grey.shape) >= MIN_SIZE_PX:
        return None
    return NoBoard(failure=BoardFailure.TOO_SMALL, found=f"{grey.shape[1]} x {grey.shape[0]} pixels")


def unusable(grey: GreyImage, seen: NoBoard) -> NoBoard | None:
    """The failure of an image that is too dark or overexposed for any board.

    If part of the board is found in an overexposed image, its own failure is more specific and is kept.
    """
    bright = float(np.percentile(grey, 99))
    if bright < DARK_DN:
        return NoBoard(failure=BoardFailure.TOO_DARK, found=f"99 % of the pixels are at most {bright:.0f} of 255")
    full = float(np.mean(grey == 255))
    if full > BRIGHT_SHARE and not len(seen.points_px):
        return NoBoard(failure=BoardFailure.SATURATED, found=f"{100 * full:.0f} % of the pixels are saturated")
    return None


def edge_width_px(grey: GreyImage) -> float:
    """Standard deviation of the blur of the image's steepest edges (contrast over gradient), smoothed by 1 px here.

    Infinite for an image without contrast.
    """
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _SMOOTHING_PX)
    slope = np.hypot(*(cv2.Sobel(smooth, cv2.CV_32F, dx, 1 - dx, scale=1 / 8) for dx in (1, 0)))
    steepest = float(np.percentile(slope, _STEEPEST))
    dark, bright = np.percentile(grey, _DARK_TO_BRIGHT)
    return float(bright - dark) / (np.sqrt(2 * np.pi) * steepest) if steepest > 0 else float("inf")


def edge_width_in_words(width_px: float) -> str:
    """The measured width of the edges, as text."""
    return f"edges are {width_px:.1f} px wide" if np.isfinite(width_px) else "nothing has contrast"


def pattern_failure(grey: GreyImage, board: Board) -> NoBoard:
    """Why a chessboard, all of which must be visible, is not found."""
    width_px = edge_width_px(grey)
    grid = largest_grid(grey)
    if grid is not None:
        return _partial_chessboard(grey, grid, board, width_px)
    other = _other_markers(grey)
    if other:
        return NoBoard(failure=BoardFailure.OTHER_MARKERS, found=other)
    failure = BoardFailure.BLURRED if BLURRED_PX < width_px < np.inf else BoardFailure.NOT_WHOLE
    return NoBoard(failure=failure, found=edge_width_in_words(width_px))


class _Side(NamedTuple):
    """Extent of a chessboard beyond the corners found, to one side."""

    squares: int
    """Number of rows of squares."""
    cut: bool
    """Whether the image ends before the board is seen to end."""
    pierced: bool
    """Whether it ends in the first of these rows."""


def _partial_chessboard(grey: GreyImage, grid: Grid, board: Board, width_px: float) -> NoBoard:
    """The failure if part of a chessboard, or one of another size, was found."""
    side_px = float(np.linalg.norm(np.diff(grid, axis=1), axis=-1).min())
    smooth = cv2.GaussianBlur(grey, (0, 0), max(_SQUARE_SMOOTHING * side_px, 0.5)).astype(np.float64)
    down = grid.swapaxes(0, 1)
    sides = [_side(smooth, turned) for turned in (grid[:, ::-1], grid, down[:, ::-1], down)]
    rows, columns = grid.shape[:2]
    squares = (columns - 1 + sides[0].squares + sides[1].squares, rows - 1 + sides[2].squares + sides[3].squares)
    wanted = (board.squares_x or 0, board.squares_y or 0)
    failure = _partial_failure(sides, squares, wanted, blurred=bool(width_px > BLURRED_PX))
    few, many = sorted(wanted)
    corners = f"{max(rows, columns)} x {min(rows, columns)} of {many - 1} x {few - 1} inner corners"
    found = f"{corners}, {edge_width_in_words(width_px)}"
    if failure is BoardFailure.OTHER_SIZE:
        found += f"; it ends at {max(squares)} x {min(squares)} squares, squares_x and squares_y are "
        found += f"{wanted[0]} and {wanted[1]}"
    return NoBoard(failure=failure, found=found, points_px=grid.reshape(-1, 2))


def _partial_failure(
    sides: Sequence[_Side], squares: tuple[int, int], wanted: tuple[int, int], *, blurred: bool
) -> BoardFailure:
    """The failure from the numbers of squares seen and expected, in either orientation of the board.

    `sides` are left, right, top and bottom of the grid of corners.
    """
    across, down = squares
    missing = [
        (columns - across, rows - down)
        for columns, rows in (wanted, wanted[::-1])
        if columns >= across and rows >= down
    ]
    if not missing:
        return BoardFailure.OTHER_SIZE
    pierced = any(side.pierced for side in sides)
    cut_across, cut_down = sides[0].cut or sides[1].cut, sides[2].cut or sides[3].cut
    for columns, rows in missing:  # may all missing squares be outside the image?
        outside = (cut_across or not columns) and (cut_down or not rows)
        if outside if columns or rows else pierced:
            return BoardFailure.CUT_OFF
    if blurred:
        return BoardFailure.BLURRED
    whole = all(side.squares == 1 for side in sides)
    return BoardFailure.OTHER_SIZE if whole and all(any(pair) for pair in missing) else BoardFailure.COVERED


def _side(smooth: Float64[Array, "row column"], grid: Grid) -> _Side:
    """Extent of the board beyond the last column of corners, along the lattice of the corners found."""
    rows, columns = grid.shape[:2]
    lattice = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2).astype(np.float64)
    homography = np.asarray(cv2.findHomography(lattice, grid.reshape(-1, 2))[0], dtype=np.float64)
    own = [_contrast(smooth, homography, column, rows) for column in range(columns - 1)]
    sign = np.sign(own[-1]) / max(float(np.median(np.abs(own))), 1.0)
    first = columns - 1
    outside = (row for row in range(_MAX_ROWS) if not _inside(smooth.shape, homography, first + row, rows))
    inside = next(outside, _MAX_ROWS)
    last = 0  # the last corners imply a first row of squares, even if it has no contrast
    for row in range(1, inside):
        step = sign * (-1) ** (row + 1) * _contrast(smooth, homography, first + row, rows)
        next_row = step > MIN_CONTINUATION and row == last + 1
        if next_row or (SURE_CONTINUATION < step < 1 / SURE_CONTINUATION and row <= last + 1 + MAX_COVERED_ROWS):
            last = row
    return _Side(squares=last + 1, cut=inside <= last + 1, pierced=inside == 0)


def _contrast(smooth: Float64[Array, "row column"], homography: Float64[Array, "3 3"], column: int, rows: int) -> float:
    """Median difference of neighbouring squares of a column, with alternating sign."""
    across = np.arange(rows - 1)
    centres = np.stack([np.full(len(across), column + 0.5), across + 0.5], axis=-1)
    x, y = np.rint(cv2.perspectiveTransform(centres[None], homography)[0]).astype(np.int64).T
    grey = smooth[np.clip(y, 0, smooth.shape[0] - 1), np.clip(x, 0, smooth.shape[1] - 1)]
    return float(np.median((grey[:-1] - grey[1:]) * (-1.0) ** across[:-1]))


def _inside(shape: tuple[int, ...], homography: Float64[Array, "3 3"], column: int, rows: int) -> bool:
    """Whether the outer corners of a column of squares are in the image."""
    corners = np.stack([np.full(rows, column + 1.0), np.arange(rows, dtype=np.float64)], axis=-1)
    corners_px = cv2.perspectiveTransform(corners[None], homography)[0]
    return bool(((corners_px > 0) & (corners_px < np.array([shape[1] - 1, shape[0] - 1]))).all())


def marker_failure(grey: GreyImage, board: Board, markers: Markers, own: Markers) -> NoBoard:
    """Why too few markers of the board are found: blur, another board, a mirrored image, or a board cut off."""
    wanted = len(marker_corners(board))
    if len(own.ids):
        outside = _outside(own, board, (grey.shape[0], grey.shape[1]))
        where = f", {outside} of the others are outside the image" if outside else ""
        found = f"{len(own.ids)} of {wanted}{where}"
        return NoBoard(failure=BoardFailure.FEW_MARKERS, found=found, points_px=own.corners_px.reshape(-1, 2))
    if len(markers.ids):
        return NoBoard(failure=BoardFailure.OTHER_MARKERS, found=_numbers(markers))
    if len(find_markers(np.ascontiguousarray(grey[:, ::-1]), marker_dictionary(board)).ids) >= _MIN_MARKERS:
        return NoBoard(failure=BoardFailure.MIRRORED)
    other = _other_markers(grey)
    if other:
        return NoBoard(failure=BoardFailure.OTHER_MARKERS, found=other)
    width_px = edge_width_px(grey)
    blurred = ""
    if width_px > BLURRED_PX:
        blurred = f", {edge_width_in_words(width_px)}" + ": blurred" * bool(np.isfinite(width_px))
    return NoBoard(failure=BoardFailure.FEW_MARKERS, found=f"0 of {wanted}{blurred}")


def _outside(own: Markers, board: Board, shape: tuple[int, int]) -> int:
    """Number of the board's other markers that are outside the image, by the homography of the markers found."""
    corners_m = marker_corners(board)[..., :2]
    homography, _ = cv2.findHomography(corners_m[own.ids].reshape(-1, 2), own.corners_px.reshape(-1, 2))
    others = np.delete(corners_m, own.ids, axis=0)
    if homography is None or not len(others):
        return 0
    expected = cv2.perspectiveTransform(others.reshape(1, -1, 2), homography).reshape(-1, 4, 2)
    inside = (expected > 0) & (expected < np.array([shape[1] - 1, shape[0] - 1]))
    return int(np.sum(~inside.all(axis=(1, 2))))


def _numbers(markers: Markers) -> str:
    return "numbers " + ", ".join(str(number) for number in markers.ids[:6])


def _other_markers(grey: GreyImage) -> str:
    """The dictionary of OpenCV with the most markers in the image, and their numbers; empty for fewer than three."""
    families = [(name, find_markers(grey, cv2.aruco.getPredefinedDictionary(number))) for name, number in _FAMILIES]
    name, markers = max(families, key=lambda family: len(family[1].ids))
    return f"{name}, {_numbers(markers)}" if len(markers.ids) >= _MIN_MARKERS else ""


def charuco_failure(grey: GreyImage, board: Board, corners: int, own: Markers) -> NoBoard:
    """Why too few corners are found between a board's markers; blur is compared with the size of their cells."""
    found = f"{corners} corners, {len(own.ids)} of {len(marker_corners(board))} markers"
    sides_px = np.linalg.norm(np.roll(own.corners_px, 1, axis=1) - own.corners_px, axis=-1)
    cell_px = float(np.median(sides_px)) / (marker_dictionary(board).markerSize + 2)
    boxes = zip(np.floor(own.corners_px.min(axis=1)), np.ceil(own.corners_px.max(axis=1)), strict=True)
    boxes_px = [(np.maximum(low, 0).astype(int), high.astype(int) + 1) for low, high in boxes]
    width_px = float(
        np.median([edge_width_px(grey[top:bottom, left:right]) for (left, top), (right, bottom) in boxes_px])
    )
    failure = BoardFailure.FEW_CORNERS
    if SHARP_PX < width_px < np.inf and width_px > BLURRED_CELLS * cell_px:
        failure = BoardFailure.BLURRED
        found = f"{edge_width_in_words(width_px)}, the markers' cells {cell_px:.1f} px; {found}"
    return NoBoard(failure=failure, found=found, points_px=own.corners_px.reshape(-1, 2))


def circle_failure(grey: GreyImage, board: Board) -> NoBoard:
    """Why a grid of circles is not found, with the number of circles found (OpenCV's dark blobs)."""
    blobs = cv2.SimpleBlobDetector.create().detect(brightened(grey))
    circles_px = np.array([blob.pt for blob in blobs], dtype=np.float64).reshape(-1, 2)
    width_px = edge_width_px(grey)
    columns, rows = board.squares_x or 0, board.squares_y or 0
    found = f"{len(circles_px)} circles are seen, the board has {columns} x {rows} = {columns * rows}"
    found += f", {edge_width_in_words(width_px)}"
    failure = BoardFailure.NOT_WHOLE
    other = _other_grid(grey, board, len(circles_px))
    if other is not None:
        part = other[0] <= columns and other[1] <= rows
        failure = BoardFailure.NOT_WHOLE if part else BoardFailure.OTHER_SIZE
        found += f"; they lie as {other[0]} x {other[1]} would: squares_x and squares_y"
    elif len(circles_px) < columns * rows and BLURRED_PX < width_px < np.inf:
        failure = BoardFailure.BLURRED
    return NoBoard(failure=failure, found=found, points_px=circles_px)


def _other_grid(grey: GreyImage, board: Board, number: int) -> tuple[int, int] | None:
    """Columns and rows of another grid with this number of circles that fits the image; None if there is none."""
    for columns in range(MIN_GRID, number // MIN_GRID + 1):
        rows, left = divmod(number, columns)
        if left or (columns, rows) == (board.squares_x, board.squares_y):
            continue
        ellipses_px = opencv_ellipse_centers(grey, columns, rows)
        centers_m = corner_points(replace(board, squares_x=columns, squares_y=rows))[:, :2]
        if ellipses_px is None:
            continue
        board_from_image: Any = cv2.findHomography(ellipses_px, centers_m)[0]
        if board_from_image is not None:
            mapped_m = cv2.perspectiveTransform(ellipses_px.reshape(1, -1, 2), board_from_image).reshape(-1, 2)
            rms_m = np.sqrt(np.mean(np.sum((mapped_m - centers_m) ** 2, axis=1)))
            if rms_m < MAX_MISFIT * (board.spacing_m or 1.0):
                return columns, rows
    return None
