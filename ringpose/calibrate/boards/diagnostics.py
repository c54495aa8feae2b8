"""Diagnostics for images without a usable board: the reason as text, with the measured numbers."""

import math
from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from enum import Enum

import cv2
import numpy as np

from ringpose.calibrate.boards.patterns.chessboard import Grid
from ringpose.calibrate.boards.patterns.circles import blob_detector, brightened, circle_centers, negative
from ringpose.calibrate.boards.patterns.image_patch import GreyImage, reduced
from ringpose.calibrate.boards.patterns.markers import (
    Markers,
    board_markers,
    find_markers,
    other_layout,
    rows_beyond,
)
from ringpose.geometry.board import LAYOUTS, corner_points, marker_corners, marker_dictionary
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import Board

MIN_SIZE_PX = 32
"""Minimum side of an image for board detection; OpenCV's detectors fail below 15."""

DARK_DN = 25.0
"""Minimum 99th percentile of an 8-bit image in which a board can be visible."""

BRIGHT_SHARE = 0.5
"""Share of saturated pixels above which an image is overexposed."""

CONTRAST_BLOCK_PX = 4
"""Side of the blocks whose mean grey values show whether an image has contrast beyond its noise."""

MIN_CONTRAST_SIGMAS = 12.0
"""Minimum range of these means in their standard deviations; noise alone has a range of 10 in 5 megapixels."""

MIN_CONTRAST_DN = 8.0
"""Minimum range of these means in an 8-bit image without noise."""

MAX_BLUR_PER_SQUARE = 0.7
"""Standard deviation of the blur, in squares, above which less than 1 % of a chessboard's contrast is left:
exp(-(pi sigma / square)^2), the attenuation of its fundamental frequency."""

BLURRED_PX = 4.0
"""Standard deviation of the steepest edges above which an image is blurred: sharp photographs have 0.8 to 2."""

SHARP_PX, BLURRED_CELLS = 2.0, 1 / 3
"""Markers are too blurred to be decoded if their edges are wider than the first, and than this share of a cell."""

_FAMILIES = tuple(
    (name, int(getattr(cv2.aruco, name)))
    for name in ("DICT_4X4_250", "DICT_5X5_250", "DICT_6X6_250", "DICT_7X7_250", "DICT_APRILTAG_36h11")
)

MAX_OTHER_PX = 1200
"""Longest side of the image in which markers of other dictionaries are searched; it is reduced to it."""

_MIN_MARKERS = 3
"""Minimum number of markers of another dictionary, or of mirrored ones: one or two may be false detections."""

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
    NO_CONTRAST = "nothing but noise is seen"
    FEW_MARKERS = "too few of the board's markers found"
    OTHER_MARKERS = "markers found, but not those of this board; is it the right board file"
    TWICE = "markers are seen twice, as of a second board or of a reflection; leave one of them in view"
    MIRRORED = (
        "the image or the print is mirrored: its mirror image shows the board; turn the camera's flip off, or print "
        "the board anew"
    )
    OTHER_LAYOUT = "the markers do not lie as on the board of the board file"
    FEW_CORNERS = "too few of the board's corners found"
    LARGER = "there are more columns or rows than the board file says"
    OTHER_SIZE = "a pattern of another size or kind than that of the board file"
    NOT_WHOLE = "the whole pattern is not found; it must be in the image, uncovered, and of the size in the board file"
    BLURRED = "blurred"
    GIVEN_UP = "the search is given up"


@dataclass(frozen=True, slots=True, kw_only=True)
class NoBoard:
    """An image without a usable board."""

    failure: BoardFailure
    finding: str = ""
    """What was found instead, with numbers."""
    points_px: Float64[Array, "point xy=2"] = field(default_factory=lambda: np.empty((0, 2)), compare=False)
    """Corners that were found nevertheless."""

    @property
    def value(self) -> str:
        """The reason as a sentence for the user, with what was found instead."""
        return f"{self.failure.value} ({self.finding})" if self.finding else self.failure.value


