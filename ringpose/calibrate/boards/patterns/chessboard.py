"""Inner corners of a chessboard, in the order of the board frame (ringpose-method(7), section 7).

OpenCV finds the corners and refines them to sub-pixel. Its refinement uses every gradient in its window as an edge:
uneven illumination beside a bright stripe, speckle and shadows bias it. The corners are therefore refined once more, in
windows whose dark and bright squares are each normalised to one grey level. On photographs with a laser beside the
board the rms falls from 0.44 to 0.28 px, on evenly lit ones by 1 %.
"""

from typing import Any

import cv2
import numpy as np

from ringpose.calibrate.boards.patterns.image_patch import (
    GreyImage,
    Offsets,
    Patch,
    brightness_plane,
    grey_around,
    in_full_image,
    reduced,
    reductions,
)
from ringpose.types.arrays import Array, Float64

Grid = Float64[Array, "corner_row corner_column xy=2"]
"""Pixel positions of inner corners by row and column of the board."""

WINDOW_PER_SQUARE = 0.25
"""Half-window of the sub-pixel refinement, in shortest squares: 5 px on a 640 x 480 photograph of 21 px squares.

A window that contains the next corner is harmful: with 11 px on that photograph the rms doubles from 0.20 to 0.41 px.
"""

MAX_WINDOW_PX = 11
"""A wider window does not improve large squares, and would contain the surroundings at the board's rim."""

MAX_IRREGULARITY = 0.2
"""Maximum third difference of a grid, in squares. It is below 0.15 on photographs; beside a bright stripe, OpenCV's
sector-based detector misplaces a whole column by 0.2 squares, which gives 0.6 to 1.2."""

CLIPPED_SHARE = 0.05
"""Normalised grey values (0 and 1 in the two colours of squares) are clipped to this distance from 0 and 1, which
removes variation within a square."""

EDGE_PX = 2.5
"""Pixels nearer to an edge than this are a mixture of both squares, and do not determine the squares' grey levels."""

MIN_CONTRAST_DN = 2.0
"""Minimum difference of the two grey levels."""

_FINDERS: tuple[tuple[Any, int], ...] = (
    (cv2.findChessboardCornersSB, cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY),
    (cv2.findChessboardCorners, cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE),
)
"""OpenCV's detectors with their flags: the sector-based one first, then the classic one."""

_RANDOM_SEEDS = (1, 2, 3)
"""Random seeds of OpenCV's sector-based detector, which is randomised: fixed, so that results are reproducible."""

_START_GRIDS = ((4, 3), (5, 4))
"""Minimum grids that noise does not produce; the larger one sometimes succeeds where the smaller one fails."""

MAX_VISIBLE_IRREGULARITY = 1.0
"""Maximum irregularity of a grid that shows that there is a chessboard: each of 121 views of boards, also dim, noisy or
blurred ones, has one below 0.9, nearly all below 0.5; in 34 photographs without a board none has less than 1.2."""

_VISIBLE_REDUCTIONS = (4, 2, 1)
"""Factors by which the image is reduced in turn in the quick search."""

_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)

_NORMALISED_ROUNDS, _NORMALISED_MARGIN_PX = 2, 3
"""Rounds of the refinement in normalised windows, and pixels around the window that determine its grey levels too."""


def visible_grid(image: GreyImage, columns: int, rows: int) -> Grid | None:
    """Part of a chessboard of any size, unrefined; None if the image shows none.

    Quick searches by OpenCV's sector-based detector, from a start grid that clutter hardly ever forms, in the reduced
    image first. Without a board they take a tenth of the time of the detectors of a whole board, which try all scales
    and thresholds.
    """
    width, height = _START_GRIDS[-1]
    start = (min(width, max(columns, rows)), min(height, columns, rows))
    for factor in _VISIBLE_REDUCTIONS:
        reduction = factor * reductions(image.shape)[0]
        grid = _grown_grid(reduced(image, reduction), start, _RANDOM_SEEDS[0])
        if grid is not None and irregularity(grid) < MAX_VISIBLE_IRREGULARITY:
            return in_full_image(grid, reduction)
    return None


def _grown_grid(image: GreyImage, start: tuple[int, int], seed: int, flags: int = 0) -> Grid | None:
    """The largest grid that OpenCV's sector-based detector grows from one of this size."""
    cv2.setRNGSeed(seed)
    flags |= cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE
    is_found, corners, squares = cv2.findChessboardCornersSBWithMeta(image, start, flags)
    return np.asarray(corners, dtype=np.float64).reshape(*np.asarray(squares).shape[:2], 2) if is_found else None


def chessboard_corners(image: GreyImage, columns: int, rows: int) -> Float64[Array, "corner xy=2"] | None:
    """The inner corners, row by row from the top left, refined to sub-pixel; None if not all of them are found."""
    for reduction in reductions(image.shape):
        small = reduced(image, reduction)
        for finder, flags in _FINDERS:
            cv2.setRNGSeed(_RANDOM_SEEDS[0])
            is_found, corners = finder(small, (columns, rows), flags=flags)
            if is_found:
                grid = in_full_image(np.asarray(corners, dtype=np.float64).reshape(rows, columns, 2), reduction)
                refined = _refined_grid(image, grid)
                if irregularity(refined) < MAX_IRREGULARITY:
                    normalised = saddle_points(image, refined, WINDOW_PER_SQUARE * shortest_side(grid))
                    return _in_board_order(image, normalised).reshape(-1, 2)
    return None


def _refined_grid(image: GreyImage, grid: Grid) -> Grid:
    """The corners refined by OpenCV."""
    return refined_corners(image, grid.reshape(-1, 2), WINDOW_PER_SQUARE * shortest_side(grid)).reshape(grid.shape)


