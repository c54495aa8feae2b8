"""Diagnostics for images without a usable board: the reason as text, with the measured numbers."""

from dataclasses import dataclass, field, replace
from enum import Enum
from typing import Any

import cv2
import numpy as np

from ringpose.calibrate.boards.chessboard import largest_grid
from ringpose.calibrate.boards.circles import brightened, circle_middles
from ringpose.calibrate.boards.layout import corner_points, marker_corners
from ringpose.calibrate.boards.markers import Markers, find_markers, marker_dictionary
from ringpose.types.arrays import Array, Bool, Float64, UInt8
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
    """What was found instead, with numbers."""
    points_px: Float64[Array, "point xy=2"] = field(default_factory=lambda: np.empty((0, 2)), compare=False)
    """Corners that were found nevertheless."""

    @property
    def value(self) -> str:
        """The sentence the user reads."""
        return f"{self.failure.value} ({self.found})" if self.found else self.failure.value


def too_small(grey: UInt8[Array, "row column"]) -> NoBoard | None:
    """The failure of an image that is too small for any board."""
    if min(grey.shape) >= MIN_SIZE_PX:
        return None
    return NoBoard(failure=BoardFailure.TOO_SMALL, found=f"{grey.shape[1]} x {grey.shape[0]} pixels")


def unusable(grey: UInt8[Array, "row column"], seen: NoBoard) -> NoBoard | None:
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


def edge_width_px(grey: UInt8[Array, "row column"]) -> float:
    """Standard deviation of the steepest edges' blur: contrast over gradient, including the smoothing applied here.

    Infinite for an image without contrast.
    """
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _SMOOTHING_PX)
    slope = np.hypot(*(cv2.Sobel(smooth, cv2.CV_32F, dx, 1 - dx, scale=1 / 8) for dx in (1, 0)))
    steepest = float(np.percentile(slope, _STEEPEST))
    dark, bright = np.percentile(grey, _DARK_TO_BRIGHT)
    return float(bright - dark) / (np.sqrt(2 * np.pi) * steepest) if steepest > 0 else float("inf")


def pattern_failure(grey: UInt8[Array, "row column"], board: Board) -> NoBoard:
    """Why a chessboard, all of which must be visible, is not found."""
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
    """The measured width of the edges, as text."""
    return f"edges are {width_px:.1f} px wide" if np.isfinite(width_px) else "nothing has contrast"


def marker_failure(grey: UInt8[Array, "row column"], board: Board, markers: Markers, own: Markers) -> NoBoard:
    """Why too few markers of the board are found: blur, another board, a mirrored image, or a board cut off."""
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
    if len(find_markers(np.ascontiguousarray(grey[:, ::-1]), marker_dictionary(board)).ids) >= _MIN_MARKERS:
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
    """Why too few corners are found between a board's markers; blur is compared with the size of their cells."""
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
    """The marker's bounding box."""
    (left, top), (right, bottom) = np.floor(corners_px.min(axis=0)), np.ceil(corners_px.max(axis=0))
    return grey[max(int(top), 0) : int(bottom) + 1, max(int(left), 0) : int(right) + 1]


def _numbers(markers: Markers) -> str:
    return ", ".join(str(number) for number in markers.ids[:6])


def markers_of_others(grey: UInt8[Array, "row column"]) -> str:
    """The dictionary of OpenCV with the most markers in the image, and their numbers; empty for fewer than three."""
    families = [(name, find_markers(grey, cv2.aruco.getPredefinedDictionary(number))) for name, number in _FAMILIES]
    name, markers = max(families, key=lambda family: len(family[1].ids))
    return f"{name}, numbers {_numbers(markers)}" if len(markers.ids) >= _MIN_MARKERS else ""


def _partial(
    grey: UInt8[Array, "row column"],
    grid: Float64[Array, "corner_row corner_column xy=2"],
    board: Board,
    width_px: float,
) -> NoBoard:
    """The failure if part of a chessboard, or one of another size, was found."""
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


@dataclass(frozen=True, slots=True, kw_only=True)
class Extent:
    """Extent of a chessboard along the rows and the columns of the corners found."""

    squares: tuple[int, int]
    cut: tuple[bool, bool]
    """Whether the image ends before the board is seen to end."""
    pierced: bool
    """Whether the image's rim goes through the squares beside corners that are found."""
    whole: bool
    """Whether the corners of all these squares are found."""


def _partial_failure(extent: Extent, wanted: tuple[int, int], *, blurred: bool) -> BoardFailure:
    """The failure from the numbers of squares seen and expected, in either orientation of the board."""
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
    """Whether all missing squares may be outside the image."""
    if not any(missing):
        return extent.pierced
    return all(cut or not squares for squares, cut in zip(missing, extent.cut, strict=True))


def _outside(own: Markers, board: Board, shape: tuple[int, int]) -> int:
    """Number of the board's other markers that are outside the image, by the homography of the markers found."""
    corners_m = marker_corners(board)[..., :2]
    seen = corners_m[own.ids].reshape(-1, 2)
    homography, _ = cv2.findHomography(seen, own.corners_px.reshape(-1, 2))
    others = np.delete(corners_m, own.ids, axis=0)
    if homography is None or not len(others):
        return 0
    expected = cv2.perspectiveTransform(others.reshape(1, -1, 2), homography).reshape(-1, 4, 2)
    inside = (expected > 0) & (expected < np.array([shape[1] - 1, shape[0] - 1]))
    return int(np.sum(~inside.all(axis=(1, 2))))


MIN_GRID = 2
"""Minimum number of circles along a side of the grids that are tried."""

MAX_MISFIT = 0.2
"""Maximum rms misfit of a grid in spacings: distortion causes less, wrong rows are off by a half or more."""


