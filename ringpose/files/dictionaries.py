"""Dictionaries of markers, as OpenCV's FileStorage has them."""

from pathlib import Path

from ringpose.files.bytes import read_bytes
from ringpose.files.fields import Fields
from ringpose.files.opencv_storage import storage_values

OPENCV_PREFIX = "DICT_"
"""Names of OpenCV's own dictionaries begin so; any other name is that of a file."""

MOST_MARKERS = 1024
"""OpenCV's largest dictionary has as many."""


def read_dictionary(path: Path) -> tuple[str, ...]:
    """Each marker's bits, row by row."""
    fields = Fields(str(path), storage_values(read_bytes(path), str(path)))
    side = fields.integer("markersize", least=3, most=10)
    count = fields.integer("nmarkers", least=1, most=MOST_MARKERS)
    return tuple(_bits(fields, f"marker_{number}", side) for number in range(count))


def _bits(fields: Fields, key: str, side: int) -> str:
    bits = fields.text(key)
    if set(bits) - {"0", "1"} or len(bits) != side**2:
        raise fields.problem(key, f"must be {side} x {side} times 0 or 1")
    return bits
