"""Board files (kind and sizes in metres), and dictionaries of markers (OpenCV FileStorage)."""

from dataclasses import replace
from pathlib import Path
from typing import Any, cast, get_args

from ringpose.errors import DataError
from ringpose.files import atomic
from ringpose.files.cameras.opencv import storage_values
from ringpose.files.io import read_bytes
from ringpose.files.schema import Fields
from ringpose.files.yaml import read_yaml, write_yaml
from ringpose.geometry.board import marker_dictionary
from ringpose.types.board import Board, BoardKind
from ringpose.types.plausible import BOARD_M, MARGIN_M, MARKER_M, SQUARE_M

_COUNTS = ("squares_x", "squares_y")

_LENGTHS = {
    "square_m": SQUARE_M,
    "square_y_m": SQUARE_M,
    "marker_m": MARKER_M,
    "gap_m": MARKER_M,
    "spacing_m": SQUARE_M,
    "width_m": BOARD_M,
    "height_m": BOARD_M,
    "margin_m": MARGIN_M,
}
"""The lengths on a board with their plausible ranges."""

_KEYS = ("ringpose", "kind", *_COUNTS, *_LENGTHS, "dictionary", "legacy_pattern", "order")

REQUIRED = {
    "charuco": ("squares_x", "squares_y", "square_m", "marker_m", "dictionary"),
    "chessboard": ("squares_x", "squares_y", "square_m"),
    "four_markers": ("width_m", "height_m", "marker_m", "margin_m", "dictionary"),
    "aruco_grid": ("squares_x", "squares_y", "marker_m", "gap_m", "dictionary"),
    "asymmetric_circles": ("squares_x", "squares_y", "spacing_m"),
}
"""Required keys of each kind of board."""

MIN_COUNT = {"charuco": 2, "chessboard": 4, "four_markers": 1, "aruco_grid": 1, "asymmetric_circles": 2}
"""Minimum number of squares, markers or circles a side."""

MAX_SQUARES = 200
"""Maximum number of squares a side; detecting a larger board, probably a typing error, would take hours."""


def read_board(path: Path) -> Board:
    """The board in a board file, including the markers of its dictionary file, if it names one."""
    board = board_of(read_yaml(path, _KEYS))
    if board.dictionary is None:
        return board
    file = path.parent / board.dictionary
    if not board.dictionary.startswith(OPENCV_PREFIX) and file.exists():
        board = replace(board, marker_bits=read_dictionary(file))
    try:
        marker_dictionary(board)
    except DataError as error:
        raise DataError(f"{path}: dictionary", error.found, error.remedy) from error
    return board


def board_of(fields: Fields) -> Board:
    """The board in a mapping of a board file or scene."""
    kind = fields.choice("kind", get_args(BoardKind))
    for key in REQUIRED[kind]:
        fields.raw(key)
    if fields.has("ringpose"):
        fields.choice("ringpose", ("board/1",))
    sizes: dict[str, Any] = fields.given(
        _COUNTS, lambda key: fields.integer(key, least=MIN_COUNT[kind], most=MAX_SQUARES)
    )
    sizes |= fields.given(_LENGTHS, lambda key: fields.quantity(key, _LENGTHS[key]))
    sizes |= fields.given(("dictionary", "order"), fields.text)
    sizes |= fields.given(("legacy_pattern",), fields.boolean)
    _check_fit(fields, sizes)
    return Board(kind=cast(BoardKind, kind), **sizes)


def write_board(path: Path, board: Board, *, force: bool = False) -> None:
    """Write a board file."""
    values = {key: getattr(board, key) for key in _KEYS if key not in ("ringpose", "legacy_pattern")}
    if board.legacy_pattern:
        values["legacy_pattern"] = True
    with atomic.replacing(path, force) as stream:
        write_yaml(stream, {key: value for key, value in values.items() if value is not None})


def _check_fit(fields: Fields, sizes: dict[str, Any]) -> None:
    if "square_y_m" in sizes and fields.text("kind") != "chessboard":
        raise fields.problem("square_y_m", "is allowed only for a chessboard: markers are square")
    if "square_m" in sizes and sizes.get("marker_m", 0) >= sizes["square_m"]:
        raise fields.problem("marker_m", f"is {sizes['marker_m']:g}, must be smaller than square_m")
    if "width_m" in sizes and "height_m" in sizes:
        occupied = 2 * (sizes.get("marker_m", 0) + sizes.get("margin_m", 0))
        if occupied > min(sizes["width_m"], sizes["height_m"]):
            raise fields.problem("marker_m", "two markers and their margins are wider than the board")


OPENCV_PREFIX = "DICT_"
"""Prefix of OpenCV's predefined dictionaries; any other name is the name of a file."""

MAX_MARKERS = 1024
"""Number of markers in OpenCV's largest dictionary."""


def read_dictionary(path: Path) -> tuple[str, ...]:
    """The bits of each marker, row by row, as texts of 0 and 1."""
    fields = Fields(str(path), storage_values(read_bytes(path), str(path)))
    side = fields.integer("markersize", least=3, most=10)
    count = fields.integer("nmarkers", least=1, most=MAX_MARKERS)
    markers = {key: fields.text(key) for key in (f"marker_{number}" for number in range(count))}
    for key, bits in markers.items():
        if set(bits) - {"0", "1"} or len(bits) != side**2:
            raise fields.problem(key, f"must be {side} x {side} digits 0 or 1")
    return tuple(markers.values())