def circle_failure(grey: UInt8[Array, "row column"], board: Board) -> NoBoard:
    """Why a grid of circles is not found, with the number of circles found."""
    middles_px, width_px = _circles_seen(grey), edge_width_px(grey)
    columns, rows = board.squares_x or 0, board.squares_y or 0
    found = f"{len(middles_px)} circles are seen, the board has {columns} x {rows} = {columns * rows}"
    found += f", {edge_width_in_words(width_px)}"
    failure = BoardFailure.NOT_WHOLE
    other = _other_grid(grey, board, len(middles_px))
    if other is not None:
        part = other[0] <= columns and other[1] <= rows
        failure = BoardFailure.NOT_WHOLE if part else BoardFailure.OTHER_SIZE
        found += f"; they lie as {other[0]} x {other[1]} would: squares_x and squares_y"
    elif len(middles_px) < columns * rows and BLURRED_PX < width_px < np.inf:
        failure = BoardFailure.BLURRED
    return NoBoard(failure=failure, found=found, points_px=middles_px)


def _circles_seen(grey: UInt8[Array, "row column"]) -> Float64[Array, "circle xy=2"]:
    """Centres of dark blobs, as detected by OpenCV's grid detection."""
    spots = cv2.SimpleBlobDetector.create().detect(brightened(grey))
    return np.array([spot.pt for spot in spots], dtype=np.float64).reshape(-1, 2)


def _other_grid(grey: UInt8[Array, "row column"], board: Board, number: int) -> tuple[int, int] | None:
    """Columns and rows of another grid with this number of circles that fits the image; None if there is none."""
    for columns in range(MIN_GRID, number // MIN_GRID + 1):
        rows, left = divmod(number, columns)
        if left or (columns, rows) == (board.squares_x, board.squares_y):
            continue
        middles_px = circle_middles(grey, columns, rows)
        if middles_px is not None and _fits_board(middles_px, replace(board, squares_x=columns, squares_y=rows)):
            return columns, rows
    return None


def _fits_board(middles_px: Float64[Array, "circle xy=2"], board: Board) -> bool:
    """Whether a homography maps the circles to those of the board."""
    places = corner_points(board)[:, :2]
    homography: Any = cv2.findHomography(middles_px, places)[0]
    if homography is None:
        return False
    mapped = cv2.perspectiveTransform(middles_px.reshape(1, -1, 2), homography).reshape(-1, 2)
    return bool(np.sqrt(np.mean(np.sum((mapped - places) ** 2, axis=1))) < MAX_MISFIT * (board.spacing_m or 1.0))


GOES_ON = 0.5
"""Median contrast of neighbouring squares, over that of the squares found, above which a row is the board's ..."""

SURELY = 0.8
"""... and how near to 1 it is where the board goes on behind something:"""

COVERED_ROWS = 2
"""so many rows may be covered."""

_MAX_ROWS = 20

_SMOOTHING = 0.15
"""Of a square's side."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Side:
    squares: int
    """Rows of squares beyond the last corners."""
    cut: bool
    """Whether the image ends before the board is seen to end ..."""
    pierced: bool
    """... in the first of them."""


def chessboard_extent(
    image: UInt8[Array, "row column"], grid: Float64[Array, "corner_row corner_column xy=2"]
) -> Extent:
    """The squares that the image shows along the lattice of the corners found, whether or not their corners are."""
    side_px = float(np.linalg.norm(np.diff(grid, axis=1), axis=-1).min())
    smooth = cv2.GaussianBlur(image, (0, 0), max(_SMOOTHING * side_px, 0.5)).astype(np.float64)
    down = grid.swapaxes(0, 1)
    sides = [_side(smooth, turned) for turned in (grid[:, ::-1], grid, down[:, ::-1], down)]
    rows, columns = grid.shape[:2]
    return Extent(
        squares=(columns - 1 + sides[0].squares + sides[1].squares, rows - 1 + sides[2].squares + sides[3].squares),
        cut=(sides[0].cut or sides[1].cut, sides[2].cut or sides[3].cut),
        pierced=any(side.pierced for side in sides),
        whole=all(side.squares == 1 for side in sides),
    )


def _side(smooth: Float64[Array, "row column"], grid: Float64[Array, "corner_row corner_column xy=2"]) -> _Side:
    """Extent of the board beyond the last column of corners."""
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
        if (step > GOES_ON and row == last + 1) or (SURELY < step < 1 / SURELY and row <= last + 1 + COVERED_ROWS):
            last = row
    return _Side(squares=last + 1, cut=inside <= last + 1, pierced=inside == 0)


def _contrast(
    smooth: Float64[Array, "row column"],
    homography: Float64[Array, "3 3"],
    column: int,
    rows: int,
) -> float:
    """Median difference of neighbouring squares of a column, with alternating sign."""
    across = np.arange(rows - 1)
    centres = np.stack([np.full(len(across), column + 0.5), across + 0.5], axis=-1)
    x, y = np.rint(cv2.perspectiveTransform(centres[None], homography)[0]).astype(np.int64).T
    grey = smooth[np.clip(y, 0, smooth.shape[0] - 1), np.clip(x, 0, smooth.shape[1] - 1)]
    return float(np.median((grey[:-1] - grey[1:]) * (-1.0) ** across[:-1]))


def _inside(shape: tuple[int, ...], homography: Float64[Array, "3 3"], column: int, rows: int) -> bool:
    """Whether the outer corners of a column of squares are in the image."""
    corners = np.stack([np.full(rows, column + 1.0), np.arange(rows, dtype=np.float64)], axis=-1)
    places = cv2.perspectiveTransform(corners[None], homography)[0]
    inside: Bool[Array, "n xy=2"] = (places > 0) & (places < np.array([shape[1] - 1, shape[0] - 1]))
    return bool(inside.all())
