"""Why a grid of circles is not found: how many are seen, and in which rows they lie."""

from dataclasses import replace
from typing import Any

import cv2
import numpy as np

from ringpose.calibrate.board_failures import (
    BLURRED_PX,
    BoardFailure,
    NoBoard,
    edge_width_in_words,
    edge_width_px,
)
from ringpose.calibrate.board_points import corner_points
from ringpose.calibrate.circle_centers import brightened, circle_middles
from ringpose.types.arrays import Array, Float64, UInt8
from ringpose.types.board import Board

SMALLEST_GRID = 2
"""Circles along a side of the grids that are tried."""

LARGEST_MISFIT = 0.2
"""Of circles in the places of another grid, rms in spacings: a lens bends less, wrong rows lie a half or more aside."""


def circle_failure(grey: UInt8[Array, "row column"], board: Board) -> NoBoard:
    """The reason, with the number of circles that are seen."""
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
    """Middles of the dark round spots, the same ones that OpenCV's finder of grids begins with."""
    spots = cv2.SimpleBlobDetector.create().detect(brightened(grey))
    return np.array([spot.pt for spot in spots], dtype=np.float64).reshape(-1, 2)


def _other_grid(grey: UInt8[Array, "row column"], board: Board, number: int) -> tuple[int, int] | None:
    """Columns and rows of a grid of so many circles that the image shows; None if there is none."""
    for columns in range(SMALLEST_GRID, number // SMALLEST_GRID + 1):
        rows, left = divmod(number, columns)
        if left or (columns, rows) == (board.squares_x, board.squares_y):
            continue
        middles_px = circle_middles(grey, columns, rows)
        if middles_px is not None and _lie_as_on(middles_px, replace(board, squares_x=columns, squares_y=rows)):
            return columns, rows
    return None


def _lie_as_on(middles_px: Float64[Array, "circle xy=2"], board: Board) -> bool:
    """Whether circles lie in the places of a board, seen in perspective."""
    places = corner_points(board)[:, :2]
    homography: Any = cv2.findHomography(middles_px, places)[0]
    if homography is None:
        return False
    mapped = cv2.perspectiveTransform(middles_px.reshape(1, -1, 2), homography).reshape(-1, 2)
    return bool(np.sqrt(np.mean(np.sum((mapped - places) ** 2, axis=1))) < LARGEST_MISFIT * (board.spacing_m or 1.0))
