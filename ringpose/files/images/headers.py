"""Format and size in the header of an encoded image, read before the image is decoded."""

import re
import struct
from collections.abc import Callable
from typing import NamedTuple

MAX_TILE_PIXELS = 2**24
"""Largest tile of a TIFF image. A tile may be larger than its image, and is decoded as a whole."""


class ImageHeader(NamedTuple):
    """Format and size of an encoded image; sizes in pixels."""

    format: str
    width: int
    height: int
    data_start: int = 0
    """PGM only: offset of the pixels, in bytes."""
    maximum: int = 0
    """PGM only: the largest grey value."""
    pixel_bytes: int = 1
    """Bytes of a decoded pixel, with all its channels."""


def image_header(encoded: bytes) -> ImageHeader | None:
    """The header of a PNG, JPEG, BMP, TIFF or binary PGM image; None for any other format.

    A truncated header raises struct.error or ValueError. Sources: RFC 2083 (PNG), ITU-T T.81 B.2 (JPEG),
    TIFF 6.0 and its 64-bit variant BigTIFF, the BITMAPINFOHEADER of Windows, pgm(5) of Netpbm.
    """
    for signature, read in _READERS.items():
        if encoded.startswith(signature):
            return read(encoded)
    return None


def _png(encoded: bytes) -> ImageHeader:
    name, width, height, bits, color = struct.unpack_from(">4sIIBB", encoded, 12)
    if name != b"IHDR":
        raise ValueError("no IHDR")
    return ImageHeader("PNG", width, height, pixel_bytes=_PNG_CHANNELS.get(color, 4) * (2 if bits == 16 else 1))


_PNG_CHANNELS = {0: 1, 2: 3}
"""Decoded channels by colour type: grey and RGB; palettes and images with alpha become up to 4."""


def _jpeg(encoded: bytes) -> ImageHeader:
    """Skip segments up to the frame header (SOF marker), as libjpeg does."""
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
            height, width, components = struct.unpack_from(">HHB", encoded, at + 3)
            return ImageHeader("JPEG", width, height, pixel_bytes=1 if components == 1 else 3)
        if marker in (0xD9, 0xDA):  # end of image (EOI), or start of scan (SOS)
            raise ValueError("no frame header")
        at += max(struct.unpack_from(">H", encoded, at)[0], 2)


_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}
"""SOF0 to SOF15, except DHT, JPG and DAC, whose codes lie between them."""

_STANDALONE = {0x00, 0x01, 0xD8, *range(0xD0, 0xD8)}
"""Markers without a length field."""


def _bmp(encoded: bytes) -> ImageHeader:
    (length,) = struct.unpack_from("<I", encoded, 14)
    width, height = struct.unpack_from("<HH" if length == 12 else "<ii", encoded, 18)
    (bits,) = struct.unpack_from("<H", encoded, 24 if length == 12 else 28)
    pixel_bytes = 4 if bits == 32 else 3
    return ImageHeader("BMP", width, abs(height), pixel_bytes=pixel_bytes)  # negative: the top row comes first


def _tiff(encoded: bytes) -> ImageHeader:
    """Size in the first image file directory, which is the one that OpenCV decodes."""
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
    for position in range(first, first + entries * size, size):
        tag, kind, number, value = struct.unpack_from(order + entry, encoded, position)
        if number == 1 and kind in _INTEGERS:
            stored = struct.unpack_from(order + _INTEGERS[kind], value)[0]
            values[tag] = max(stored, values.get(tag, 0))
        elif tag == _BITS and kind == _SHORT:  # one number per channel, beside the entry if they do not fit into it
            fits = 2 * number <= len(value)
            at = 0 if fits else struct.unpack_from(order + offset, value)[0]
            values[tag] = max(struct.unpack_from(f"{order}{min(number, 4)}H", value if fits else encoded, at))
    if values.get(_TILE_WIDTH, 0) * values.get(_TILE_LENGTH, 0) > MAX_TILE_PIXELS:
        raise ValueError("a tile is too large")
    channels = {1: 1, 2: 4}.get(values.get(_CHANNELS, 1), values.get(_CHANNELS, 1))
    pixel_bytes = channels * max(values.get(_BITS, 1) // 8, 1)
    return ImageHeader("TIFF", values.get(_WIDTH, 0), values.get(_LENGTH, 0), pixel_bytes=pixel_bytes)


_BITS, _CHANNELS, _SHORT = 258, 277, 3

_WIDTH, _LENGTH, _TILE_WIDTH, _TILE_LENGTH = 256, 257, 322, 323

_INTEGERS = {3: "H", 4: "I", 16: "Q"}
"""Integer types of TIFF: SHORT, LONG, and LONG8 of BigTIFF."""


def _pgm(encoded: bytes) -> ImageHeader:
    match = _PGM.match(encoded)
    if match is None:
        raise ValueError("no PGM header")
    width, height, maximum = map(int, match.groups())
    return ImageHeader("PGM", width, height, match.end(), maximum, 1 if maximum < 256 else 2)


_PGM = re.compile(rb"P5" + 3 * rb"(?:\s|#[^\n]*\n)+([0-9]{1,10})" + rb"\s")
"""Width, height and maximum, separated by white space or comments; one white-space character ends the header."""

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
"""Parser of each format, by the file's signature."""
