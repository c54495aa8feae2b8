"""Board files (kind and sizes in metres), and dictionaries of markers (OpenCV FileStorage)."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.files import atomic
from ringpose.files.cameras.opencv import storage_values
from ringpose.files.io import read_bytes
from ringpose.files.records.codec import Context, RecordType, definition_of
from ringpose.files.schema import BOARD, Fields
from ringpose.files.yaml import read_yaml, write_yaml
from ringpose.geometry.board import LAYOUTS, marker_dictionary
from ringpose.types.board import MAX_SQUARES, Board
from ringpose.types.plausible import BOARD_M, MARKER_M

RECORD = RecordType(
    cls=Board,
    kind=BOARD,
    description="A calibration board: its kind and its sizes in metres. Your own keys begin with x_.",
    is_file=True,
    strict=True,
)


def read_board(path: Path) -> Board:
    """The board in a board file, including the markers of its dictionary file, if it names one."""
    fields = read_yaml(path)
    if fields.has("target_type"):
        fields = _native(fields)
    fields.reject_unknown(RECORD.keys)
    board = board_of(fields)
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


KALIBR_KEYS = ("target_type", "tagCols", "tagRows", "tagSize", "tagSpacing", "codeOffset")


def _native(fields: Fields) -> Fields:
    """The keys of a target of Kalibr as those of a board file; `tagSpacing` is the gap in sides of a marker."""
    _reject_other_target(fields)
    fields.reject_unknown(KALIBR_KEYS)
    if fields.choice("target_type", ("aprilgrid",)) and fields.number("codeOffset", missing=0.0):
        raise fields.problem("codeOffset", f"is {fields.values['codeOffset']}, must be 0", "give a board from marker 0")
    side_m = fields.quantity("tagSize", MARKER_M)
    values = {
        "kind": "aprilgrid",
        "squares_x": fields.integer("tagCols", least=1, most=MAX_SQUARES),
        "squares_y": fields.integer("tagRows", least=1, most=MAX_SQUARES),
        "marker_m": side_m,
        "gap_m": side_m * fields.number("tagSpacing", least=0.01, most=1),
        "dictionary": "DICT_APRILTAG_36h11",
    }
    return Fields(fields.file, values, RECORD.keys)


def _reject_other_target(fields: Fields) -> None:
    """Name the board file to write for a target of Kalibr that is a checkerboard or has circles."""
    target = fields.values["target_type"]
    if target == "checkerboard":
        remedy = (
            "write a board file of kind: chessboard; squares_x and squares_y are targetCols and targetRows plus 1, "
            "square_m is colSpacingMeters, square_y_m rowSpacingMeters"
        )
        raise fields.problem("target_type", f"is {target!r}, only 'aprilgrid' is read", remedy)
    if target == "circlegrid":
        remedy = (
            "write a board file of kind: symmetric_circles or asymmetric_circles; squares_x and squares_y are "
            "targetCols and targetRows, and measure the spacing"
        )
        raise fields.problem("target_type", f"is {target!r}, only 'aprilgrid' is read", remedy)


def board_of(fields: Fields) -> Board:
    """The board in a mapping of a board file or scene."""
    kind: Any = fields.choice("kind", LAYOUTS)
    layout = LAYOUTS[kind]
    for alternatives in layout.keys:
        given = list(filter(fields.has, alternatives))
        if len(given) > 1:
            raise fields.problem(given[1], f"is given beside {given[0]}", "give the one that you have measured")
        if not given and len(alternatives) > 1 and not fields.missing(alternatives[0]).remedy:
            finding = f"has no key {', '.join(map(repr, alternatives[:-1]))} or {alternatives[-1]!r}"
            raise fields.problem("", finding, "give the one that you have measured")
        fields.raw(given[0] if given else alternatives[0])
    if fields.has("ringpose"):
        fields.choice("ringpose", ("board/1",))
    for key in ("squares_x", "squares_y"):
        fields.optional(key, lambda key: fields.integer(key, least=layout.min_count, most=MAX_SQUARES))
    board = definition_of(Board).read(fields, Context())
    _check_fit(fields, board)
    return board


def write_board(path: Path, board: Board, *, force: bool = False) -> None:
    """Write a board file."""
    with atomic.replacing(path, force) as stream:
        write_yaml(stream, RECORD.write(board))


def _check_fit(fields: Fields, board: Board) -> None:
    own, every = (
        {key for layout in layouts for keys in (*layout.keys, layout.optional) for key in keys}
        for layouts in ([LAYOUTS[board.kind]], LAYOUTS.values())
    )
    for key in filter(fields.has, sorted(every - own)):
        raise fields.problem(key, f"does not belong to a board of the kind {board.kind}", "leave it out")
    _check_markers(fields, board)
    marker_m = board.marker_m or 0.0
    if board.square_m is not None and marker_m >= board.square_m:
        raise fields.problem("marker_m", f"is {marker_m:g}, must be smaller than square_m")
    if board.width_m is not None and board.height_m is not None:
        occupied = 2 * (marker_m + (board.margin_m or 0.0))
        if occupied > min(board.width_m, board.height_m):
            raise fields.problem("marker_m", "two markers and their margins are wider than the board")


def _check_markers(fields: Fields, board: Board) -> None:
    """Reject given markers that are no quadrangles on the board, clockwise and each with a number of its own."""
    if not board.markers and fields.has("markers"):
        raise fields.problem("markers", "is empty", "give the number and the corners of each marker")
    for place, marker in enumerate(board.markers):
        key = f"markers[{place}].corners_m"
        if len(marker.corners_m) != 4:
            raise fields.problem(key, f"has {len(marker.corners_m)} corners, must have 4")
        corners_m = np.array(marker.corners_m)
        if corners_m.min() < 0 or not BOARD_M.holds(float(corners_m.max())):
            remedy = "give metres from the board's upper left corner, x to the right and y down"
            raise fields.problem(key, f"has coordinates from {corners_m.min():g} to {corners_m.max():g}", remedy)
        sides_m = np.roll(corners_m, -1, axis=0) - corners_m
        turns = sides_m[:, 0] * np.roll(sides_m, -1, axis=0)[:, 1] - sides_m[:, 1] * np.roll(sides_m, -1, axis=0)[:, 0]
        if not (turns > 0).all():
            raise fields.problem(key, "are not the corners of a square in clockwise order", "x is right and y down")
        if marker.id in [other.id for other in board.markers[:place]]:
            raise fields.problem(f"markers[{place}].id", f"is {marker.id}, which another marker has", "give it once")


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
