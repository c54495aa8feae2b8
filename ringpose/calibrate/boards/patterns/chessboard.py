"""Inner corners of a chessboard, in the order of the board frame (ringpose-method(7), section 7).

OpenCV finds the corners and refines them to sub-pixel. Its refinement uses every gradient in its window as an edge:
uneven illumination beside a bright stripe, speckle and shadows bias it. The corners are therefore refined once more, in
windows whose dark and bright squares are each normalised to one grey level. On photographs with a laser beside the
board the rms falls from 0.44 to 0.28 px, on evenly lit ones by 1 %.
"""

from collections.abc import Iterator
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

NumberedGrid = Float64[Array, "corner_row corner_column xy_number"]
"""Positions by row and column, and what may stand behind them, such as their numbers."""

WINDOW_PER_SQUARE = 0.25
"""Half-window of the sub-pixel refinement, in shortest squares: 5 px on a 640 x 480 photograph of 21 px squares.

A window that contains the next corner is harmful: with 11 px on that photograph the rms doubles from 0.20 to 0.41 px.
"""

MAX_WINDOW_PX = 11
"""A wider window does not improve large squares, and would contain the surroundings at the board's rim."""

MAX_IRREGULARITY = 0.2
"""Maximum third difference of a grid, in squares. It is below 0.15 on photographs; beside a bright stripe, OpenCV's
sector-based detector misplaces a whole column by 0.2 squares, which gives 0.6 to 1.2. A grid with a larger one is used
only if no whole line of it is misplaced: then single corners are inexact, which a calibration leaves out."""

CLIPPED_SHARE = 0.05
"""Normalised grey values (0 and 1 in the two colours of squares) are clipped to this distance from 0 and 1, which
removes variation within a square."""

EDGE_PX = 2.5
"""Pixels nearer to an edge than this are a mixture of both squares, and do not determine the squares' grey levels."""

MIN_CONTRAST_DN = 2.0
"""Minimum difference of the two grey levels."""

_Finder = tuple[Any, int]
"""A detector of OpenCV with its flags."""

_SECTOR_FLAGS = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE | cv2.CALIB_CB_ACCURACY
_SECTOR_FINDER: _Finder = (cv2.findChessboardCornersSB, _SECTOR_FLAGS)
_CLASSIC_FINDER: _Finder = (cv2.findChessboardCorners, cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE)

_RANDOM_SEEDS = (1, 2, 3)
"""Random seeds of OpenCV's sector-based detector, which is randomised: fixed, so that results are reproducible."""

_START_GRIDS = ((4, 3), (5, 4))
"""Minimum grids that noise does not produce; the larger one sometimes succeeds where the smaller one fails."""

MAX_VISIBLE_IRREGULARITY = 1.0
"""Maximum irregularity of a grid that shows that there is a chessboard: each of 121 views of boards, also dim, noisy or
blurred ones, has one below 0.9, nearly all below 0.5; in 34 photographs without a board none has less than 1.2."""

MIN_SADDLE_CONTRAST = 1.5
"""Minimum difference of the two diagonals of squares around an inner corner, in differences of black and white: it is 2
there, and 1 at a corner of an outermost square, which has white on three sides."""

_VISIBLE_REDUCTIONS = (4, 2, 1)
"""Factors by which the image is reduced in turn in the quick search."""

_CRITERIA = (cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_MAX_ITER, 60, 1e-4)

_NORMALISED_ROUNDS, _NORMALISED_MARGIN_PX = 2, 3
"""Rounds of the refinement in normalised windows, and pixels around the window that determine its grey levels too."""


