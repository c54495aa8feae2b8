"""Numbers in MATLAB's .mat files of version 5 to 7.2.

SciPy's reader ends the whole process on some damaged files; a camera needs matrices and structures of numbers alone.
"""

import struct
import zlib
from collections.abc import Iterator
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.types.arrays import Array, Float64

HEADER = b"MATLAB 5.0 MAT-file"
NEWER_HEADER = b"MATLAB 7.3 MAT-file"

LARGEST_BYTES = 2**26
"""No variable of a calibration is larger, however well it is compressed."""

LARGEST_ARRAY_BYTES = 2**16
"""No array of a camera is larger; others, such as the toolbox's images, are left out."""

_HEADER_BYTES = 128
_MATRIX, _COMPRESSED = 14, 15
_NUMBERS = {1: "i1", 2: "u1", 3: "i2", 4: "u2", 5: "i4", 6: "u4", 7: "f4", 9: "f8", 12: "i8", 13: "u8"}
_STRUCT_CLASS = 2
_NUMBER_CLASSES = range(6, 16)
_FLAG_BYTES = 8


def mat_variables(content: bytes, file: str) -> dict[str, Any]:
    """Variables by name: arrays of numbers, and structures of one element as mappings.

    All others are left out, and so are arrays of more than `LARGEST_ARRAY_BYTES`.
    """
    order = {b"IM": "<", b"MI": ">"}.get(content[126:128])
    if order is None or content.startswith(NEWER_HEADER):
        raise _damaged(file)
    variables: dict[str, Any] = {}
    try:
        for kind, body in _elements(content[_HEADER_BYTES:], order):
            inner = next(_elements(_decompressed(body), order)) if kind == _COMPRESSED else (kind, body)
            if inner[0] == _MATRIX:
                name, value = _matrix(inner[1], order)
                variables[name] = value
    except (struct.error, zlib.error, ValueError, OverflowError, IndexError, StopIteration, RecursionError):
        raise _damaged(file) from None
    return {name: value for name, value in variables.items() if value is not None}


def _elements(content: bytes, order: str) -> Iterator[tuple[int, bytes]]:
    """Type and bytes of each data element; those of four bytes or less stand in the tag itself."""
    place = 0
    while place + 8 <= len(content):
        kind, size = struct.unpack_from(order + "II", content, place)
        if kind >> 16:
            kind, size = kind & 0xFFFF, kind >> 16
            if size > 4:
                raise ValueError(size)
            yield kind, content[place + 4 : place + 4 + size]
            place += 8
        else:
            if place + 8 + size > len(content):
                raise ValueError(size)
            yield kind, content[place + 8 : place + 8 + size]
            place += 8 + size + (0 if kind == _COMPRESSED else -size % 8)


def _decompressed(body: bytes) -> bytes:
    return zlib.decompressobj().decompress(body, LARGEST_BYTES)


def _matrix(body: bytes, order: str) -> tuple[str, Any]:
    """Name and value of a variable; None for what is neither numbers nor a structure."""
    parts = _elements(body, order)
    flags, shape, name = next(parts)[1], next(parts), next(parts)[1].decode("ascii", errors="replace")
    if len(flags) != _FLAG_BYTES:
        raise ValueError(len(flags))
    kind = struct.unpack(order + "I", flags[:4])[0] & 0xFF
    dimensions = [int(length) for length in _numbers(*shape, order)]
    if kind in _NUMBER_CLASSES:
        numbers = next(parts)
        if len(numbers[1]) > LARGEST_ARRAY_BYTES:
            return name, None
        return name, _numbers(*numbers, order).reshape(dimensions, order="F")
    if kind == _STRUCT_CLASS and np.prod(dimensions) == 1:
        return name, _structure(parts, order)
    return name, None


def _structure(parts: Iterator[tuple[int, bytes]], order: str) -> dict[str, Any]:
    length = int(_numbers(*next(parts), order)[0])
    if length < 1:
        raise ValueError(length)
    names = next(parts)[1]
    keys = [
        names[at : at + length].split(b"\0")[0].decode("ascii", errors="replace") for at in range(0, len(names), length)
    ]
    values = [_matrix(body, order)[1] for kind, body in parts if kind == _MATRIX]
    return {key: value for key, value in zip(keys, values, strict=True) if value is not None}


def _numbers(kind: int, body: bytes, order: str) -> Float64[Array, "n"]:
    if kind not in _NUMBERS:
        raise ValueError(kind)
    with np.errstate(all="ignore"):  # a damaged file may hold any bits
        numbers: Float64[Array, "n"] = np.frombuffer(body, dtype=order + _NUMBERS[kind]).astype(np.float64)
    return numbers


def _damaged(file: str) -> DataError:
    return DataError(file, "is no valid .mat file of version 5 to 7.2", "save it anew with -v7")
