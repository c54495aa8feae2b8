"""Reading of PNG, TIFF, BMP, JPEG, WebP, JPEG 2000 and PGM images as grey values, and writing of PNG."""

import os
import re
import struct
import threading
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from ringpose.errors import DataError
from ringpose.files import atomic
from ringpose.files.images.headers import ImageHeader, image_header
from ringpose.files.io import read_bytes
from ringpose.files.schema import EXCHANGED, kind_of_data, kind_of_text
from ringpose.opencv_log import silent_opencv
from ringpose.types.arrays import Array, UInt
from ringpose.types.image import MAX_SHOT_PIXELS, check_shot_size
from ringpose.types.rig import Camera

IMAGE_SUFFIXES = (".png", ".tif", ".tiff", ".bmp", ".jpg", ".jpeg", ".webp", ".jp2", ".j2k", ".pgm")

CHANNELS = {"b": 0, "g": 1, "r": 2}
"""Index of each channel in OpenCV's BGR order."""

MAX_DECODED_BYTES = 2 * MAX_SHOT_PIXELS
"""Maximum size of a decoded image, with all its channels: that of the largest shot in 16 bits."""

_REMEDY = "give an intact PNG, TIFF, BMP, JPEG, WebP, JPEG 2000 or binary PGM image"

_STDERR = 2

_stderr_lock = threading.Lock()


def read_image(path: Path, channel: str | None = None, camera: Camera | None = None) -> UInt[Array, "row column"]:
    """Grey values of an image that is not a TIFF file of several pages; see `read_pages`."""
    pages = read_pages(path, channel, camera)
    if len(pages) > 1:
        remedy = (
            "give each page as an image, or pages that are the frames of one shot as NPZ (ringpose help conventions, "
            "Shots); only the calibration commands read all pages"
        )
        raise DataError(str(path), f"has {len(pages)} pages, must have one", remedy)
    return pages[0]


def read_pages(path: Path, channel: str | None = None, camera: Camera | None = None) -> list[UInt[Array, "row column"]]:
    """Grey values, 8 or 16 bits; of colour images the luminance, or the given channel (`r`, `g` or `b`).

    TIFF files may have several pages; other files are one. The size in the header must be within `MAX_SHOT_PIXELS` and
    equal the camera's, if one is given; it is checked before the pixels are decoded. The orientation tag is ignored, so
    that pixels keep their position on the sensor.
    """
    encoded = read_bytes(path)
    header = _checked_header(encoded, path, camera)
    if header.format == "PGM":
        return [_pgm_pixels(encoded, header, path)]
    if finding := _undetected_damage(encoded, header):
        raise DataError(str(path), finding, _REMEDY)
    return [_grey(decoded, header, path, channel) for decoded in _decoded(encoded, header, path)]


def _grey(decoded: Any, header: ImageHeader, path: Path, channel: str | None) -> UInt[Array, "row column"]:
    if decoded.shape[:2] != (header.height, header.width):
        finding = f"declares {header.width} x {header.height} pixels, has {decoded.shape[1]} x {decoded.shape[0]}"
        raise DataError(str(path), finding, _REMEDY)
    if decoded.dtype not in (np.uint8, np.uint16):
        raise DataError(str(path), f"has pixels of type {decoded.dtype}", "give 8 or 16 bits without sign")
    if decoded.ndim == 2:
        grey = decoded
    elif channel is not None:
        grey = decoded[..., CHANNELS[channel]]
    else:
        grey = cv2.cvtColor(decoded[..., :3], cv2.COLOR_BGR2GRAY)
    return np.ascontiguousarray(grey)


def write_image(path: Path, image: UInt[Array, "row column *color"], *, force: bool = False) -> None:
    """Write a grey or BGR image as PNG."""
    encoded = cv2.imencode(".png", image)[1]
    with atomic.replacing(path, force) as stream:
        stream.write(encoded.tobytes())


def _checked_header(encoded: bytes, path: Path, camera: Camera | None) -> ImageHeader:
    try:
        header = image_header(encoded)
    except (struct.error, ValueError):
        raise DataError(str(path), "is an image whose header is damaged or cut short", _REMEDY) from None
    if header is None and (kind := kind_of_text(encoded) or kind_of_data(encoded)):
        raise DataError(str(path), f"is {kind}, must be an image", EXCHANGED)
    if header is None:
        raise DataError(str(path), "is not an image of a known format", _REMEDY)
    if min(header.width, header.height) < 1:
        raise DataError(str(path), f"declares {header.width} x {header.height} pixels", _REMEDY)
    check_shot_size(str(path), len(header.pages), header.width, header.height, camera)
    decoded = len(header.pages) * header.width * header.height * header.pixel_bytes
    if decoded > MAX_DECODED_BYTES:
        size = f"{header.width} x {header.height} pixels of {header.pixel_bytes} bytes"
        finding = f"declares {size}, {decoded / 1e6:.0f} MB, must be at most {MAX_DECODED_BYTES / 1e6:.0f} MB"
        raise DataError(str(path), finding, "crop it, or make it grey")
    return header


