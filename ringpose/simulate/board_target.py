"""A calibration board as a target: a print on a flat white sheet, exact at any magnification."""

from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np

from ringpose.calibrate.boards.layout import is_white, marker_corners, outline_m
from ringpose.calibrate.boards.markers import marker_dictionary
from ringpose.simulate.target import EMPTY, Hits, Numbers, Vectors
from ringpose.types.arrays import Array, Bool, Float64, Int8, UInt8
from ringpose.types.board import Board
from ringpose.types.scene import MATERIALS, Material

BORDER_M = 0.012
"""White margin around the print, which markers at its edge require."""

_BLACK, _WHITE = 0, 1
"""Surface numbers."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardTarget:
    """The plane z = 0 of the board frame, black or white; the camera is where z is negative."""

    board: Board
    outline_m: tuple[float, float]
    squares: UInt8[Array, "row column"] | None
    """Whether each square is white; None for boards of markers alone."""
    edges_x_m: Float64[Array, "edge_x"]
    """Positions along x at which markers begin or end, ascending."""
    edges_y_m: Float64[Array, "edge_y"]
    cells: Int8[Array, "cell_y cell_x"]
    """Marker number between two neighbouring edges along x and y, or -1."""
    bits: UInt8[Array, "marker bit_y bit_x"]
    """Whether each cell of each marker, including its black border, is white."""
    origins_m: Float64[Array, "marker xy=2"]
    materials: tuple[Material, ...] = (MATERIALS["black"], MATERIALS["white"])
    relief_m: float = 0.0

    def first_hits(self, eye: Float64[Array, "xyz=3"], direction: Vectors) -> Hits:
        """See `Target`."""
        with np.errstate(divide="ignore", invalid="ignore"):
            parameter = -eye[2] / direction[2]
            x, y = eye[0] + parameter * direction[0], eye[1] + parameter * direction[1]
        width_m, height_m = self.outline_m
        on_sheet = (x > -BORDER_M) & (x < width_m + BORDER_M) & (y > -BORDER_M) & (y < height_m + BORDER_M)
        hit = (parameter > 0) & on_sheet
        surface = np.full(len(x), EMPTY, dtype=np.int8)
        surface[hit] = self.print_at(x[hit], y[hit])
        return np.where(hit, parameter, np.inf), surface

    def on_relief(
        self, eye: Float64[Array, "xyz=3"], direction: Vectors, parameter: Float64[Array, "ray"], surface: Numbers
    ) -> tuple[Vectors, Vectors]:
        """See `Target`."""
        point = eye[:, None] + parameter * direction
        normal = np.zeros_like(point)
        normal[2] = -np.sign(direction[2])
        return point, normal

    def blocked(self, point: Vectors, towards: Vectors) -> Bool[Array, "ray"]:
        """See `Target`; a plane does not occlude itself."""
        return np.zeros(point.shape[1], dtype=np.bool_)

    def print_at(self, x_m: Float64[Array, "n"], y_m: Float64[Array, "n"]) -> Int8[Array, "n"]:
        """Black or white at points of the sheet."""
        colour = np.full(len(x_m), _WHITE, dtype=np.int8)
        if self.squares is not None:
            width_m, height_m = self.board.square_size_m
            column, row = np.floor(x_m / width_m).astype(int), np.floor(y_m / height_m).astype(int)
            rows, columns = self.squares.shape
            inside = np.flatnonzero((column >= 0) & (column < columns) & (row >= 0) & (row < rows))
            colour[inside] = self.squares[row[inside], column[inside]]
        if len(self.bits):
            columns = np.searchsorted(self.edges_x_m, x_m, side="right")
            marker = self.cells[np.searchsorted(self.edges_y_m, y_m, side="right"), columns]
            found = np.flatnonzero(marker >= 0)
            marker = marker[found]
            bits = self.bits.shape[1]
            bit = (np.stack([x_m[found], y_m[found]]) - self.origins_m[marker].T) / (
                (self.board.marker_m or 1.0) / bits
            )
            bit_x, bit_y = bit.astype(int).clip(0, bits - 1)
            colour[found] = self.bits[marker, bit_y, bit_x]
        return colour


def board_target(board: Board) -> BoardTarget:
    """The board of a board file."""
    origins_m = marker_corners(board)[:, 0, :2]
    ends_m = origins_m + (board.marker_m or 0.0)
    edges_x_m, edges_y_m = (np.unique(np.stack([origins_m, ends_m])[..., axis].round(9)) for axis in (0, 1))
    cells = np.full((len(edges_y_m) + 1, len(edges_x_m) + 1), -1, dtype=np.int8)
    for number, (begin, end) in enumerate(zip(origins_m, ends_m, strict=True)):
        within_x = slice(*np.searchsorted(edges_x_m, [begin[0] + 1e-8, end[0] + 1e-8]))
        within_y = slice(*np.searchsorted(edges_y_m, [begin[1] + 1e-8, end[1] + 1e-8]))
        cells[within_y, within_x] = number
    squares = None
    if board.square_m is not None:
        rows, columns = range(board.squares_y or 0), range(board.squares_x or 0)
        squares = np.array([[is_white(x, y, board) for x in columns] for y in rows], dtype=np.uint8)
    return BoardTarget(
        board=board,
        outline_m=outline_m(board),
        squares=squares,
        edges_x_m=edges_x_m,
        edges_y_m=edges_y_m,
        cells=cells,
        bits=_marker_bits(board, len(origins_m)),
        origins_m=origins_m,
    )


def _marker_bits(board: Board, count: int) -> UInt8[Array, "marker bit_y bit_x"]:
    if count == 0:
        return np.zeros((0, 1, 1), dtype=np.uint8)
    aruco: Any = cv2.aruco
    dictionary = marker_dictionary(board)
    size = dictionary.markerSize + 2
    markers = [aruco.generateImageMarker(dictionary, number, size) for number in range(count)]
    return (np.stack(markers) > 127).astype(np.uint8)
