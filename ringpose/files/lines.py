"""Straight lines that somebody drew into a photograph: CSV with x1, y1, x2, y2 in its first four columns."""

import csv
from pathlib import Path

import numpy as np

from ringpose.errors import DataError, NoInputError
from ringpose.files.io import read_bytes
from ringpose.types.arrays import Array, Float64


def read_lines(path: Path, origin_px: float = 0.0) -> Float64[Array, "line end=2 xy=2"]:
    """The lines in our pixels; `origin_px` is what the file calls the centre of the top-left pixel (1 in MATLAB).

    A first row that is no numbers is a heading; further columns are left alone.
    """
    text = read_bytes(path).decode("utf-8", errors="replace")
    rows = []
    for number, cells in enumerate(csv.reader(text.splitlines()), start=1):
        ends = _numbers(cells[:4])
        if ends is not None:
            rows.append(ends)
        elif number > 1 and cells:
            raise DataError(
                f"{path}:{number}", "has no four numbers x1, y1, x2, y2", "one line of the photograph a row"
            )
    if not rows:
        raise DataError(str(path), "holds no line", "write x1, y1, x2, y2 of a line a row")
    lines: Float64[Array, "line end=2 xy=2"] = np.array(rows).reshape(-1, 2, 2) - origin_px
    return lines


def lines_beside(image: Path, truth: Path) -> Path:
    """The file of an image's lines: the truth itself, or in a folder the one of the image's name."""
    file = truth / f"{image.stem}.csv" if truth.is_dir() else truth
    if not file.is_file():
        raise NoInputError(str(file), f"does not exist, but {image} wants its lines", "name the folder with them")
    return file


def _numbers(cells: list[str]) -> list[float] | None:
    """Four finite numbers, or None."""
    try:
        values = [float(cell) for cell in cells]
    except ValueError:
        return None
    return values if len(values) == 4 and np.isfinite(values).all() else None
