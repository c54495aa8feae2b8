"""Inner corners of a chessboard, in the order of the board frame (ringpose-method(7), section 7).

OpenCV's sub-pixel refinement uses every gradient in its window as an edge: uneven illumination beside a bright stripe,
speckle and shadows bias it. Here the dark and the bright squares around a corner are each normalised to one level
first. On photographs with a laser beside the board the rms falls from 0.44 to 0.28 px, on evenly lit ones by 1 %.
"""

from typing import Any

import cv2
import numpy as np

from ringpose.calibrate.boards.image_patch import in_full_image, reduced, reductions
from ringpose.types.arrays import Array, Bool, Float64, UInt8

_SECTOR_BASED: int = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY

_CLASSIC: int = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE

WINDOW_PER_SQUARE = 0.25
"""Half-window of the sub-pixel refinement, in shortest squares: 5 px on a 640 x 480 photograph of 21 px squares.

A window that contains the next corner is harmful: with 11 px on that photograph the rms doubles from 0.20 to 0.41 px.
"""

MAX_WINDOW_PX = 11
"""A wider window does not improve large squares, and would contain the surroundings at the board's rim."""

MAX_IRREGULARITY = 0.2
"""Maximum third difference of a grid, in squares. It is below 0.15 on photographs; beside a bright stripe, OpenCV's
sector-based detector misplaces a whole column by 0.2 squares, which gives 0.6 to 1.2."""

_START_GRIDS = ((4, 3), (5, 4))
"""Minimum grids that noise does not produce; the larger one sometimes succeeds where the smaller one fails."""

_RANDOM_SEEDS = (1, 2, 3)
"""Random seeds of OpenCV's sector-based detector, which is randomised: fixed, so that results are reproducible."""

_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)


def chessboard_corners(
    image: UInt8[Array, "row column"], columns: int, rows: int
) -> Float64[Array, "corner xy=2"] | None:
    """The inner corners, row by row from the top left, refined to sub-pixel; None if not all of them are found."""
    for reduction in reductions(image.shape):
        small = reduced(image, reduction)
        for finder in (_sector_based, _classic):
            found = finder(small, columns, rows)
            if found is not None:
                grid = in_full_image(found, reduction)
                half_window_px = WINDOW_PER_SQUARE * shortest_side(grid)
                refined = refined_corners(image, grid.reshape(-1, 2), half_window_px).reshape(rows, columns, 2)
                if irregularity(refined) < MAX_IRREGULARITY:
                    levelled = levelled_corners(image, refined, whole_window(half_window_px))
                    return _in_board_order(image, levelled).reshape(-1, 2)
    return None


def irregularity(grid: Float64[Array, "corner_row corner_column xy=2"]) -> float:
    """Largest third difference along the rows and columns, in shortest sides.

    Perspective and distortion change the squares smoothly; a misplaced column does not.
    """
    jumps = [np.linalg.norm(np.diff(grid, n=3, axis=axis), axis=-1).max(initial=0.0) for axis in (0, 1)]
    return float(max(jumps)) / max(shortest_side(grid), 1e-9)


def _sector_based(
    image: UInt8[Array, "row column"], columns: int, rows: int
) -> Float64[Array, "corner_row corner_column xy=2"] | None:
    cv2.setRNGSeed(_RANDOM_SEEDS[0])
    found, corners = cv2.findChessboardCornersSB(image, (columns, rows), flags=_SECTOR_BASED)
    return np.asarray(corners, dtype=np.float64).reshape(rows, columns, 2) if found else None


def _classic(
    image: UInt8[Array, "row column"], columns: int, rows: int
) -> Float64[Array, "corner_row corner_column xy=2"] | None:
    found, corners = cv2.findChessboardCorners(image, (columns, rows), flags=_CLASSIC)
    return np.asarray(corners, dtype=np.float64).reshape(rows, columns, 2) if found else None


