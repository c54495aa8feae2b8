"""A calibration board as a target: a print on a flat white sheet, exact at any magnification."""

import numpy as np

from ringpose.geometry.board import board_print, outline_m
from ringpose.kernels.render import TargetTables
from ringpose.simulate.target.parts import target_tables
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
