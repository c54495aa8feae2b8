"""How far a chessboard goes on beyond the corners that were found, and whether it leaves the image there."""

from dataclasses import dataclass

import cv2
import numpy as np

from ringpose.types.arrays import Array, Bool, Float64, UInt8

GOES_ON = 0.5
"""Median contrast of neighbouring squares, over that of the squares found, above which a row is the board's ..."""

SURELY = 0.8
"""... and how near to 1 it is where the board goes on behind something:"""

COVERED_ROWS = 2
"""so many rows may be covered."""

_MOST_ROWS = 20
_SMOOTHING = 0.15
"""Of a square's side."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Extent:
    """Squares along the rows and along the columns of the corners found."""

    squares: tuple[int, int]
    cut: tuple[bool, bool]
    """Whether the image ends before the board is seen to end."""
    pierced: bool
    """Whether the image's rim goes through the squares beside corners that are found."""
    whole: bool
    """Whether the corners of all these squares are found."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Side:
    squares: int
    """Rows of squares beyond the last corners."""
    cut: bool
    """Whether the image ends before the board is seen to end ..."""
    pierced: bool
    """... in the first of them."""


def chessboard_extent(
    image: UInt8[Array, "row column"], grid: Float64[Array, "corner_row corner_column xy=2"]
) -> Extent:
    """The squares that the image shows along the lattice of the corners found, whether or not their corners are."""
    side_px = float(np.linalg.norm(np.diff(grid, axis=1), axis=-1).min())
    smooth = cv2.GaussianBlur(image, (0, 0), max(_SMOOTHING * side_px, 0.5)).astype(np.float64)
    down = grid.swapaxes(0, 1)
    sides = [_side(smooth, turned) for turned in (grid[:, ::-1], grid, down[:, ::-1], down)]
    rows, columns = grid.shape[:2]
    return Extent(
        squares=(columns - 1 + sides[0].squares + sides[1].squares, rows - 1 + sides[2].squares + sides[3].squares),
        cut=(sides[0].cut or sides[1].cut, sides[2].cut or sides[3].cut),
        pierced=any(side.pierced for side in sides),
        whole=all(side.squares == 1 for side in sides),
    )


def _side(smooth: Float64[Array, "row column"], grid: Float64[Array, "corner_row corner_column xy=2"]) -> _Side:
    """What comes after the last column of corners."""
    rows, columns = grid.shape[:2]
    lattice = np.stack(np.meshgrid(np.arange(columns), np.arange(rows)), axis=-1).reshape(-1, 2).astype(np.float64)
    homography = np.asarray(cv2.findHomography(lattice, grid.reshape(-1, 2))[0], dtype=np.float64)
    own = [_contrast(smooth, homography, column, rows) for column in range(columns - 1)]
    sign = np.sign(own[-1]) / max(float(np.median(np.abs(own))), 1.0)
    first = columns - 1
    outside = (row for row in range(_MOST_ROWS) if not _inside(smooth.shape, homography, first + row, rows))
    inside = next(outside, _MOST_ROWS)
    last = 0  # the last corners are corners of a first row, whatever it looks like
    for row in range(1, inside):
        step = sign * (-1) ** (row + 1) * _contrast(smooth, homography, first + row, rows)
        if (step > GOES_ON and row == last + 1) or (SURELY < step < 1 / SURELY and row <= last + 1 + COVERED_ROWS):
            last = row
    return _Side(squares=last + 1, cut=inside <= last + 1, pierced=inside == 0)


def _contrast(
    smooth: Float64[Array, "row column"],
    homography: Float64[Array, "3 3"],
    column: int,
    rows: int,
) -> float:
    """Median step from a square of a column to the next, the sign turned for every other one."""
    across = np.arange(rows - 1)
    centres = np.stack([np.full(len(across), column + 0.5), across + 0.5], axis=-1)
    x, y = np.rint(cv2.perspectiveTransform(centres[None], homography)[0]).astype(np.int64).T
    grey = smooth[np.clip(y, 0, smooth.shape[0] - 1), np.clip(x, 0, smooth.shape[1] - 1)]
    return float(np.median((grey[:-1] - grey[1:]) * (-1.0) ** across[:-1]))


def _inside(shape: tuple[int, ...], homography: Float64[Array, "3 3"], column: int, rows: int) -> bool:
    """Whether the outer corners of a column of squares are in the image."""
    corners = np.stack([np.full(rows, column + 1.0), np.arange(rows, dtype=np.float64)], axis=-1)
    places = cv2.perspectiveTransform(corners[None], homography)[0]
    inside: Bool[Array, "n xy=2"] = (places > 0) & (places < np.array([shape[1] - 1, shape[0] - 1]))
    return bool(inside.all())