def _pgm_pixels(encoded: bytes, header: ImageHeader, path: Path) -> UInt[Array, "row column"]:
    """Grey values of a binary PGM; two bytes each, big-endian, if the maximum is 256 or more."""
    if not 1 <= header.maximum <= 65535:
        raise DataError(str(path), f"has the largest grey value {header.maximum}, must be 1 to 65535", _REMEDY)
    stored = np.dtype(np.uint8 if header.maximum < 256 else ">u2")
    pixels = header.width * header.height
    if len(encoded) - header.data_start < pixels * stored.itemsize:
        raise DataError(str(path), "is a PGM image that is cut short", _REMEDY)
    grey = np.frombuffer(encoded, stored, pixels, header.data_start).reshape(header.height, header.width)
    return grey.astype(stored.newbyteorder("="))


def _decoded(encoded: bytes, header: ImageHeader, path: Path) -> list[Any]:
    """The decoded pixels of each page.

    Damage reported by a codec is an error, even if the codec fills in the missing pixels.
    """
    with silent_opencv(), _codec_reports() as reports:
        stored = np.frombuffer(encoded, np.uint8)
        try:
            if len(header.pages) == 1:
                decoded = [cv2.imdecode(stored, cv2.IMREAD_UNCHANGED)]
            else:
                images = cv2.imdecodemulti(stored, cv2.IMREAD_UNCHANGED)[1]
                decoded = [images[page] if page < len(images) else None for page in header.pages]
        except cv2.error:
            decoded = [None]
    damage = [report for report in reports if _DAMAGE.match(report)]
    if any(one is None for one in decoded) or (damage and not (len(damage) == 1 and _is_padding(encoded, damage[0]))):
        reason = f": {damage[0].decode(errors='replace')}" if damage else ""
        raise DataError(str(path), f"is an image that is damaged or cut short{reason}", _REMEDY)
    return decoded


_DAMAGE = re.compile(rb"libpng error|Corrupt JPEG data(?!: bad ICC)|Premature end of JPEG|Inconsistent progression")
"""Reports of damaged pixels (libpng's pngerror.c, libjpeg's jerror.h); the others concern colour profiles, texts and
versions."""

_REPORT = re.compile(
    rb"(?:libpng (?:error|warning): |Corrupt JPEG data: |Premature end of JPEG |Inconsistent progression |"
    rb"Invalid SOS parameters |Unknown Adobe color |Warning: unknown JFIF )[^\n\x1b]*\n?"
)
"""One report of libpng or libjpeg on stderr."""

_EXTRANEOUS = re.compile(rb"Corrupt JPEG data: (\d+) extraneous bytes before marker 0xd9")


def _is_padding(encoded: bytes, report: bytes) -> bool:
    """Whether a report concerns padding: bytes of one value between the last pixels and the end marker.

    Webcams pad the frames of motion JPEG in this way. Differing bytes may be pixels displaced by earlier damage.
    """
    match = _EXTRANEOUS.match(report)
    end = encoded.find(b"\xff\xd9", encoded.find(b"\xff\xda"))
    return match is not None and len(set(encoded[max(0, end - int(match[1])) : end].rstrip(b"\xff"))) <= 1


@contextmanager
def _codec_reports() -> Iterator[list[bytes]]:
    """Lines that libpng and libjpeg write to stderr while the block runs; the list is filled when the block ends.

    Both write to the file descriptor directly, and OpenCV cannot redirect them. Text that other threads write
    meanwhile, such as progress, is passed on afterwards, except a write that is in progress when the block ends.
    """
    reports: list[bytes] = []
    with _stderr_lock, os.fdopen(os.memfd_create("stderr"), "w+b") as caught:
        saved = os.dup(_STDERR)
        try:
            os.dup2(caught.fileno(), _STDERR)
            yield reports
        finally:
            os.dup2(saved, _STDERR)
            os.close(saved)
            caught.seek(0)
            written = caught.read()
            reports += [report.strip() for report in _REPORT.findall(written)]
            if others := _REPORT.sub(b"", written):
                with suppress(OSError):
                    os.write(_STDERR, others)


def _undetected_damage(encoded: bytes, header: ImageHeader) -> str:
    """The finding if an image has damage that its decoder does not report; else empty."""
    end = len(encoded) if header.data_end is None else header.data_end
    is_cut = {
        "JPEG": encoded.find(b"\xff\xd9", encoded.find(b"\xff\xda")) < 0,
        "JPEG 2000": encoded[end - 2 : end] != b"\xff\xd9",
        "WebP": len(encoded) < 8 + int.from_bytes(encoded[4:8], "little"),
    }
    if is_cut.get(header.format, False):
        return f"is a {header.format} image that is cut short"
    return _png_damage(encoded) if header.format == "PNG" else ""


def _png_damage(encoded: bytes) -> str:
    start = len(b"\x89PNG\r\n\x1a\n")
    while start + 12 <= len(encoded):
        end = start + 12 + int.from_bytes(encoded[start : start + 4], "big")
        if end > len(encoded):
            break
        name = encoded[start + 4 : start + 8]
        if zlib.crc32(encoded[start + 4 : end - 4]) != int.from_bytes(encoded[end - 4 : end], "big"):
            return f"is a damaged PNG image: chunk {name.decode('latin-1')!r} fails its check"
        if name == b"IEND":
            return ""
        start = end
    return "is a PNG image that is cut short"