def is_visible(image: GreyImage, columns: int, rows: int) -> bool:
    """Whether a quick search finds part of a chessboard of any size, or OpenCV's classic detector this one.

    The quick search is by OpenCV's sector-based detector, from a start grid that clutter hardly ever forms, in the
    reduced image first. Without a board it takes a tenth of the time of that detector for a whole board, which tries
    all scales and thresholds. It does not see every board beside which a stripe saturates.
    """
    width, height = _START_GRIDS[-1]
    start = (min(width, max(columns, rows)), min(height, columns, rows))
    for factor in _VISIBLE_REDUCTIONS:
        reduction = factor * reductions(image.shape)[0]
        grid = _grown_grid(reduced(image, reduction), start, _RANDOM_SEEDS[0])
        if grid is not None and irregularity(grid) < MAX_VISIBLE_IRREGULARITY:
            return True
    finder, flags = _CLASSIC_FINDER
    return bool(finder(reduced(image, reductions(image.shape)[0]), (columns, rows), flags=flags)[0])


def _grown_grid(image: GreyImage, start: tuple[int, int], seed: int, flags: int = 0) -> Grid | None:
    """The largest grid that OpenCV's sector-based detector grows from one of this size."""
    cv2.setRNGSeed(seed)
    flags |= cv2.CALIB_CB_LARGER | cv2.CALIB_CB_NORMALIZE_IMAGE
    is_found, corners, squares = cv2.findChessboardCornersSBWithMeta(image, start, flags)
    return np.asarray(corners, dtype=np.float64).reshape(*np.asarray(squares).shape[:2], 2) if is_found else None


def chessboard_corners(
    image: GreyImage, columns: int, rows: int
) -> tuple[Float64[Array, "corner xy=2"] | None, Grid | None]:
    """The inner corners, row by row from the top left, refined to sub-pixel; None if not all of them are found.

    Then the second value is the largest regular part of a chessboard that is seen, if any.
    """
    inexact: list[Grid] = []
    unrefined: list[Grid] = []
    larger: list[Grid] = []
    for grid, refined in _whole_grids(image, columns, rows):
        if (whole := with_lines_beyond(image, refined)).size > refined.size:
            larger.append(whole)
            continue
        if irregularity(refined) < MAX_IRREGULARITY:
            return _exact_corners(image, refined), None
        inexact.append(refined)
        unrefined.append(grid)
    regular = min(unrefined, key=irregularity, default=None)
    if regular is not None and irregularity(regular) < MAX_IRREGULARITY:  # noise can spoil the refinement
        return _exact_corners(image, regular), None
    seen = None if larger else largest_grid(image)
    if seen is not None and (whole := with_lines_beyond(image, seen)).size > max(seen.size, 2 * rows * columns):
        larger.append(whole)
    elif seen is not None and seen.shape[:2] in ((rows, columns), (columns, rows)):
        return _exact_corners(image, seen if len(seen) == rows else seen.swapaxes(0, 1)), None
    inexact = [grid for grid in inexact if _has_lines_in_place(grid)]
    if inexact:
        return _exact_corners(image, min(inexact, key=irregularity)), None
    return None, max([*larger, *([] if seen is None else [seen])], key=lambda grid: grid.size, default=None)


def _whole_grids(image: GreyImage, columns: int, rows: int) -> Iterator[tuple[Grid, Grid]]:
    """Grids of all inner corners by each of OpenCV's detectors, in less and less reduced images, and refined."""
    for reduction in reductions(image.shape):
        small = reduced(image, reduction)
        for finder, flags in (_SECTOR_FINDER, _CLASSIC_FINDER):
            cv2.setRNGSeed(_RANDOM_SEEDS[0])
            is_found, corners = finder(small, (columns, rows), flags=flags)
            if is_found:
                grid = in_full_image(np.asarray(corners, dtype=np.float64).reshape(rows, columns, 2), reduction)
                refined = without_outline(image, _refined_grid(image, grid))
                if refined.shape == grid.shape:
                    yield grid, refined


def _exact_corners(image: GreyImage, grid: Grid) -> Float64[Array, "corner xy=2"]:
    """The corners of a grid in the order of the board, refined with normalised squares if that leaves it regular."""
    normalised = saddle_points(image, grid, WINDOW_PER_SQUARE * shortest_side(grid))
    is_spoiled = irregularity(normalised) > max(MAX_IRREGULARITY, irregularity(grid))
    return _in_board_order(image, grid if is_spoiled else normalised).reshape(-1, 2)