def shortest_side(grid: Grid) -> float:
    """Length in pixels of the shortest side of a square."""
    sides = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min(initial=np.inf) for axis in (0, 1)]
    return float(min(sides))


def refined_corners(
    image: GreyImage, corners: Float64[Array, "corner xy=2"], half_window_px: float
) -> Float64[Array, "corner xy=2"]:
    """Saddle points near the given corners by OpenCV; a corner that leaves its window is unchanged."""
    half = int(np.clip(half_window_px, 2, MAX_WINDOW_PX))
    start: Any = np.ascontiguousarray(corners, dtype=np.float32).reshape(-1, 1, 2)
    moved = np.asarray(cv2.cornerSubPix(image, start.copy(), (half, half), (-1, -1), _CRITERIA), dtype=np.float64)
    moved = moved.reshape(-1, 2)
    near = np.linalg.norm(moved - corners, axis=1) < half
    return np.where(near[:, None], moved, corners)


def irregularity(grid: Grid) -> float:
    """Largest third difference of corner positions along the rows and columns, in shortest sides of a square.

    Perspective and distortion change the squares smoothly; a misplaced column does not.
    """
    jumps = [np.linalg.norm(np.diff(grid, n=3, axis=axis), axis=-1).max(initial=0.0) for axis in (0, 1)]
    return float(max(jumps)) / max(shortest_side(grid), 1e-9)


def saddle_points(image: GreyImage, grid: Grid, half_window_px: float) -> Grid:
    """Corners refined in windows with normalised squares; one that fails, or moves too far, is unchanged."""
    half = int(np.clip(half_window_px, 2, MAX_WINDOW_PX))
    along, down = np.gradient(grid, axis=1), np.gradient(grid, axis=0)
    refined = grid.copy()
    for index in np.ndindex(grid.shape[:2]):
        for _ in range(_NORMALISED_ROUNDS):
            moved = _saddle_point(image, refined[index], (along[index], down[index]), half)
            if moved is None or np.linalg.norm(moved - grid[index]) >= half:
                break
            refined[index] = moved
    return refined


_Sides = tuple[Float64[Array, "xy=2"], Float64[Array, "xy=2"]]
"""Vectors along the two edges that cross in a corner, in pixels."""


def _saddle_point(
    image: GreyImage, corner: Float64[Array, "xy=2"], sides: _Sides, half: int
) -> Float64[Array, "xy=2"] | None:
    """The corner after one refinement in its normalised window; None at the image's rim and for low contrast."""
    around = grey_around(image, corner, half + _NORMALISED_MARGIN_PX)
    normalised = None if around is None else _normalised(*around, sides)
    if around is None or normalised is None:
        return None
    origin = around[1][0, 0]  # of the patch, relative to the corner
    start = -origin.astype(np.float32).reshape(1, 1, 2)
    refined = cv2.cornerSubPix(normalised.astype(np.float32), start, (half, half), (-1, -1), _CRITERIA)
    return corner + origin + np.asarray(refined, dtype=np.float64).reshape(2)


def _normalised(patch: Patch, offset: Offsets, sides: _Sides) -> Patch | None:
    """The patch with the two diagonal pairs of squares normalised to 0 and 1; None for low contrast.

    The grey level of each pair is a plane, fitted to the pixels away from the edges.
    """
    distances = [offset @ np.array([-side[1], side[0]]) / np.linalg.norm(side) for side in sides]
    clear = np.minimum(*np.abs(distances)) > EDGE_PX
    first_pair = distances[0] * distances[1] > 0
    pairs = [clear & first_pair, clear & ~first_pair]
    if min(pair.sum() for pair in pairs) < 4 * 3:  # four pixels for each parameter of a plane
        return None
    first, second = (brightness_plane(patch, offset, pair) for pair in pairs)
    contrast = second - first
    if np.abs(contrast).min() < MIN_CONTRAST_DN:
        return None
    return np.clip((patch - first) / contrast, CLIPPED_SHARE, 1.0 - CLIPPED_SHARE)


def _in_board_order(image: GreyImage, grid: Grid) -> Grid:
    """The corners of a grid reordered: x to the right, y down (never mirrored), the outer top-left square black.

    A board whose numbers of squares are both odd or both even is symmetric under half a turn: then the first corner is
    the one nearer to the image's top left.
    """
    right, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    if right[0] * down[1] - right[1] * down[0] < 0:
        grid = grid[:, ::-1]
    rows, columns = grid.shape[:2]
    if (rows + columns) % 2 == 0:
        return grid if grid[0, 0].sum() <= grid[-1, -1].sum() else grid[::-1, ::-1]
    # The square between the first four corners has the outer top-left one's colour: is it darker than its neighbours?
    middle = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    column, row = np.rint(middle).astype(np.int64).reshape(-1, 2).T
    values = image[row, column].astype(np.float64).reshape(middle.shape[:2])
    sign = 1 - 2 * (np.indices(values.shape).sum(axis=0) % 2)
    return grid if np.sum(sign * (values - np.median(values))) < 0 else grid[::-1, ::-1]


def largest_grid(image: GreyImage) -> Grid | None:
    """The largest regular chessboard of any size in the image; used to explain why the expected one is not found."""
    reduction = reductions(image.shape)[0]
    small = reduced(image, reduction)
    regular = []
    for size in _START_GRIDS:
        for seed in _RANDOM_SEEDS:
            grid = _grown_grid(small, size, seed, cv2.CALIB_CB_EXHAUSTIVE)
            if grid is not None:
                grid = in_full_image(_refined_grid(small, grid), reduction)
                regular += [grid] if irregularity(grid) < MAX_IRREGULARITY else []
    return max(regular, key=lambda grid: grid.size, default=None)
