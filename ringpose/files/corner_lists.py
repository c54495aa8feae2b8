"""Corners of a board that another program found: a table (CSV) or JSON lines, one corner a line, instead of images.

The keys, or the columns of the table, are `view`, `id`, `x_px`, `y_px`, and `x_m`, `y_m` unless a board file gives the
places of the corners on the board by their numbers. Pixel (0, 0) is the centre of the image's top-left pixel.
"""

import csv
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.files.inputs import Record, file_lines, inputs
from ringpose.files.schema import Fields
from ringpose.geometry.board import corner_points
from ringpose.types.board import Board, BoardView, BoardViews
from ringpose.types.plausible import BOARD_M

TABLE_SUFFIX, LINES_SUFFIX = ".csv", ".jsonl"

KEYS = ("view", "id", "x_px", "y_px", "x_m", "y_m", "z_m")

MIN_CORNERS = 6
"""Corners that a view must have, as in images: four determine the pose, six allow a check of the residuals."""


def is_corner_list(name: str) -> bool:
    """Whether the name of an input is that of a list of corners."""
    return name.lower().endswith((TABLE_SUFFIX, LINES_SUFFIX))


def read_corner_lists(paths: Sequence[Path], board: Board | None, size_px: tuple[int, int]) -> BoardViews:
    """The views of one camera in lists of corners, in the order in which they begin; `size_px` is the images' size.

    The places of the corners on the board are those of the board, or without one those in the lists.
    """
    points_m: dict[int, tuple[float, ...]] = {}
    if board is not None:
        points_m = dict(enumerate(map(tuple, corner_points(board).tolist())))
    listed: dict[str, dict[int, tuple[float, float]]] = {}
    for path in paths:
        for corner in _rows(path) if path.name.lower().endswith(TABLE_SUFFIX) else _records(path):
            name, number = str(corner.raw("view")), corner.integer("id", least=0)
            point_m = _point_m(corner, number, points_m, board)
            if points_m.setdefault(number, point_m) != point_m:
                x_m, y_m, _ = points_m[number]
                raise corner.problem(
                    "id", f"is {number}, which was at {x_m:g}, {y_m:g} m before", "correct one of them"
                )
            if number in listed.setdefault(name, {}):
                raise corner.problem("id", f"is {number}, which view {name} has already", "give each corner once")
            listed[name][number] = _position_px(corner, size_px)
    views = BoardViews(image_width=size_px[0], image_height=size_px[1])
    for name, corners in listed.items():
        view = BoardView(
            name=name,
            ids=np.array(list(corners), dtype=np.int64),
            points_board_m=np.array([points_m[number] for number in corners]),
            points_px=np.array(list(corners.values())),
        )
        reason = _unusable(view)
        if reason:
            views.without_board.append((name, reason))
        else:
            views.views.append(view)
    return views


def _point_m(
    corner: Fields, number: int, points_m: Mapping[int, tuple[float, ...]], board: Board | None
) -> tuple[float, ...]:
    """The place of a corner on the board."""
    has_place = corner.has("x_m") or corner.has("y_m")
    if board is None:
        if not has_place:
            raise corner.problem("", "has no place on the board, x_m and y_m", "add them, or give --board")
        if corner.number("z_m", missing=0.0):
            raise corner.problem("z_m", f"is {corner.number('z_m'):g}, must be 0", "give corners in one plane")
        return corner.quantity("x_m", _PLACE_M), corner.quantity("y_m", _PLACE_M), 0.0
    if has_place:
        raise corner.problem("x_m", "is given, and so is --board", "leave out one of them")
    if number not in points_m:
        raise corner.problem(
            "id", f"is {number}, the board has 0 to {len(points_m) - 1}", "number them as the manual does"
        )
    return points_m[number]


def _position_px(corner: Fields, size_px: tuple[int, int]) -> tuple[float, float]:
    """The position of a corner in the image, which must be inside."""
    position_px = (corner.number("x_px"), corner.number("y_px"))
    for key, value, size in zip(("x_px", "y_px"), position_px, size_px, strict=True):
        if not -0.5 <= value <= size - 0.5:
            finding = f"is {value:g}, outside of images of {size_px[0]} x {size_px[1]} pixels"
            raise corner.problem(key, finding, "correct --image-size, or exchange x and y")
    return position_px


_PLACE_M = replace(BOARD_M, lowest=-BOARD_M.highest)


def _records(path: Path) -> Iterator[Fields]:
    """The JSON lines of a file."""
    for record in inputs([path], (LINES_SUFFIX,)):
        if isinstance(record, Record):
            yield Fields(record.location, record.values, KEYS)
        elif isinstance(record, Exception):
            raise record


def _rows(path: Path) -> Iterator[Fields]:
    """The rows of a table with a line of column names; commas, semicolons or tabs are between the columns."""
    lines = [line.decode("utf-8-sig", "replace") for line in file_lines(path)]
    separator = max(",;\t", key=lines[0].count) if lines else ","
    names = [name.strip() for name in next(csv.reader(lines[:1], delimiter=separator), [])]
    if missing := [name for name in KEYS[:4] if name not in names]:
        finding = f"has no column {missing[0]} in its first line"
        raise DataError(f"{path}:1", finding, f"begin with the columns' names: {','.join(KEYS)}")
    for number, cells in enumerate(csv.reader(lines[1:], delimiter=separator), start=2):
        if cells and any(cell.strip() for cell in cells):
            values = dict(zip(names, (cell.strip() for cell in cells), strict=False))
            row = {key: value if key == "view" else _parsed(value) for key, value in values.items() if value}
            yield Fields(f"{path}:{number}", row, KEYS)
    if len(lines) < 2:
        raise DataError(str(path), "has no corner", "give one a line below the columns' names")


def _parsed(text: str) -> Any:
    for number in (int, float):
        try:
            return number(text)
        except ValueError:
            continue
    return text


def _unusable(view: BoardView) -> str:
    """Why a view's corners determine no pose; empty if they do."""
    if len(view.ids) < MIN_CORNERS:
        return f"{len(view.ids)} corners, {MIN_CORNERS} are needed"
    spread = np.linalg.svd(view.points_board_m[:, :2] - view.points_board_m[:, :2].mean(axis=0), compute_uv=False)
    return "its corners lie on one line" if spread[1] < 1e-6 * spread[0] else ""