def _refined_grid(image: GreyImage, grid: Grid) -> Grid:
    """The corners refined by OpenCV."""
    return refined_corners(image, grid.reshape(-1, 2), WINDOW_PER_SQUARE * shortest_side(grid)).reshape(grid.shape)


def without_outline(image: GreyImage, grid: Grid) -> Float64[Array, "inner_row inner_column xy=2"]:
    """The grid without outer lines of points that are corners of the outermost squares, not inner corners.

    Where the image's rim cuts the board, OpenCV completes the grid with such a line, one square off. There, one of the
    four squares around a point has the other colour than the rest; around an inner corner, two have.
    """
    while min(grid.shape[:2]) > 2:
        saddle = _saddle_contrast(image, grid)
        lines = {(0, 0): saddle[0], (0, -1): saddle[-1], (1, 0): saddle[:, 0], (1, -1): saddle[:, -1]}
        (axis, end), least = min(((line, float(np.median(own))) for line, own in lines.items()), key=lambda one: one[1])
        if least > MIN_SADDLE_CONTRAST:
            break
        grid = np.delete(grid, end, axis=axis)
    return grid


def with_lines_beyond(image: GreyImage, grid: Grid) -> Float64[Array, "larger_grid_row larger_grid_column xy=2"]:
    """The grid with the lines of inner corners on which the board goes on beyond it, as far as the image shows them.

    OpenCV's detectors of a board of given size find it also as a part of a larger one, and nothing shows which part.
    A line is where the last two lines predict it, and shows saddle points there.
    """
    is_complete = False
    while not is_complete:
        is_complete = True
        for turns in range(4):
            turned = np.rot90(grid, turns)
            beyond = 2 * turned[0] - turned[1]
            inside = np.all((beyond >= 0) & (beyond <= np.array(image.shape[::-1]) - 1.0), axis=1)
            contrast = _saddle_contrast(image, np.stack([beyond, turned[0]]))[0]
            if np.mean(inside) > 0.5 and float(np.median(contrast[inside])) > MIN_SADDLE_CONTRAST:
                beyond = refined_corners(image, beyond, WINDOW_PER_SQUARE * shortest_side(grid))
                grid, is_complete = np.rot90(np.concatenate([beyond[None], turned]), -turns), False
    return grid


def _saddle_contrast(image: GreyImage, grid: Grid) -> Float64[Array, "corner_row corner_column"]:
    """Difference of the two diagonals of squares around each point, over the largest difference of two squares."""
    smooth = cv2.blur(image, (max(int(WINDOW_PER_SQUARE * shortest_side(grid)), 1),) * 2)
    along, down = np.gradient(grid, axis=1) / 4, np.gradient(grid, axis=0) / 4
    signs = ((1, 1), (-1, -1), (1, -1), (-1, 1))
    places = np.rint([grid + x * along + y * down for x, y in signs]).astype(np.int64)
    column, row = np.moveaxis(np.clip(places, 0, np.array(image.shape[::-1]) - 1), -1, 0)
    squares = smooth[row, column].astype(np.float64)
    return np.abs(squares[:2].sum(axis=0) - squares[2:].sum(axis=0)) / np.maximum(np.ptp(squares, axis=0), 1.0)


def shortest_side(grid: Grid) -> float:
    """Length in pixels of the shortest side of a square."""
    sides = [np.linalg.norm(np.diff(grid, axis=axis), axis=-1).min(initial=np.inf) for axis in (0, 1)]
    return float(min(sides))


