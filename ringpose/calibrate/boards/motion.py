"""Whether the board stood still in a shot: its corners come from one frame, its stripes from others."""

import cv2
import numpy as np

from ringpose.calibrate.boards.image_patch import patch_around
from ringpose.calibrate.boards.views import find_board, grey_8_bit
from ringpose.types.arrays import Array, Float64, UInt, UInt8
from ringpose.types.board import Board, BoardView
from ringpose.types.image import Shot

STILL_PX = 0.3
"""Corners that move by less between frames may be a stripe across them, or warm air: of rendered boards they move by
0.01, the light turned up or full."""

_CORNERS, _HALF_PATCH_PX, _REACH_PX = 16, 15, 12
"""How many corners are followed, the half size of what is followed, and how far it is looked for."""

_LIKENESS = 0.8
"""Correlation below which a patch is not the same."""


def board_shift_px(shot: Shot, view: BoardView, board: Board) -> float:
    """The most that the board moved in the image from its first unlit frame, or first of all, to any other.

    NaN where no other frame shows the corners.
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
    """Median over the corners; where their surroundings are not found, by looking for the board anew."""
    chosen = view.points_px[np.linspace(0, len(view.points_px) - 1, min(_CORNERS, len(view.points_px))).astype(int)]
    grey = grey_8_bit(image)
    moved = [shift for corner in chosen for shift in [_followed(start, grey, corner)] if shift is not None]
    if len(moved) >= min(4, len(chosen)):
        return float(np.linalg.norm(np.median(moved, axis=0)))
    anew = find_board(image, board, view.name)
    if not isinstance(anew, BoardView):
        return float("nan")
    _, before, after = np.intersect1d(view.ids, anew.ids, return_indices=True)
    return float(np.linalg.norm(np.median(anew.points_px[after] - view.points_px[before], axis=0)))


def _followed(
    start: UInt8[Array, "row column"], image: UInt8[Array, "row column"], corner: Float64[Array, "xy=2"]
) -> Float64[Array, "xy=2"] | None:
    """How far the surroundings of one corner have moved; None if they are not found, or leave the image."""
    column, row = np.rint(corner).astype(int).tolist()
    patch = patch_around(start, column, row, _HALF_PATCH_PX)
    search = patch_around(image, column, row, _HALF_PATCH_PX + _REACH_PX)
    if patch is None or search is None or patch.std() < 1.0 or search.std() < 1.0:
        return None
    likeness = np.asarray(cv2.matchTemplate(search, patch, cv2.TM_CCOEFF_NORMED), dtype=np.float64)
    y, x = np.unravel_index(int(np.argmax(likeness)), likeness.shape)
    if likeness[y, x] < _LIKENESS or not (0 < x < 2 * _REACH_PX and 0 < y < 2 * _REACH_PX):
        return None
    across, down = (likeness[y, x - 1 : x + 2], likeness[y - 1 : y + 2, x])
    return np.array([x + _vertex(across), y + _vertex(down)]) - _REACH_PX


def _vertex(values: Float64[Array, "3"]) -> float:
    """Where the parabola through three values, the middle one largest, has its top."""
    before, top, after = values.tolist()
    bend = before - 2 * top + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0
