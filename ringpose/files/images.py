"""Images: PNG, TIFF, BMP, JPEG as arrays of grey values."""

import zlib
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ringpose.errors import DataError
from ringpose.files import atomic
from ringpose.files.bytes import read_bytes
from ringpose.opencv_log import silent_opencv
from ringpose.types.arrays import Array, UInt

IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg")

CHANNELS = {"b": 0, "g": 1, "r": 2}
"""OpenCV's order."""

_LONGEST_SIDE = 1_000_000
"""Pixels: libpng's own limit."""

_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff"


def read_image(path: Path, channel: str | None = None) -> UInt[Array, "row column"]:
    """Grey values, 8 or 16 bits; colour becomes its luminance, or the one channel (`r`, `g` or `b`) that is asked for.

    What the file says of its orientation is not followed: a pixel stays where the sensor had it.
    """
    encoded = read_bytes(path)
    finding = _damage(encoded)
    if finding:
        raise DataError(str(path), finding)
    decoded = _decoded(encoded, path) if encoded else None
    if decoded is None:
        raise DataError(str(path), "is no image that can be read, or is cut short", "PNG, TIFF, BMP or JPEG is wanted")
    if decoded.dtype not in (np.uint8, np.uint16):
        raise DataError(str(path), f"has pixels of type {decoded.dtype}", "8 or 16 bits without sign are wanted")
    return _grey(decoded, channel)


def write_image(path: Path, image: UInt[Array, "row column *color"], *, force: bool = False) -> None:
    """Write a grey or BGR image as PNG."""
    encoded = cv2.imencode(".png", image)[1]
    with atomic.replacing(path, force) as stream:
        stream.write(encoded.tobytes())


def _decoded(encoded: bytes, path: Path) -> Any:
    """Pixels, or None; OpenCV refuses sizes that it holds to be impossible by an exception."""
    with silent_opencv():
        try:
            return cv2.imdecode(np.frombuffer(encoded, np.uint8), cv2.IMREAD_UNCHANGED)
        except cv2.error:
            raise DataError(str(path), "is no image that can be read: it is too large, or says so") from None


def _grey(decoded: Any, channel: str | None) -> UInt[Array, "row column"]:
    if decoded.ndim == 2:
        grey = decoded
    elif channel is not None:
        grey = decoded[..., CHANNELS[channel]]
    else:
        grey = cv2.cvtColor(decoded[..., :3], cv2.COLOR_BGR2GRAY)
    return np.ascontiguousarray(grey)


def _damage(encoded: bytes) -> str:
    """What is wrong with a file that its decoder would report on stderr by itself, or pass over."""
    if encoded.startswith(_PNG):
        return _png_damage(encoded)
    if encoded.startswith(_JPEG) and encoded.find(b"\xff\xd9", encoded.find(b"\xff\xda")) < 0:
        return "is a JPEG image that is cut short"
    return ""


def _png_damage(encoded: bytes) -> str:
    start = len(_PNG)
    while start + 12 <= len(encoded):
        end = start + 12 + int.from_bytes(encoded[start : start + 4], "big")
        if end > len(encoded):
            break
        name = encoded[start + 4 : start + 8]
        if zlib.crc32(encoded[start + 4 : end - 4]) != int.from_bytes(encoded[end - 4 : end], "big"):
            return f"is a damaged PNG image: chunk {name.decode('latin-1')!r} fails its check"
        if name == b"IHDR" and not _possible_size(encoded[start + 8 : start + 16]):
            return "is a damaged PNG image, or too large: its size cannot be read"
        if name == b"IEND":
            return ""
        start = end
    return "is a PNG image that is cut short"


def _possible_size(header: bytes) -> bool:
    """Whether PNG's decoder takes the columns and rows that a header names: of others it writes on stderr."""
    columns, rows = int.from_bytes(header[:4], "big"), int.from_bytes(header[4:], "big")
    return 0 < columns <= _LONGEST_SIDE and 0 < rows <= _LONGEST_SIDE
