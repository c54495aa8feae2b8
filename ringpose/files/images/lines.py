"""Annotated straight lines of a photograph: CSV with x1, y1, x2, y2 in the first four columns."""

import csv
from pathlib import Path

import numpy as np

from ringpose.errors import DataError, NoInputError
from ringpose.files.io import read_bytes
from ringpose.types.arrays import Array, Float64


def read_lines(path: Path, origin_px: float = 0.0) -> Float64[Array, "line end=2 xy=2"]:
    """End points in pixels; `origin_px` is the file's coordinate of the centre of the top-left pixel (1 in MATLAB).

    A first row without numbers is taken as a heading; further columns are ignored.
    """
    text = read_bytes(path).decode("utf-8", errors="replace")
    rows = []
    for number, cells in enumerate(csv.reader(text.splitlines()), start=1):
        ends = _numbers(cells[:4])
        if ends is not None:
            rows.append(ends)
        elif number > 1 and cells:
            raise DataError(
                f"{path}:{number}",
                "must have four numbers x1, y1, x2, y2",
                "write one line of the photograph a row",
            )
    if not rows:
        raise DataError(str(path), "has no line", "write x1, y1, x2, y2 of a line a row")
    lines: Float64[Array, "line end=2 xy=2"] = np.array(rows).reshape(-1, 2, 2) - origin_px
    return lines


def annotation_path(image: Path, truth: Path) -> Path:
    """Path of an image's annotation: `truth` itself, or if it is a folder, the file with the image's name in it."""
    file = truth / f"{image.stem}.csv" if truth.is_dir() else truth
    if not file.is_file():
        raise NoInputError(str(file), f"does not exist, must have the lines of {image}", "give their folder")
    return file


def _numbers(cells: list[str]) -> list[float] | None:
    """The cells as four finite numbers, or None if they are not."""
    try:
        values = [float(cell) for cell in cells]
    except ValueError:
        return None
    return values if len(values) == 4 and np.isfinite(values).all() else None
