"""Cameras that ROS prints or writes: CameraInfo messages, and the INI file of its calibrator camera_calibration."""

import re
from collections.abc import Mapping
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.files.cameras.opencv import number_or_text
from ringpose.files.cameras.ros import MAX_PIXELS
from ringpose.files.schema import Fields
from ringpose.types.arrays import Array, Float64

_SECTION = re.compile(r"^\[(\w+)\][ \t\r]*$", re.MULTILINE)

INI_SECTION = re.compile(rb"^\[image\][ \t\r]*$", re.MULTILINE)
"""First section of the INI file (`oST version 5.0`), which the calibrator also prints."""


_READOUT = ("binning_x", "binning_y", "roi")
"""Keys of the region of interest and the binning with which images are read out."""


def message_values(values: Mapping[str, Any], file: str) -> dict[str, Any]:
    """The keys of a camera_info file for a message."""
    message = Fields(file, {str(key).lower(): value for key, value in values.items()})
    matrix, coefficients = message.array("k", (9,)), message.array("d", (None,))
    return {
        "image_width": message.integer("width", least=1),
        "image_height": message.integer("height", least=1),
        "distortion_model": message.values.get("distortion_model"),
        "camera_matrix": {"rows": 3, "cols": 3, "data": matrix.tolist()},
        "distortion_coefficients": {"rows": 1, "cols": len(coefficients), "data": coefficients.tolist()},
        **{key: message.values[key] for key in _READOUT if key in message.values},
    }


def published_values(values: Mapping[str, Any], file: str) -> dict[str, Any]:
    """The keys of a camera_info file for the camera of the images as they are read out and published.

    The file's matrix is that of the full image, from which the window `roi` is read out and binned.
    """
    fields, published = Fields(file, values), {key: value for key, value in values.items() if key not in _READOUT}
    if len(published) == len(values):
        return published
    width, height = (fields.integer(key, least=1) for key in ("image_width", "image_height"))
    left, top, width, height = _window(fields, width, height)
    binning_x, binning_y = (_binning(fields, key) for key in ("binning_x", "binning_y"))
    offset_px, binning = np.array([left, top], dtype=np.float64), np.array([binning_x, binning_y], dtype=np.float64)
    matrix = fields.fields("camera_matrix").array("data", (9,)).reshape(3, 3)
    matrix = _published_matrix(matrix, offset_px, binning)
    return published | {
        "image_width": width // binning_x,
        "image_height": height // binning_y,
        "camera_matrix": {"rows": 3, "cols": 3, "data": matrix.ravel().tolist()},
    }


def ini_values(content: bytes, file: str) -> dict[str, Any]:
    """The keys of a camera_info file for the calibrator's INI file, whose entries are a name and lines of numbers."""
    _, *parts = _SECTION.split(content.decode(errors="replace"))
    sections = dict(zip(parts[::2], parts[1::2], strict=True))
    entries: dict[str, list[int | float | str]] = {}
    for body in sections.values():
        for key, *rows in (block.splitlines() for block in re.split(r"\n\s*\n", body.strip())):
            entries[key.strip()] = [number_or_text(word) for row in rows for word in row.split()]
    for key in ("width", "height", "camera matrix", "distortion"):
        if not entries.get(key):
            raise DataError(file, f"is an INI file of a camera without {key!r}", "give it as the calibrator wrote it")
    coefficients = entries["distortion"]
    return {
        "camera_name": next((name for name in sections if name != "image"), ""),
        "image_width": entries["width"][0],
        "image_height": entries["height"][0],
        "distortion_model": "plumb_bob" if len(coefficients) <= 5 else "rational_polynomial",
        "camera_matrix": {"rows": 3, "cols": 3, "data": entries["camera matrix"]},
        "distortion_coefficients": {"rows": 1, "cols": len(coefficients), "data": coefficients},
    }


def _binning(message: Fields, key: str) -> int:
    """Pixels that are read out as one; 0 and a missing key stand for 1."""
    return max(message.integer(key, least=0, most=MAX_PIXELS), 1) if message.has(key) else 1


def _window(message: Fields, width: int, height: int) -> tuple[int, int, int, int]:
    """Left, top, width and height of the window that is read out, in pixels of the full image."""
    roi = message.fields("roi") if message.has("roi") else None
    if roi is None or not (roi.has("width") and roi.has("height")):
        return 0, 0, width, height
    left, top = (roi.integer(key, least=0) if roi.has(key) else 0 for key in ("x_offset", "y_offset"))
    # a width or height of 0 stands for the whole image
    inner_width, inner_height = roi.integer("width", least=0) or width, roi.integer("height", least=0) or height
    if left + inner_width > width or top + inner_height > height:
        raise roi.problem("", f"reaches beyond the image of {width} x {height} pixels")
    return left, top, inner_width, inner_height


def _published_matrix(
    matrix: Float64[Array, "3 3"], offset_px: Float64[Array, "xy=2"], binning: Float64[Array, "xy=2"]
) -> Float64[Array, "3 3"]:
    """The camera matrix of a window that is binned: pixel i of the result covers b pixels from i b on.

    Their middle is at i b + (b - 1) / 2, since pixel (0, 0) is the centre of the top-left pixel.
    """
    published = matrix.copy()
    published[[0, 1], [0, 1]] /= binning
    published[:2, 2] = (matrix[:2, 2] - offset_px - (binning - 1) / 2) / binning
    return published
