"""Calibration boards, their corners in one image, and their pose.

Board frame: origin at the top-left outer corner, x right, y down, z into the board.
"""

from dataclasses import dataclass
from typing import Literal

from ringpose.types.arrays import Array, Float64, Int64

BoardKind = Literal["charuco", "chessboard", "four_markers", "aruco_grid", "asymmetric_circles"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """Contents of a board file; dimensions that do not apply to its kind are None."""

    kind: BoardKind
    squares_x: int | None = None
    squares_y: int | None = None
    square_m: float | None = None
    square_y_m: float | None = None
    """Height of a chessboard's squares where the print made it differ from the width."""
    marker_m: float | None = None
    gap_m: float | None = None
    spacing_m: float | None = None
    width_m: float | None = None
    height_m: float | None = None
    margin_m: float | None = None
    dictionary: str | None = None
    """Name of an OpenCV dictionary, or of the file that contains `marker_bits`."""
    marker_bits: tuple[str, ...] = ()
    """Custom dictionary: the bits of each marker row by row, 1 for white, without the border."""
    legacy_pattern: bool = False
    order: str | None = None
    """Numbering of the markers in words; informative only."""

    @property
    def square_size_m(self) -> tuple[float, float]:
        """Width and height of a square; zero if the board has none."""
        width_m = self.square_m or 0.0
        return width_m, self.square_y_m or width_m


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardView:
    """The corners of a board that were found in one image."""

    name: str
    ids: Int64[Array, "corner"]
    """Number of each corner on the board; for marker boards 4 * marker id + corner."""
    points_board_m: Float64[Array, "corner xyz=3"]
    points_px: Float64[Array, "corner xy=2"]
    end_correlation: float = 0.0
    """Correlation of the errors at the two ends of a marker's side, where corners are intersections of sides."""
    circle_radius_m: float = 0.0
    """Radius of the circles whose centres these are; zero if unknown, and for other corners."""
    saturated_share: float = 0.0
    """Share of the corners with saturated pixels beside them, where dark squares and markers appear smaller."""
    marker_size_ratio: tuple[float, float] | None = None
    """Width and height of the markers over `marker_m`, from their distances; None if not determined."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardPose:
    """Pose of a board: `point_camera = rotation @ point_board + translation_m`."""

    name: str
    rotation: Float64[Array, "3 3"]
    translation_m: Float64[Array, "xyz=3"]
    residual_rms_px: float
