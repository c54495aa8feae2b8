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
    square_y_m: float | None = None
    """Height of a chessboard's squares where a printer did not make it their width."""
    marker_m: float | None = None
    gap_m: float | None = None
    spacing_m: float | None = None
    width_m: float | None = None
    height_m: float | None = None
    margin_m: float | None = None
    dictionary: str | None = None
    """Name of one of OpenCV's, or of the file that holds `marker_bits`."""
    marker_bits: tuple[str, ...] = ()
    """Of a dictionary of one's own: each marker's bits row by row, 1 white, without its border."""
    legacy_pattern: bool = False
    order: str | None = None
    """How the markers are numbered, in words for people; nothing reads it."""

    @property
    def square_size_m(self) -> tuple[float, float]:
        """Width and height of a square; zero if the board has none."""
        width_m = self.square_m or 0.0
        return width_m, self.square_y_m or width_m


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardView:
    """The corners of a board that one image shows."""

    name: str
    ids: Int64[Array, "corner"]
    """Number of each corner on the board; for marker boards 4 * marker id + corner."""
    points_board_m: Float64[Array, "corner xyz=3"]
    points_px: Float64[Array, "corner xy=2"]
    likeness: float = 0.0
    """Correlation of the errors that a marker's side has at its two ends, where corners are where sides meet."""
    circle_radius_m: float = 0.0
    """Of circles whose centres these are; zero if that is not known, and of other corners."""
    saturated_share: float = 0.0
    """Of the corners, those with saturated pixels beside them: dark squares and markers look smaller there."""
    marker_size_ratio: tuple[float, float] | None = None
    """Width and height of the markers over `marker_m`, by their distances from one another; None if they tell none."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardPose:
    """Where a board stands: `point_camera = rotation @ point_board + translation_m`."""

    name: str
    rotation: Float64[Array, "3 3"]
    translation_m: Float64[Array, "xyz=3"]
    residual_rms_px: float
