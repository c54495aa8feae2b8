"""Format and size that an encoded image declares, read from its header before anything is decoded."""

import re
import struct
from collections.abc import Callable
from typing import NamedTuple

MAX_TILE_PIXELS = 2**24
"""A tile of a TIFF image may be larger than the image, and is decoded as a whole."""


class ImageHeader(NamedTuple):
    """What an encoded image declares; sizes in pixels."""

    format: str
    width: int
    height: int
    data_start: int = 0
    """Of PGM alone: where the pixels begin, in bytes ..."""
    maximum: int = 0
    """... and the largest grey value."""


def image_header(encoded: bytes) -> ImageHeader | None:
    """The header of a PNG, JPEG, BMP, TIFF or binary PGM image; None for any other format.

    A header that is cut short raises struct.error or ValueError. Sources: RFC 2083 (PNG), ITU-T T.81 B.2 (JPEG),
    TIFF 6.0 and its 64-bit variant BigTIFF, the BITMAPINFOHEADER of Windows, pgm(5) of Netpbm.
    """
    for signature, read in _READERS.items():
        if encoded.startswith(signature):
            return read(encoded)
    return None


def _png(encoded: bytes) -> ImageHeader:
    name, width, height = struct.unpack_from(">4sII", encoded, 12)
    if name != b"IHDR":
        raise ValueError("no IHDR")
    return ImageHeader("PNG", width, height)


def _jpeg(encoded: bytes) -> ImageHeader:
    """Segments are skipped up to the start of the frame, as libjpeg skips them."""
    at = 2
    while True:
        at = encoded.index(b"\xff", at)
        while encoded[at : at + 1] == b"\xff":
            at += 1
        marker = encoded[at] if at < len(encoded) else 0xD9
        at += 1
        if marker in _STANDALONE:
            continue
        if marker in _FRAMES:
            height, width = struct.unpack_from(">HH", encoded, at + 3)
            return ImageHeader("JPEG", width, height)
        if marker in (0xD9, 0xDA):  # the image ends, or its data begin
            raise ValueError("no frame header")
        at += max(struct.unpack_from(">H", encoded, at)[0], 2)


_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
"""SOF0 to SOF15; the three between them are tables and a reserved marker."""

_STANDALONE = {0x00, 0x01, 0xD8, *range(0xD0, 0xD8)}
"""Markers without a length."""


def _bmp(encoded: bytes) -> ImageHeader:
    (length,) = struct.unpack_from("<I", encoded, 14)
    width, height = struct.unpack_from("<HH" if length == 12 else "<ii", encoded, 18)
    return ImageHeader("BMP", width, abs(height))  # a negative height: the top row comes first


def _tiff(encoded: bytes) -> ImageHeader:
    """The first directory, which is the one that is decoded."""
    order = "<" if encoded.startswith(b"II") else ">"
    if struct.unpack_from(order + "H", encoded, 2)[0] == 42:
        offset, count, entry = "I", "H", "HHI4s"
        (start,) = struct.unpack_from(order + offset, encoded, 4)
    else:
        offset, count, entry = "Q", "Q", "HHQ8s"
        (start,) = struct.unpack_from(order + offset, encoded, 8)
    (entries,) = struct.unpack_from(order + count, encoded, start)
    first, size = start + struct.calcsize(order + count), struct.calcsize(order + entry)
    if first + entries * size > len(encoded):
        raise ValueError("the directory is cut short")
    values: dict[int, int] = {}
    for place in range(first, first + entries * size, size):
        tag, kind, number, value = struct.unpack_from(order + entry, encoded, place)
        if number == 1 and kind in _INTEGERS:
            found = struct.unpack_from(order + _INTEGERS[kind], value)[0]
            values[tag] = max(found, values.get(tag, 0))
    if values.get(_TILE_WIDTH, 0) * values.get(_TILE_LENGTH, 0) > MAX_TILE_PIXELS:
        raise ValueError("a tile is too large")
    return ImageHeader("TIFF", values.get(_WIDTH, 0), values.get(_LENGTH, 0))


_WIDTH, _LENGTH, _TILE_WIDTH, _TILE_LENGTH = 256, 257, 322, 323

_INTEGERS = {3: "H", 4: "I", 16: "Q"}
"""TIFF's types of whole numbers; eight bytes in BigTIFF alone."""


def _pgm(encoded: bytes) -> ImageHeader:
    found = _PGM.match(encoded)
    if found is None:
        raise ValueError("no PGM header")
    width, height, maximum = map(int, found.groups())
    return ImageHeader("PGM", width, height, found.end(), maximum)


_PGM = re.compile(rb"P5" + 3 * rb"(?:\s|#[^\n]*\n)+([0-9]{1,10})" + rb"\s")
"""Numbers between white space and comments; one white-space character ends the header."""

_READERS: dict[bytes, Callable[[bytes], ImageHeader]] = {
    b"\x89PNG\r\n\x1a\n": _png,
    b"\xff\xd8\xff": _jpeg,
    b"BM": _bmp,
    b"II*\0": _tiff,
    b"MM\0*": _tiff,
    b"II+\0": _tiff,
    b"MM\0+": _tiff,
    b"P5": _pgm,
}
"""By signature."""
