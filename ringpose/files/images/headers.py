"""Format and size in the header of an encoded image, read before the image is decoded."""

import re
import struct
from collections.abc import Callable
from typing import NamedTuple

MAX_TILE_PIXELS = 2**24
"""Largest tile of a TIFF image. A tile may be larger than its image, and is decoded as a whole."""


MAX_PAGES = 10_000
"""Images of a TIFF file that are looked at; all of them together may have as many pixels as a shot."""


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
    pages: tuple[int, ...] = (0,)
    """TIFF only: which of its images are pages."""
    data_end: int | None = None
    """JPEG 2000 only: offset of the end of the codestream; None for the end of the file."""


def image_header(encoded: bytes) -> ImageHeader | None:
    """The header of a PNG, JPEG, BMP, TIFF, WebP, JPEG 2000 or binary PGM image; None for any other format.

    A truncated header raises struct.error or ValueError. Sources: RFC 2083 (PNG), ITU-T T.81 B.2 (JPEG),
    TIFF 6.0 and its 64-bit variant BigTIFF, the BITMAPINFOHEADER of Windows, RFC 9649 and RFC 6386 (WebP),
    ITU-T T.800 A.5.1 and I.4 (JPEG 2000), pgm(5) of Netpbm.
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
    """Size and number of the pages, of which all have the largest size of any; thumbnails and masks are no pages."""
    order = "<" if encoded.startswith(b"II") else ">"
    is_big = struct.unpack_from(order + "H", encoded, 2)[0] != 42
    (start,) = struct.unpack_from(order + ("Q" if is_big else "I"), encoded, 8 if is_big else 4)
    read: list[int] = []
    kept: list[int] = []
    sizes: list[tuple[int, int, int]] = []
    while start and start not in read and len(read) < MAX_PAGES:
        values, following = _directory(encoded, start, order, is_big)
        if not values.get(_SUBFILE, 0) & _NO_PAGE or not read:
            kept.append(len(read))
            channels = {1: 1, 2: 4}.get(values.get(_CHANNELS, 1), values.get(_CHANNELS, 1))
            pixel_bytes = channels * max(values.get(_BITS, 1) // 8, 1)
            sizes.append((values.get(_WIDTH, 0), values.get(_LENGTH, 0), pixel_bytes))
        read.append(start)
        start = following
    width, height, pixel_bytes = (max(size) for size in zip(*sizes, strict=True))
    return ImageHeader("TIFF", width, height, pixel_bytes=pixel_bytes, pages=tuple(kept))


def _directory(encoded: bytes, start: int, order: str, is_big: bool) -> tuple[dict[int, int], int]:
    """The integers in one image file directory by their tags, and the offset of the next directory, or 0."""
    offset, count, entry = ("Q", "Q", "HHQ8s") if is_big else ("I", "H", "HHI4s")
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
    return values, struct.unpack_from(order + offset, encoded, first + entries * size)[0]


_SUBFILE, _NO_PAGE = 254, 0b101
"""NewSubfileType, and its bits of a reduced image and of a transparency mask."""

_BITS, _CHANNELS, _SHORT = 258, 277, 3

_WIDTH, _LENGTH, _TILE_WIDTH, _TILE_LENGTH = 256, 257, 322, 323

_INTEGERS = {3: "H", 4: "I", 16: "Q"}
"""Integer types of TIFF: SHORT, LONG, and LONG8 of BigTIFF."""


def _webp(encoded: bytes) -> ImageHeader | None:
    """Size in the first chunk; that of the canvas if it has extended features."""
    if encoded[8:12] != b"WEBP":
        return None
    kind = encoded[12:16]
    if kind == b"VP8X":
        if encoded[20] & _ANIMATED:
            raise ValueError("an animation")
        width, height = (1 + int.from_bytes(encoded[at : at + 3], "little") for at in (24, 27))
    elif kind == b"VP8L":
        (packed,) = struct.unpack_from("<I", encoded, 21)
        width, height = 1 + (packed & 0x3FFF), 1 + (packed >> 14 & 0x3FFF)
    elif kind == b"VP8 ":
        width, height = (size & 0x3FFF for size in struct.unpack_from("<HH", encoded, 26))
    else:
        raise ValueError("no image")
    return ImageHeader("WebP", width, height, pixel_bytes=4)


_ANIMATED = 0x02


def _jp2(encoded: bytes) -> ImageHeader:
    """Size in the codestream, which is what is decoded, in the box `jp2c`."""
    at = 0
    while at + 8 <= len(encoded):
        length, name = struct.unpack_from(">I4s", encoded, at)
        start = 8
        if length == 1:
            (length,) = struct.unpack_from(">Q", encoded, at + 8)
            start = 16
        if name == b"jp2c":  # a length of 0 stands for the rest of the file
            end = at + length if length else None
            return _codestream(encoded[at + start : at + start + 64])._replace(data_end=end)
        if length < start:
            break
        at += length
    raise ValueError("no codestream")


def _codestream(encoded: bytes) -> ImageHeader:
    """Size in the segment SIZ, with which each codestream begins: the reference grid without its offset."""
    if not encoded.startswith(b"\xff\x4f\xff\x51"):
        raise ValueError("no SIZ")
    right, bottom, left, top = struct.unpack_from(">IIII", encoded, 8)
    components, depth = struct.unpack_from(">HB", encoded, 40)
    pixel_bytes = min(components, 4) * (1 if depth & 0x7F < 8 else 2)
    return ImageHeader("JPEG 2000", right - left, bottom - top, pixel_bytes=pixel_bytes)


def _pgm(encoded: bytes) -> ImageHeader:
    match = _PGM.match(encoded)
    if match is None:
        raise ValueError("no PGM header")
    width, height, maximum = map(int, match.groups())
    return ImageHeader("PGM", width, height, match.end(), maximum, 1 if maximum < 256 else 2)


_PGM = re.compile(rb"P5" + 3 * rb"(?:\s|#[^\n]*\n)+([0-9]{1,10})" + rb"\s")
"""Width, height and maximum, separated by white space or comments; one white-space character ends the header."""

_READERS: dict[bytes, Callable[[bytes], ImageHeader | None]] = {
    b"\x89PNG\r\n\x1a\n": _png,
    b"\xff\xd8\xff": _jpeg,
    b"BM": _bmp,
    b"II*\0": _tiff,
    b"MM\0*": _tiff,
    b"II+\0": _tiff,
    b"MM\0+": _tiff,
    b"P5": _pgm,
    b"RIFF": _webp,
    b"\0\0\0\x0cjP  \r\n\x87\n": _jp2,
    b"\xff\x4f\xff\x51": _codestream,
}
"""Parser of each format, by the file's signature."""