def refined_corners(
    image: GreyImage, corners: Float64[Array, "corner xy=2"], half_window_px: float
) -> Float64[Array, "corner xy=2"]:
    """Saddle points near the given corners by OpenCV; one that leaves its window, or is at the rim, is unchanged."""
    half = int(np.clip(half_window_px, 2, MAX_WINDOW_PX))
    inside = np.all((corners >= 0) & (corners <= np.array(image.shape[::-1]) - 1.0), axis=1)  # OpenCV fails outside
    refined = np.array(corners, dtype=np.float64)
    if not inside.any():
        return refined
    start: Any = np.ascontiguousarray(corners[inside], dtype=np.float32).reshape(-1, 1, 2)
    moved = np.asarray(cv2.cornerSubPix(image, start, (half, half), (-1, -1), _CRITERIA), dtype=np.float64)
    moved = moved.reshape(-1, 2)
    near = np.linalg.norm(moved - corners[inside], axis=1) < half
    refined[inside] = np.where(near[:, None], moved, corners[inside])
    return refined


def irregularity(grid: Grid) -> float:
    """Largest third difference of corner positions along the rows and columns, in shortest sides of a square.

    Perspective and distortion change the squares smoothly; a misplaced column does not.
    """
    return max(float(jumps.max(initial=0.0)) for jumps in _jumps(grid))


def _has_lines_in_place(grid: Grid) -> bool:
    """Whether no line of corners as a whole is misplaced, and no corner by more than half of its distance to others."""
    typical = max(float(np.median(jumps, axis=0).max(initial=0.0)) for jumps in _jumps(grid))
    return typical < MAX_IRREGULARITY and irregularity(grid) < MAX_VISIBLE_IRREGULARITY


def _jumps(grid: Grid) -> list[Float64[Array, "line place"]]:
    """Third differences along rows and columns, each line a row of the result, in shortest sides of a square."""
    side = max(shortest_side(grid), 1e-9)
    return [np.linalg.norm(np.diff(lines, n=3, axis=1), axis=-1) / side for lines in (grid, grid.swapaxes(0, 1))]


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
    grid = unmirrored(grid)
    rows, columns = grid.shape[:2]
    if (rows + columns) % 2 == 0:
        return upright(grid)
    # The square between the first four corners has the outer top-left one's colour: is it darker than its neighbours?
    middle = (grid[:-1, :-1] + grid[1:, :-1] + grid[:-1, 1:] + grid[1:, 1:]) / 4
    column, row = np.clip(np.rint(middle).astype(np.int64).reshape(-1, 2), 0, np.array(image.shape[::-1]) - 1).T
    values = image[row, column].astype(np.float64).reshape(middle.shape[:2])
    sign = 1 - 2 * (np.indices(values.shape).sum(axis=0) % 2)
    return grid if np.sum(sign * (values - np.median(values))) < 0 else grid[::-1, ::-1]


def unmirrored(grid: NumberedGrid) -> NumberedGrid:
    """The grid with its columns in the order in which y is clockwise from x in the image, as seen from in front."""
    right, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    return grid if right[0] * down[1] - right[1] * down[0] >= 0 else grid[:, ::-1]


def upright(grid: NumberedGrid, quarter_turns: bool = False) -> NumberedGrid:
    """The grid turned by half a turn, or also by quarter turns, so that its first point is nearest to the top left."""
    turned = [np.rot90(grid, turns) for turns in ((0, 1, 2, 3) if quarter_turns else (0, 2))]
    return min(turned, key=lambda candidate: float(candidate[0, 0, :2].sum()))


def largest_grid(image: GreyImage) -> Grid | None:
    """The largest regular chessboard of any size in the image; used to explain why the expected one is not found."""
    reduction = reductions(image.shape)[0]
    small = reduced(image, reduction)
    regular = []
    for size in _START_GRIDS:
        for seed in _RANDOM_SEEDS:
            grid = _grown_grid(small, size, seed, cv2.CALIB_CB_EXHAUSTIVE)
            if grid is not None and irregularity(grid := _refined_grid(small, grid)) < MAX_VISIBLE_IRREGULARITY:
                grid = in_full_image(without_outline(small, grid), reduction)
                regular += [grid] if irregularity(grid) < MAX_IRREGULARITY else []
    return max(regular, key=lambda grid: grid.size, default=None)
