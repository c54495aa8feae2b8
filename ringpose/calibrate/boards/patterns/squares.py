"""Corners of separate black squares in a grid, as on Zhang's target of 1998 (ringpose-method(7), section 7).

Squares are the quadrangles that OpenCV's search for markers rejects. Each predicts its neighbours by its own sides, so
that the grid grows from one square to the others under any perspective. Corners are intersections of fitted sides, as
those of markers: there is no chessboard corner, and a window around a corner would pull it inside.
"""

from typing import NamedTuple

import cv2
import numpy as np

from ringpose.calibrate.boards.patterns.chessboard import unmirrored, upright
from ringpose.calibrate.boards.patterns.circles import NEAR_PLACE
from ringpose.calibrate.boards.patterns.image_patch import GreyImage
from ringpose.calibrate.boards.patterns.marker_edges import corners_from_sides
from ringpose.types.arrays import Array, Float64, Int64

Quadrangles = Float64[Array, "square corner=4 xy=2"]

Place = tuple[int, int]
"""Column and row in a grid, from any of its squares."""


class Squares(NamedTuple):
    """The squares of a board whose sides could be fitted."""

    numbers: Int64[Array, "square"]
    """Row by row from the top left."""
    corners_px: Quadrangles
    """Clockwise from the top left, on the board."""
    end_correlation: float
    """Correlation of a side's errors at its two ends."""


class OtherGrid(NamedTuple):
    """The largest grid of squares in an image, if it has not the board's columns and rows."""

    squares: int
    columns: int
    rows: int


def board_squares(grey: GreyImage, columns: int, rows: int, gap_per_side: float) -> Squares | OtherGrid:
    """The squares of a board in the image, or the largest grid of them if that has not its columns and rows.

    Single squares may be hidden: the others show the number of each as long as all rows and columns are seen.
    """
    quadrangles = _quadrangles(grey)
    grid = _largest_grid(quadrangles, 1.0 + gap_per_side)
    seen = np.array(list(grid), dtype=np.int64).reshape(-1, 2)
    places = seen - seen.min(axis=0, initial=0)
    size = tuple((places.max(axis=0, initial=-1) + 1).tolist())
    if size not in ((columns, rows), (rows, columns)):
        return OtherGrid(len(grid), *size)
    if size != (columns, rows):
        places, size = places[:, ::-1], (columns, rows)
    ordered = _in_board_order(quadrangles[list(grid.values())], places, size)
    cells = max(2.0, 1.0 / gap_per_side)  # pixels within half of the gap outside, and a quarter of a side inside
    refined = {number: corners_from_sides(grey, corners, cells) for number, corners in ordered.items()}
    fitted = {number: corners for number, corners in refined.items() if corners.end_correlation > 0}
    correlation = float(np.mean([corners.end_correlation for corners in fitted.values()])) if fitted else 0.0
    corners_px = np.array([corners.points_px for corners in fitted.values()]).reshape(-1, 4, 2)
    return Squares(np.array(list(fitted), dtype=np.int64), corners_px, correlation)


def _quadrangles(grey: GreyImage) -> Quadrangles:
    """All dark quadrangles in the image, clockwise."""
    parameters = cv2.aruco.DetectorParameters()
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_4X4_50)
    markers, _, others = cv2.aruco.ArucoDetector(dictionary, parameters).detectMarkers(grey)
    return np.array([*markers, *others], dtype=np.float64).reshape(-1, 4, 2)


def _largest_grid(quadrangles: Quadrangles, pitch: float) -> dict[Place, int]:
    """The indices of the squares of the largest grid, by place; neighbours are `pitch` sides apart."""
    left = set(range(len(quadrangles)))
    largest: dict[Place, int] = {}
    while left:
        grid = _grown_grid(quadrangles, min(left), pitch)
        left -= set(grid.values())
        largest = max(largest, grid, key=len)
    return largest


def _grown_grid(quadrangles: Quadrangles, first: int, pitch: float) -> dict[Place, int]:
    """The grid that grows from one square."""
    centers = quadrangles.mean(axis=1)
    across = (quadrangles[:, [1, 2]] - quadrangles[:, [0, 3]]).mean(axis=1)
    down = (quadrangles[:, [3, 2]] - quadrangles[:, [0, 1]]).mean(axis=1)
    sides = np.stack([across, down, -across, -down], axis=1)  # each a quarter turn from the one before
    grid, waiting = {(0, 0): first}, [((0, 0), first, sides[first])]
    while waiting:
        place, index, vectors = waiting.pop()
        for vector, (column, row) in zip(vectors, ((1, 0), (0, 1), (-1, 0), (0, -1)), strict=True):
            beside = (place[0] + column, place[1] + row)
            distance = np.linalg.norm(centers - centers[index] - pitch * vector, axis=1)
            nearest = int(np.argmin(distance))
            if beside in grid or nearest in grid.values():
                continue
            turned = [np.roll(sides[nearest], turn, axis=0) for turn in range(4)]
            own = min(turned, key=lambda candidate: float(np.linalg.norm(candidate - vectors)))
            far = max(float(distance[nearest]) / pitch, float(np.linalg.norm(own - vectors, axis=1).max()))
            if far < NEAR_PLACE * np.linalg.norm(vector):
                grid[beside] = nearest
                waiting.append((beside, nearest, own))
    return grid


def _in_board_order(
    quadrangles: Quadrangles, places: Int64[Array, "square column_row=2"], size: tuple[int, int]
) -> dict[int, Float64[Array, "corner=4 xy=2"]]:
    """The squares by number, row by row, never mirrored, each from the corner that is at its top left on the board."""
    every = np.stack(np.meshgrid(np.arange(size[0]), np.arange(size[1])), axis=-1)
    image_from_grid = np.asarray(cv2.findHomography(places.astype(np.float64), quadrangles.mean(axis=1))[0])
    centers = cv2.perspectiveTransform(every.reshape(1, -1, 2).astype(np.float64), image_from_grid)[0]
    index = np.full(size, -1)
    index[tuple(places.T)] = np.arange(len(places))
    numbered = np.concatenate([centers.reshape(every.shape), index.T[..., None]], axis=-1)
    order = upright(unmirrored(numbered), size[0] == size[1])
    right, down = (np.gradient(order[..., :2], axis=axis).reshape(-1, 2) for axis in (1, 0))
    squares = {}
    for number, square in enumerate(order[..., 2].astype(np.int64).ravel()):
        if square >= 0:
            corners = quadrangles[square]
            on_board = (corners - corners.mean(axis=0)) @ np.linalg.inv(np.stack([right[number], down[number]]))
            squares[number] = np.roll(corners, -int(np.argmin(on_board.sum(axis=1))), axis=0)
    return squares
