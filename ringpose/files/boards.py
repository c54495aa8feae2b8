"""Board files (kind and sizes in metres), and dictionaries of markers (OpenCV FileStorage)."""

from dataclasses import replace
from pathlib import Path
from typing import get_args

from ringpose.errors import DataError
from ringpose.files import atomic
from ringpose.files.cameras.opencv import storage_values
from ringpose.files.io import read_bytes
from ringpose.files.records.codec import Context, RecordType, definition_of
from ringpose.files.schema import BOARD, Fields
from ringpose.files.yaml import read_yaml, write_yaml
from ringpose.geometry.board import marker_dictionary
from ringpose.types.board import MAX_SQUARES, Board, BoardKind

RECORD = RecordType(
    cls=Board,
    kind=BOARD,
    description="A calibration board: its kind and its sizes in metres. Your own keys begin with x_.",
    is_file=True,
    strict=True,
)

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


def read_board(path: Path) -> Board:
    """The board in a board file, including the markers of its dictionary file, if it names one."""
    board = board_of(read_yaml(path, RECORD.keys))
    if board.dictionary is None:
        return board
    file = path.parent / board.dictionary
    if not board.dictionary.startswith(OPENCV_PREFIX) and file.exists():
        board = replace(board, marker_bits=read_dictionary(file))
    try:
        marker_dictionary(board)
    except DataError as error:
        raise DataError(f"{path}: dictionary", error.finding, error.remedy) from error
    return board


def board_of(fields: Fields) -> Board:
    """The board in a mapping of a board file or scene."""
    kind = fields.choice("kind", get_args(BoardKind))
    for key in REQUIRED[kind]:
        fields.raw(key)
    if fields.has("ringpose"):
        fields.choice("ringpose", ("board/1",))
    for key in ("squares_x", "squares_y"):
        fields.optional(key, lambda key: fields.integer(key, least=MIN_COUNT[kind], most=MAX_SQUARES))
    board = definition_of(Board).read(fields, Context())
    _check_fit(fields, board)
    return board


def write_board(path: Path, board: Board, *, force: bool = False) -> None:
    """Write a board file."""
    with atomic.replacing(path, force) as stream:
        write_yaml(stream, RECORD.write(board))


def _check_fit(fields: Fields, board: Board) -> None:
    marker_m = board.marker_m or 0.0
    if board.square_y_m is not None and board.kind != "chessboard":
        raise fields.problem("square_y_m", "is allowed only for a chessboard: markers are square")
    if board.square_m is not None and marker_m >= board.square_m:
        raise fields.problem("marker_m", f"is {marker_m:g}, must be smaller than square_m")
    if board.width_m is not None and board.height_m is not None:
        occupied = 2 * (marker_m + (board.margin_m or 0.0))
        if occupied > min(board.width_m, board.height_m):
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
