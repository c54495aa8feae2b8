"""A calibration board as a target: a print on a flat white sheet, exact at any magnification."""

from typing import Any

import cv2
import numpy as np

from ringpose.calibrate.boards.layout import is_white, marker_corners, outline_m
from ringpose.calibrate.boards.patterns.markers import marker_dictionary
from ringpose.kernels.render import TargetTables
from ringpose.simulate.target.parts import target_tables
from ringpose.types.arrays import Array, Float64, UInt8
from ringpose.types.board import Board
from ringpose.types.target import MATERIALS, Box, Part

BORDER_M = 0.012
"""White margin around the print, which markers at its edge require."""

THICKNESS_M = 0.005


def board_target(board: Board) -> TargetTables:
    """The board of a board file: its print is the plane z = 0 of the board frame, seen from negative z."""
    width_m, height_m = outline_m(board)
    sheet = Part(
        name="board",
        shape=Box(
            low_m=np.array([-BORDER_M, -BORDER_M, 0.0]),
            high_m=np.array([width_m + BORDER_M, height_m + BORDER_M, THICKNESS_M]),
        ),
        materials=(MATERIALS["white"],) * 6,
    )
    tables = target_tables([sheet])
    print_x, print_y, cells = board_print(board)
    black = MATERIALS["black"]
    tables.materials[0, 3:] = [black.diffuse, black.specular, black.roughness, 0.0, 0.0, 0.0, 1.0]
    return tables._replace(print_x=print_x, print_y=print_y, print_cells=cells)


def board_print(
    board: Board,
) -> tuple[Float64[Array, "line_x"], Float64[Array, "line_y"], UInt8[Array, "cell_y cell_x"]]:
    """Lines along x and y at which the print may change, and which of the cells between and outside them are black."""
    width_m, height_m = outline_m(board)
    bits = _marker_bits(board)
    origins_m = marker_corners(board)[:, 0, :2] if len(bits) else np.empty((0, 2))
    bit_m = (board.marker_m or 0.0) / bits.shape[1]
    within_m = bit_m * np.arange(bits.shape[1] + 1)
    lines = [np.append((origins_m[:, [axis]] + within_m).ravel(), [0.0, length_m]) for axis, length_m in
             enumerate((width_m, height_m))]  # fmt: skip
    if board.square_m is not None:
        counts = (board.squares_x or 0, board.squares_y or 0)
        lines = [
            np.append(each, side_m * np.arange(count + 1))
            for each, side_m, count in zip(lines, board.square_size_m, counts, strict=True)
        ]
    print_x, print_y = (np.unique(each.round(12)) for each in lines)
    middle_x, middle_y = ((each[1:] + each[:-1]) / 2 for each in (print_x, print_y))
    black = np.zeros((len(print_y) + 1, len(print_x) + 1), dtype=np.uint8)
    if board.square_m is not None:
        columns, rows = (
            np.floor(middle / side).astype(int)
            for middle, side in zip((middle_x, middle_y), board.square_size_m, strict=True)
        )
        squares = np.array([[not is_white(x, y, board) for x in range(counts[0])] for y in range(counts[1])])
        black[1:-1, 1:-1] = squares[rows[:, None], columns]
    for (x_m, y_m), marker in zip(origins_m, bits, strict=True):
        column, row = ((middle - start) / bit_m for middle, start in ((middle_x, x_m), (middle_y, y_m)))
        across, down = (np.flatnonzero((place > 0) & (place < len(marker))) for place in (column, row))
        pattern = marker[row[down].astype(int)[:, None], column[across].astype(int)]
        black[1 + down[:, None], 1 + across] = 1 - pattern
    return print_x, print_y, black


def _marker_bits(board: Board) -> UInt8[Array, "marker bit_y bit_x"]:
    """Whether each cell of each marker, including its black border, is white."""
    count = 0 if board.marker_m is None else len(marker_corners(board))
    if count == 0:
        return np.zeros((0, 1, 1), dtype=np.uint8)
    aruco: Any = cv2.aruco
    dictionary = marker_dictionary(board)
    size = dictionary.markerSize + 2
    markers = [aruco.generateImageMarker(dictionary, number, size) for number in range(count)]
    return (np.stack(markers) > 127).astype(np.uint8)