def hopeless(grey: GreyImage, board: Board) -> NoBoard | None:
    """The failure of an image that can show no board at all, found before any search in a few milliseconds.

    The image is too small, has no contrast beyond its noise, or its sharpest edge is too wide for the squares or
    circles of the board even if the board fills the image. Markers are found by their outlines: their blur is judged
    afterwards.
    """
    if min(grey.shape) < MIN_SIZE_PX:
        return NoBoard(failure=BoardFailure.TOO_SMALL, finding=f"{grey.shape[1]} x {grey.shape[0]} pixels")
    contrast, noise = _contrast_and_noise(grey)
    if contrast < max(MIN_CONTRAST_DN, MIN_CONTRAST_SIGMAS * noise):
        finding = f"blocks of {CONTRAST_BLOCK_PX} x {CONTRAST_BLOCK_PX} pixels differ by {contrast:.0f} of 255"
        return unusable(grey) or NoBoard(failure=BoardFailure.NO_CONTRAST, finding=finding)
    if LAYOUTS[board.kind].pattern not in ("chessboard", "circles", "squares"):
        return None
    long, short = sorted((board.squares_x or 1, board.squares_y or 1), reverse=True)
    square_px = min(max(grey.shape) / long, min(grey.shape) / short)
    width_px = edge_width_px(grey)
    if MAX_BLUR_PER_SQUARE * square_px < width_px < np.inf:
        return NoBoard(failure=BoardFailure.BLURRED, finding=edge_width_in_words(width_px))
    return None


def _contrast_and_noise(grey: GreyImage) -> tuple[float, float]:
    """Range of the mean grey values of blocks, and the standard deviation that noise alone gives them."""
    rows, columns = (size // CONTRAST_BLOCK_PX for size in grey.shape)
    whole = grey[: rows * CONTRAST_BLOCK_PX, : columns * CONTRAST_BLOCK_PX].astype(np.float32)
    mean, square = (
        cv2.resize(power, (columns, rows), interpolation=cv2.INTER_AREA) for power in (whole, whole * whole)
    )
    variance = float(np.median(np.maximum(square - mean * mean, 0.0)))
    return float(mean.max() - mean.min()), np.sqrt(variance) / CONTRAST_BLOCK_PX


def unusable(grey: GreyImage, seen: NoBoard | None = None) -> NoBoard | None:
    """The failure of an image that is too dark or overexposed.

    If part of the board is found in an overexposed image, its own failure is more specific and is kept.
    """
    count = np.cumsum(cv2.calcHist([grey], [0], None, [256], [0, 256]).ravel())
    bright = int(np.searchsorted(count, 0.99 * grey.size))
    if bright < DARK_DN:
        return NoBoard(failure=BoardFailure.TOO_DARK, finding=f"99 % of the pixels are at most {bright} of 255")
    full = 1.0 - float(count[254]) / grey.size
    if full > BRIGHT_SHARE and not (seen is not None and len(seen.points_px)):
        return NoBoard(failure=BoardFailure.SATURATED, finding=f"{100 * full:.0f} % of the pixels are saturated")
    return None


def edge_width_px(grey: GreyImage) -> float:
    """Standard deviation, in pixels, of the blur of the image's steepest edges: their contrast over their gradient.

    The image is smoothed by 1 px for the gradient; the result includes this blur. Infinite for an image without
    contrast.
    """
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _SMOOTHING_PX)
    slope = np.hypot(*(cv2.Sobel(smooth, cv2.CV_32F, dx, 1 - dx, scale=1 / 8) for dx in (1, 0)))
    steepest = float(np.percentile(slope, _STEEPEST))
    dark, bright = np.percentile(grey, _DARK_TO_BRIGHT)
    return float(bright - dark) / (np.sqrt(2 * np.pi) * steepest) if steepest > 0 else float("inf")


def edge_width_in_words(width_px: float) -> str:
    """The measured width of the edges, as text."""
    return f"edges are {width_px:.1f} px wide" if np.isfinite(width_px) else "nothing has contrast"


def pattern_failure(grey: GreyImage, board: Board, grid: Grid | None) -> NoBoard:
    """Why a chessboard, all of which must be visible, is not found; `grid` is the largest part that is seen."""
    width_px = edge_width_px(grey)
    if grid is not None:
        rows, columns = sorted(grid.shape[:2])
        few, many = sorted((board.squares_x or 0, board.squares_y or 0))
        finding = f"{columns} x {rows} of {many - 1} x {few - 1} inner corners, {edge_width_in_words(width_px)}"
        failure = BoardFailure.BLURRED if width_px > BLURRED_PX else BoardFailure.NOT_WHOLE
        if rows >= few or columns >= many:
            failure = BoardFailure.OTHER_SIZE
            if rows >= few - 1 and columns >= many - 1:
                failure = BoardFailure.LARGER
                finding = f"as with {columns + 1} x {rows + 1} squares: {finding}"
        return NoBoard(failure=failure, finding=finding, points_px=grid.reshape(-1, 2))
    other = _other_markers(grey)
    if other:
        return NoBoard(failure=BoardFailure.OTHER_MARKERS, finding=other)
    failure = BoardFailure.BLURRED if BLURRED_PX < width_px < np.inf else BoardFailure.NOT_WHOLE
    return NoBoard(failure=failure, finding=edge_width_in_words(width_px))


