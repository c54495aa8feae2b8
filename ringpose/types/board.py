"""Calibration boards and what one image shows of one.

Board frame: origin at the top-left outer corner, x right, y down, z into the board.
"""

from dataclasses import dataclass
from typing import Literal

from ringpose.types.arrays import Array, Float64, Int64

BoardKind = Literal["charuco", "chessboard", "four_markers", "aruco_grid", "asymmetric_circles"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """A board file as read; a size that its kind does not have is None."""

    kind: BoardKind
    squares_x: int | None = None
    squares_y: int | None = None
    square_m: float | None = None
    marker_m: float | None = None
    gap_m: float | None = None
    spacing_m: float | None = None
    width_m: float | None = None
    height_m: float | None = None
    margin_m: float | None = None
    dictionary: str | None = None
    legacy_pattern: bool = False
    order: str | None = None
    """How the markers are numbered, in words for people; nothing reads it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardView:
    """The corners of a board that one image shows."""

    name: str
    ids: Int64[Array, "corner"]
    """Number of each corner on the board; for marker boards 4 * marker id + corner."""
    points_board_m: Float64[Array, "corner xyz=3"]
    points_px: Float64[Array, "corner xy=2"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardPose:
    """Where a board stands: `point_camera = rotation @ point_board + translation_m`."""

    name: str
    rotation: Float64[Array, "3 3"]
    translation_m: Float64[Array, "xyz=3"]
    residual_rms_px: float
