"""Calibration boards, their corners in one image, and their pose.

Board frame: origin at the top-left outer corner, x right, y down, z into the board.
"""

import math
from dataclasses import dataclass, field
from typing import Annotated, Literal

from ringpose.types import plausible
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.plausible import Range
from ringpose.types.record import Key, Presence

MAX_SQUARES = 200
"""Maximum number of squares a side; detecting a larger board, probably a typing error, would take hours."""

BoardKind = Literal[
    "charuco",
    "chessboard",
    "four_markers",
    "aruco_grid",
    "marker_map",
    "aprilgrid",
    "separate_squares",
    "asymmetric_circles",
    "symmetric_circles",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardMarker:
    """A marker at a given place."""

    id: Annotated[int, Key("Its number in the dictionary.", least=0)]
    corners_m: Annotated[
        tuple[tuple[float, float], ...],
        Key(
            "Its four corners, each `[x, y]`, clockwise from its own top left; x is to the right and y down from the "
            "board's corner."
        ),
    ]


def _length(description: str, length: Range) -> Key:
    return Key(description, plausible=length, presence=Presence.IF_KNOWN)


@dataclass(frozen=True, slots=True, kw_only=True)
class Board:
    """Contents of a board file; dimensions that do not apply to its kind are None."""

    kind: Annotated[BoardKind, Key("Kind of the board.")]
    squares_x: Annotated[
        int | None,
        Key("Number of squares, markers or circles in a row.", least=1, most=MAX_SQUARES, presence=Presence.IF_KNOWN),
    ] = None
    squares_y: Annotated[int | None, Key("Number of rows.", least=1, most=MAX_SQUARES, presence=Presence.IF_KNOWN)] = (
        None
    )
    square_m: Annotated[float | None, _length("Width of a square, and its height.", plausible.SQUARE_M)] = None
    square_y_m: Annotated[
        float | None,
        _length("Height of a chessboard's squares where the print made it differ from the width.", plausible.SQUARE_M),
    ] = None
    marker_m: Annotated[float | None, _length("Side of a marker.", plausible.MARKER_M)] = None
    gap_m: Annotated[float | None, _length("Gap between markers or separate squares.", plausible.MARKER_M)] = None
    spacing_m: Annotated[
        float | None,
        _length(
            "Distance of the rows of circles, from centre to centre: of `symmetric_circles` also that of neighbours in "
            "a row, of `asymmetric_circles` half of it.",
            plausible.SQUARE_M,
        ),
    ] = None
    spacing_in_row_m: Annotated[
        float | None,
        _length("Instead of it: distance of neighbours in a row of `asymmetric_circles`.", plausible.SQUARE_M),
    ] = None
    spacing_diagonal_m: Annotated[
        float | None,
        _length(
            "Instead of it: distance of a circle of `asymmetric_circles` from the nearest ones, in the next row.",
            plausible.SQUARE_M,
        ),
    ] = None
    width_m: Annotated[float | None, _length("Width of the board.", plausible.BOARD_M)] = None
    height_m: Annotated[float | None, _length("Height of the board.", plausible.BOARD_M)] = None
    margin_m: Annotated[float | None, _length("Distance of the markers from its border.", plausible.MARGIN_M)] = None
    dictionary: Annotated[
        str | None,
        Key(
            "Name of an OpenCV dictionary, or of a file with the bits of its markers (OpenCV FileStorage).",
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    marker_bits: tuple[str, ...] = ()
    """Custom dictionary: the bits of each marker row by row, 1 for white, without the border."""
    markers: Annotated[tuple[BoardMarker, ...], Key("Markers at given places.", presence=Presence.IF_KNOWN)] = ()
    order: Annotated[
        str | None,
        Key(
            "Numbering of the markers in words; it is not evaluated: those of `four_markers` are numbered clockwise "
            "from the top left.",
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    legacy_pattern: Annotated[
        bool,
        Key("Whether it is a ChArUco board as OpenCV before 4.6 drew it.", presence=Presence.IF_KNOWN),
    ] = False

    @property
    def square_size_m(self) -> tuple[float, float]:
        """Width and height of a square; zero if the board has none."""
        width_m = self.square_m or 0.0
        return width_m, self.square_y_m or width_m

    @property
    def circle_spacing_m(self) -> float:
        """Distance of the rows of circles, by whichever of the three keys gives it; zero if the board has none."""
        if self.spacing_in_row_m is not None:
            return self.spacing_in_row_m / 2
        return self.spacing_m or (self.spacing_diagonal_m or 0.0) / math.sqrt(2)


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


@dataclass(kw_only=True, eq=False)
class BoardViews:
    """The views of a board in the images of one camera, in their order, and the images that show none."""

    views: list[BoardView] = field(default_factory=list)
    without_board: list[tuple[str, str]] = field(default_factory=list)
    """Names of the images that show no board, and the reasons."""
    image_width: int = 0
    image_height: int = 0

    @property
    def images(self) -> int:
        """Number of images in which the board was searched."""
        return len(self.views) + len(self.without_board)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardPose:
    """Pose of a board: `point_camera = rotation @ point_board + translation_m`."""

    name: str
    rotation: Float64[Array, "3 3"]
    translation_m: Float64[Array, "xyz=3"]
    residual_rms_px: float