def marker_failure(grey: GreyImage, board: Board, markers: Markers, own: Markers) -> NoBoard:
    """Why too few markers of the board are found: blur, another board, a mirrored image, or a board cut off."""
    wanted = len(marker_corners(board))
    if _is_mirrored(grey, board, len(own.ids)):
        return NoBoard(failure=BoardFailure.MIRRORED)
    if len(own.ids):
        outside = _outside(own, board, (grey.shape[0], grey.shape[1]))
        where = f", {outside} of the others are outside the image" if outside else ""
        finding = f"{len(own.ids)} of {wanted}{where}"
        return NoBoard(failure=BoardFailure.FEW_MARKERS, finding=finding, points_px=own.corners_px.reshape(-1, 2))
    if len(np.unique(markers.ids)) < len(markers.ids):
        return NoBoard(
            failure=BoardFailure.TWICE, finding=_numbers(markers), points_px=markers.corners_px.reshape(-1, 2)
        )
    if len(markers.ids):
        return NoBoard(failure=BoardFailure.OTHER_MARKERS, finding=_numbers(markers))
    other = _other_markers(grey)
    if other:
        return NoBoard(failure=BoardFailure.OTHER_MARKERS, finding=other)
    width_px = edge_width_px(grey)
    blurred = ""
    if width_px > BLURRED_PX:
        blurred = f", {edge_width_in_words(width_px)}" + ": blurred" * bool(np.isfinite(width_px))
    return NoBoard(failure=BoardFailure.FEW_MARKERS, finding=f"0 of {wanted}{blurred}")


def layout_failure(grey: GreyImage, board: Board, markers: Markers, own: Markers) -> NoBoard | None:
    """The failure of an image whose markers do not lie as on the board, or also in further rows; else None."""
    points_px = own.corners_px.reshape(-1, 2)
    matching_layout = other_layout(board, own)
    if matching_layout is not None:
        if _is_mirrored(grey, board, len(own.ids)):
            return NoBoard(failure=BoardFailure.MIRRORED)
        return NoBoard(failure=BoardFailure.OTHER_LAYOUT, finding=matching_layout, points_px=points_px)
    rows = rows_beyond(board, own, markers)
    if rows is not None:
        finding = f"as with squares_x: {board.squares_x}, squares_y: {rows}"
        return NoBoard(failure=BoardFailure.LARGER, finding=finding, points_px=points_px)
    return None


def _is_mirrored(grey: GreyImage, board: Board, number: int) -> bool:
    """Whether the mirror image shows more of the board's markers than the `number` that the image itself shows.

    In a mirrored image a few markers pass for others of a large dictionary; those of the mirror image lie as on the
    board.
    """
    border_cells = LAYOUTS[board.kind].border_cells
    mirrored = find_markers(np.ascontiguousarray(grey[:, ::-1]), marker_dictionary(board), border_cells)
    own = board_markers(board, mirrored)
    return len(own.ids) >= _MIN_MARKERS and len(own.ids) > number and other_layout(board, own) is None


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
    small = reduced(grey, math.ceil(max(grey.shape) / MAX_OTHER_PX))
    families = [(name, find_markers(small, cv2.aruco.getPredefinedDictionary(number))) for name, number in _FAMILIES]
    name, markers = max(families, key=lambda family: len(family[1].ids))
    return f"{name}, {_numbers(markers)}" if len(markers.ids) >= _MIN_MARKERS else ""


def charuco_failure(grey: GreyImage, board: Board, corners: int, own: Markers) -> NoBoard:
    """Why too few corners are found between a board's markers; blur is compared with the size of their cells."""
    if _is_mirrored(grey, board, len(own.ids)):
        return NoBoard(failure=BoardFailure.MIRRORED)
    finding = f"{corners} corners, {len(own.ids)} of {len(marker_corners(board))} markers"
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
        finding = f"{edge_width_in_words(width_px)}, the markers' cells {cell_px:.1f} px; {finding}"
    return NoBoard(failure=failure, finding=finding, points_px=own.corners_px.reshape(-1, 2))


