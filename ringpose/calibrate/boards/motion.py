"""Motion of the board within a shot: its corners come from one frame, its stripes from other frames."""

import cv2
import numpy as np

from ringpose.calibrate.boards.patterns.image_patch import patch_around
from ringpose.calibrate.boards.views import find_board, grey_8_bit
from ringpose.types.arrays import Array, Float64, UInt, UInt8
from ringpose.types.board import Board, BoardView
from ringpose.types.image import Shot

STILL_PX = 0.3
"""Displacement up to which a board counts as at rest: a stripe across a corner or warm air can cause it. On rendered
boards at rest it is 0.01 px for any illumination."""

_CORNERS, _HALF_PATCH_PX, _REACH_PX = 16, 15, 12
"""Number of tracked corners, half size of their templates, and search range."""

_MIN_CORRELATION = 0.8
"""Normalised correlation below which a template is not found."""


def board_shift_px(shot: Shot, view: BoardView, board: Board) -> float:
    """Maximum displacement of the board from the first frame with the lasers off (else the first) to any other frame.

    NaN if no other frame shows the corners.
    """
    off = np.flatnonzero(shot.lasers == 0)
    first = int(off[0]) if len(off) else 0
    start = grey_8_bit(shot.images[first])
    others = [image for index, image in enumerate(shot.images) if index != first]
    shifts = [_shift_px(start, image, view, board) for image in others]
    return max((shift for shift in shifts if np.isfinite(shift)), default=float("nan"))


def _shift_px(
    start: UInt8[Array, "row column"], image: UInt[Array, "row column"], view: BoardView, board: Board
) -> float:
    """Median displacement of the corners by template matching; if that fails, by detecting the board again."""
    chosen = view.points_px[np.linspace(0, len(view.points_px) - 1, min(_CORNERS, len(view.points_px))).astype(int)]
    grey = grey_8_bit(image)
    moved = [shift for corner in chosen for shift in [_tracked(start, grey, corner)] if shift is not None]
    if len(moved) >= min(4, len(chosen)):
        return float(np.linalg.norm(np.median(moved, axis=0)))
    anew = find_board(image, board, view.name)
    if not isinstance(anew, BoardView):
        return float("nan")
    _, before, after = np.intersect1d(view.ids, anew.ids, return_indices=True)
    return float(np.linalg.norm(np.median(anew.points_px[after] - view.points_px[before], axis=0)))


def _tracked(
    start: UInt8[Array, "row column"], image: UInt8[Array, "row column"], corner: Float64[Array, "xy=2"]
) -> Float64[Array, "xy=2"] | None:
    """Displacement of the template around one corner; None if it is not found or exceeds the image."""
    column, row = np.rint(corner).astype(int).tolist()
    patch = patch_around(start, column, row, _HALF_PATCH_PX)
    search = patch_around(image, column, row, _HALF_PATCH_PX + _REACH_PX)
    if patch is None or search is None or patch.std() < 1.0 or search.std() < 1.0:
        return None
    correlation = np.asarray(cv2.matchTemplate(search, patch, cv2.TM_CCOEFF_NORMED), dtype=np.float64)
    y, x = np.unravel_index(int(np.argmax(correlation)), correlation.shape)
    if correlation[y, x] < _MIN_CORRELATION or not (0 < x < 2 * _REACH_PX and 0 < y < 2 * _REACH_PX):
        return None
    across, down = (correlation[y, x - 1 : x + 2], correlation[y - 1 : y + 2, x])
    return np.array([x + _vertex(across), y + _vertex(down)]) - _REACH_PX


def _vertex(values: Float64[Array, "3"]) -> float:
    """Position of the maximum of the parabola through three values, the middle one largest."""
    before, top, after = values.tolist()
    curvature = before - 2 * top + after
    return 0.5 * (before - after) / curvature if curvature < 0 else 0.0