def largest_grid(image: UInt8[Array, "row column"]) -> Float64[Array, "corner_row corner_column xy=2"] | None:
    """The largest regular chessboard of any size in the image; used to explain why the expected one is not found."""
    reduction = next(iter(reductions(image.shape)))
    small = reduced(image, reduction)
    grown = [_grown_grid(small, size, draw) for size in _START_GRIDS for draw in _RANDOM_SEEDS]
    grids = [in_full_image(grid, reduction) for grid in grown if grid is not None]
    regular = [grid for grid in grids if irregularity(grid) < MAX_IRREGULARITY]
    return max(regular, key=lambda grid: grid.size, default=None)


def _grown_grid(
    image: UInt8[Array, "row column"], size: tuple[int, int], draw: int
) -> Float64[Array, "corner_row corner_column xy=2"] | None:
    """A grid of at least this size, refined."""
    flags = cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
    cv2.setRNGSeed(draw)
    found, corners, meta = cv2.findChessboardCornersSBWithMeta(image, size, flags)
    if not found:
        return None
    grid = np.asarray(corners, dtype=np.float64).reshape(*np.asarray(meta).shape[:2], 2)
    half_window_px = WINDOW_PER_SQUARE * shortest_side(grid)
    return refined_corners(image, grid.reshape(-1, 2), half_window_px).reshape(grid.shape)


def shortest_side(grid: Float64[Array, "corner_row corner_column xy=2"]) -> float:
    """Length in pixels of the shortest side of a square."""
    along = np.linalg.norm(np.diff(grid, axis=1), axis=-1)
    down = np.linalg.norm(np.diff(grid, axis=0), axis=-1)
    return float(min(along.min(initial=np.inf), down.min(initial=np.inf)))


def whole_window(half_window_px: float) -> int:
    """A half-window in whole pixels, clipped to useful sizes."""
    return int(np.clip(half_window_px, 2, MAX_WINDOW_PX))


def refined_corners(
    image: UInt8[Array, "row column"], corners: Float64[Array, "corner xy=2"], half_window_px: float
) -> Float64[Array, "corner xy=2"]:
    """Saddle points near the given corners; a corner that leaves its window is unchanged."""
    half = whole_window(half_window_px)
    start: Any = np.ascontiguousarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    moved = np.asarray(cv2.cornerSubPix(image, start.copy(), (half, half), (-1, -1), _CRITERIA), dtype=np.float64)
    moved = moved.reshape(-1, 2)
    near = np.linalg.norm(moved - corners, axis=1) < half
    return np.where(near[:, None], moved, corners)


def _in_board_order(
    image: UInt8[Array, "row column"], grid: Float64[Array, "corner_row corner_column xy=2"]
) -> Float64[Array, "corner_row corner_column xy=2"]:
    """The same corners with x to the right, y down (never mirrored), and the outer top-left square black.

    A board whose numbers of squares are both odd or both even is symmetric under half a turn: then the first corner is
    the one nearer to the image's top left.
    """
    right, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if right[0] * down[1] - right[1] * down[0] < 0:
        grid = grid[:, ::-1]
    turned = grid[::-1, ::-1]
    rows, columns = grid.shape[:2]
    if (rows + columns) % 2:
        return grid if _first_inner_square_is_black(image, grid) else turned
    return grid if grid[0, 0].sum() <= grid[-1, -1].sum() else turned


def _first_inner_square_is_black(
    image: UInt8[Array, "row column"], grid: Float64[Array, "corner_row corner_column xy=2"]
) -> bool:
    """Whether the square between the first four corners is darker than its neighbour: it has the outer one's colour."""
    middle = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    column, row = np.rint(middle).astype(np.int64).reshape(-1, 2).T
    values = image[row, column].astype(np.float64).reshape(middle.shape[:2])
    sign = 1 - 2 * (np.indices(values.shape).sum(axis=0) % 2)
    return bool(np.sum(sign * (values - np.median(values))) < 0)


CLIPPED_SHARE = 0.05
"""Normalised grey values are clipped to this distance from both levels, which removes variation within a square."""

EDGE_PX = 2.5
"""Pixels nearer to an edge than this are a mixture of both squares, and are not used for the levels."""