def square_failure(grey: GreyImage, board: Board, number: int, size: tuple[int, int]) -> NoBoard:
    """Why separate squares are not found; `number` of them are in the largest grid with the board's gaps, of `size`."""
    columns, rows, width_px = board.squares_x or 0, board.squares_y or 0, edge_width_px(grey)
    finding = f"{number} squares in a grid, the board has {columns} x {rows} = {columns * rows}"
    if all(np.sort(size) >= sorted((columns, rows))) and number > columns * rows:
        more_x, more_y = size if size[0] >= columns and size[1] >= rows else size[::-1]
        return NoBoard(failure=BoardFailure.LARGER, finding=f"as with squares_x: {more_x}, squares_y: {more_y}")
    finding += f", {edge_width_in_words(width_px)}"
    failure = BoardFailure.BLURRED if BLURRED_PX < width_px < np.inf else BoardFailure.NOT_WHOLE
    return NoBoard(failure=failure, finding=finding)


def circle_failure(grey: GreyImage, board: Board) -> NoBoard:
    """Why a grid of circles is not found: it is mirrored or another one, or circles are missing (OpenCV's blobs)."""
    columns, rows = board.squares_x or 0, board.squares_y or 0
    images = [brightened(image) for image in (grey, negative(grey))]
    blobs = max((blob_detector(image, columns * rows, without_small=True).detect(image) for image in images), key=len)
    circles_px = np.array([blob.pt for blob in blobs], dtype=np.float64).reshape(-1, 2)
    if len(circles_px) >= columns * rows:
        if _circles_of(np.ascontiguousarray(grey[:, ::-1]), board) is not None:
            return NoBoard(failure=BoardFailure.MIRRORED)
        other = next(
            (grid for grid in _other_grids(board, len(circles_px)) if _circles_of(grey, grid) is not None), None
        )
        if other is not None:
            failure = BoardFailure.LARGER if len(circles_px) > columns * rows else BoardFailure.OTHER_SIZE
            finding = f"as with kind: {other.kind}, squares_x: {other.squares_x}, squares_y: {other.squares_y}"
            return NoBoard(failure=failure, finding=finding, points_px=circles_px)
    width_px = edge_width_px(grey)
    finding = f"{len(circles_px)} circles are seen, the board has {columns} x {rows} = {columns * rows}"
    if len(circles_px) == columns * rows:
        finding = f"{columns * rows} circles are seen, as many as the board has, but not in its {rows} rows"
    finding += f", {edge_width_in_words(width_px)}"
    failure = BoardFailure.NOT_WHOLE
    if len(circles_px) < columns * rows and BLURRED_PX < width_px < np.inf:
        failure = BoardFailure.BLURRED
    return NoBoard(failure=failure, finding=finding, points_px=circles_px)


def _circles_of(grey: GreyImage, board: Board) -> Float64[Array, "circle xy=2"] | None:
    """The centres of the circles of a grid; None if not all are found."""
    is_asymmetric = board.kind == "asymmetric_circles"
    centers = circle_centers(grey, corner_points(board), board.squares_x or 0, board.squares_y or 0, is_asymmetric)
    return None if centers is None else centers.points_px


def _other_grids(board: Board, circles: int) -> Iterator[Board]:
    """Grids that may be seen in place of the board, where this many circles are found, among them perhaps others.

    They have one more column or row, or this many circles with the board's columns or rows, these also exchanged, and
    of the other kind.
    """
    columns, rows = board.squares_x or 1, board.squares_y or 1
    if circles > columns * rows:
        yield replace(board, squares_x=columns + 1)
        yield replace(board, squares_y=rows + 1)
    whole = [(columns, circles // columns), (circles // rows, rows)]
    counts = [(x, y) for x, y in dict.fromkeys(whole) if x * y == circles]
    for kind in ("asymmetric_circles", "symmetric_circles"):
        for squares_x, squares_y in counts + [(y, x) for x, y in counts]:
            other = replace(board, kind=kind, squares_x=squares_x, squares_y=squares_y)
            if other != board and min(squares_x, squares_y) >= LAYOUTS[other.kind].min_count:
                yield other