MIN_CONTRAST_DN = 2.0
"""Minimum difference of the two levels."""

_ROUNDS = 2

_MARGIN = 3


def levelled_corners(
    image: UInt8[Array, "row column"],
    grid: Float64[Array, "corner_row corner_column xy=2"],
    half_window_px: int,
) -> Float64[Array, "corner_row corner_column xy=2"]:
    """The corners refined in normalised windows; a corner for which this fails, or that moves too far, is unchanged."""
    along, down = np.gradient(grid, axis=1), np.gradient(grid, axis=0)
    refined = grid.copy()
    for index in np.ndindex(grid.shape[:2]):
        for _ in range(_ROUNDS):
            moved = _saddle_point(image, refined[index], (along[index], down[index]), half_window_px)
            if moved is None or np.linalg.norm(moved - grid[index]) >= half_window_px:
                break
            refined[index] = moved
    return refined


_Sides = tuple[Float64[Array, "xy=2"], Float64[Array, "xy=2"]]


def _saddle_point(
    image: UInt8[Array, "row column"], corner: Float64[Array, "xy=2"], sides: _Sides, half: int
) -> Float64[Array, "xy=2"] | None:
    """One step of the refinement; None at the image's rim and for low contrast."""
    reach = half + _MARGIN
    column, row = np.rint(corner).astype(np.int64).tolist()
    inside = reach <= column < image.shape[1] - reach and reach <= row < image.shape[0] - reach
    if not inside:
        return None
    patch = image[row - reach : row + reach + 1, column - reach : column + reach + 1].astype(np.float64)
    origin = np.array([column - reach, row - reach], dtype=np.float64)
    levelled = _levelled(patch, corner - origin, sides)
    if levelled is None:
        return None
    start = (corner - origin).astype(np.float32).reshape(1, 1, 2)
    found = cv2.cornerSubPix(levelled.astype(np.float32), start, (half, half), (-1, -1), _CRITERIA)
    moved: Float64[Array, "xy=2"] = np.asarray(found, dtype=np.float64).reshape(2) + origin
    return moved


def _levelled(
    patch: Float64[Array, "row column"], corner: Float64[Array, "xy=2"], sides: _Sides
) -> Float64[Array, "row column"] | None:
    """The patch with the two diagonal pairs of squares normalised to 0 and 1; None for low contrast."""
    row, column = np.indices(patch.shape, dtype=np.float64)
    offset = np.stack([column - corner[0], row - corner[1]], axis=-1)
    across_along, across_down = (_across(offset, side) for side in sides)
    clear = np.minimum(np.abs(across_along), np.abs(across_down)) > EDGE_PX
    same = across_along * across_down > 0
    design = np.concatenate([np.ones((*patch.shape, 1)), offset], axis=-1)
    first, second = (_plane(patch, design, clear & side) for side in (same, ~same))
    if first is None or second is None:
        return None
    contrast = second - first
    if np.abs(contrast).min() < MIN_CONTRAST_DN:
        return None
    levelled: Float64[Array, "row column"] = np.clip((patch - first) / contrast, CLIPPED_SHARE, 1.0 - CLIPPED_SHARE)
    return levelled


def _across(offset: Float64[Array, "row column xy=2"], side: Float64[Array, "xy=2"]) -> Float64[Array, "row column"]:
    """Signed distance from the line through the corner along a side."""
    across: Float64[Array, "row column"] = offset @ np.array([-side[1], side[0]]) / np.linalg.norm(side)
    return across


def _plane(
    patch: Float64[Array, "row column"],
    design: Float64[Array, "row column term=3"],
    used: Bool[Array, "row column"],
) -> Float64[Array, "row column"] | None:
    """Plane fitted to the brightness of one pair of squares; None if it has too few pixels."""
    if used.sum() < 4 * design.shape[-1]:
        return None
    rows = design[used]
    plane: Float64[Array, "row column"] = design @ np.linalg.lstsq(rows.T @ rows, rows.T @ patch[used])[0]
    return plane
