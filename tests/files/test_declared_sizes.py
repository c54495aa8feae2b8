"""Declared sizes of images and arrays are checked before decompression."""

import io
import struct
import subprocess
import sys
import tracemalloc
import zipfile
import zlib

import cv2
import numpy as np
import pytest

from ringpose.errors import DataError
from ringpose.files.images.codecs import read_image
from ringpose.files.images.headers import image_header
from ringpose.files.images.shots import read_shot
from ringpose.files.npz import Archive
from ringpose.files.rigs import read_rig

SIDE = 30_000
"""900 million pixels."""


def png(width: int, height: int, bits: int = 8, color: int = 0) -> bytes:
    def chunk(name: bytes, data: bytes) -> bytes:
        return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))

    header = struct.pack(">IIBBBBB", width, height, bits, color, 0, 0, 0)
    return (
        b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", zlib.compress(bytes(99))) + chunk(b"IEND", b"")
    )


def jpeg(width: int, height: int, channels: tuple[int, ...] = ()) -> bytes:
    """A JPEG image of 8 x 8 pixels with another size in its frame header."""
    encoded = bytearray(cv2.imencode(".jpg", np.zeros((8, 8, *channels), np.uint8))[1].tobytes())
    at = encoded.index(b"\xff\xc0") + 5
    encoded[at : at + 4] = struct.pack(">HH", height, width)
    return bytes(encoded)


def bmp(width: int, height: int) -> bytes:
    return struct.pack("<2sIHHIIiiHH", b"BM", 2000, 0, 0, 1078, 40, width, height, 1, 8) + bytes(24 + 1024 + 900)


def tiff(image, order: str = "<", big: bool = False, changes=()) -> bytes:
    """An uncompressed grey TIFF or BigTIFF of one strip, built from the specifications."""
    height, width = image.shape
    start = (16 if big else 8) + image.size
    tags = {256: width, 257: height, 258: 8, 259: 1, 262: 1, 273: start - image.size, 277: 1, 278: height}
    tags |= {279: image.size} | dict(changes)
    entry = order + ("HHQQ" if big else "HHII")
    entries = b"".join(struct.pack(entry, tag, 16 if big else 4, 1, tags[tag]) for tag in sorted(tags))
    mark = b"II" if order == "<" else b"MM"
    head = struct.pack(order + ("HHHQ" if big else "HI"), *((43, 8, 0) if big else (42,)), start)
    count = struct.pack(order + ("Q" if big else "H"), len(tags))
    return mark + head + image.tobytes() + count + entries + bytes(8 if big else 4)


def webp(width: int, height: int) -> bytes:
    """A lossless WebP image with another size in its header, which has 14 bits less 1 for each."""
    encoded = bytearray(cv2.imencode(".webp", np.zeros((8, 8), np.uint8), [cv2.IMWRITE_WEBP_QUALITY, 101])[1].tobytes())
    at = encoded.index(b"VP8L") + 9
    encoded[at : at + 4] = struct.pack("<I", (width - 1) | (height - 1) << 14)
    return bytes(encoded)


def jp2(width: int, height: int) -> bytes:
    """A JPEG 2000 image of 64 x 64 pixels, with another size in its codestream."""
    encoded = bytearray(cv2.imencode(".jp2", np.zeros((64, 64), np.uint8))[1].tobytes())
    at = encoded.index(b"\xff\x4f\xff\x51") + 8
    encoded[at : at + 8] = struct.pack(">II", width, height)
    return bytes(encoded)


def npz(shape: tuple[int, ...], stored: int = 100, key: str = "images", descr: str = "|u1") -> bytes:
    """An archive with one array, whose header declares another size than is stored."""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive, archive.open(f"{key}.npy", "w") as member:
        np.lib.format.write_array_header_1_0(member, {"descr": descr, "fortran_order": False, "shape": shape})
        member.write(bytes(stored))
    return file.getvalue()


SMALL = np.arange(96, dtype=np.uint8).reshape(8, 12)

TOO_LARGE = {
    "a.png": png(SIDE, SIDE),
    "a.jpg": jpeg(SIDE, SIDE),
    "a.bmp": bmp(SIDE, -SIDE),
    "a.tif": tiff(SMALL, changes={256: SIDE, 257: SIDE, 278: SIDE}.items()),
    "big.tif": tiff(SMALL, big=True, changes={256: SIDE, 257: SIDE, 278: SIDE}.items()),
    "tiled.tif": tiff(SMALL, changes={322: SIDE, 323: SIDE}.items()),
    "a.webp": webp(16_384, 16_384),
    "a.jp2": jp2(SIDE, SIDE),
    "a.pgm": f"P5 {SIDE} {SIDE} 255\n".encode(),
}

READ_WITH_LITTLE_MEMORY = """
import resource, sys
from pathlib import Path
from ringpose.errors import DataError
from ringpose.files.images.shots import read_shot

used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
resource.setrlimit(resource.RLIMIT_AS, (used + 2**27, used + 2**27))
for name in sys.argv[1:]:
    try:
        read_shot(Path(name))
    except DataError as error:
        print(error)
"""


def test_images_that_declare_too_many_pixels_are_rejected_within_128_mib(tmp_path):
    for name, content in TOO_LARGE.items():
        (tmp_path / name).write_bytes(content)
    words = [sys.executable, "-c", READ_WITH_LITTLE_MEMORY, *TOO_LARGE]

    ended = subprocess.run(words, cwd=tmp_path, capture_output=True, text=True, check=True)

    lines = dict(line.split(": ", 1) for line in ended.stdout.splitlines())
    assert list(lines) == list(TOO_LARGE)
    assert all("256 million" in line for name, line in lines.items() if name != "tiled.tif")
    assert "header" in lines["tiled.tif"]
    assert ended.stderr == ""


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".bmp", ".tif", ".pgm", ".webp"])
@pytest.mark.parametrize("shape", [(1, 7), (48, 64), (5, 300, 3)])
def test_header_declares_the_size_that_is_decoded(suffix, shape):
    if suffix == ".pgm":
        shape = shape[:2]
    encoded = cv2.imencode(suffix, np.zeros(shape, np.uint8))[1].tobytes()

    header = image_header(encoded)

    assert (header.height, header.width) == shape[:2]


def test_header_of_a_progressive_jpeg_with_restarts_is_read():
    options = [cv2.IMWRITE_JPEG_PROGRESSIVE, 1, cv2.IMWRITE_JPEG_RST_INTERVAL, 1]

    header = image_header(cv2.imencode(".jpg", np.zeros((24, 40), np.uint8), options)[1].tobytes())

    assert (header.width, header.height) == (40, 24)


@pytest.mark.parametrize("order", ["<", ">"])
@pytest.mark.parametrize("big", [False, True])
def test_tiff_of_either_byte_order_is_read(tmp_path, order, big):
    (tmp_path / "a.tif").write_bytes(tiff(SMALL, order, big))

    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), SMALL)


def test_an_image_of_another_size_than_the_rig_is_rejected_before_decoding(tmp_path, rig_file, monkeypatch):
    (tmp_path / "a.png").write_bytes(png(10_000, 10_000))
    monkeypatch.setattr(cv2, "imdecode", None)

    with pytest.raises(DataError, match="10000 x 10000 pixels, the rig's camera has 640 x 480"):
        read_shot(tmp_path / "a.png", rig=read_rig(rig_file()))


@pytest.mark.parametrize("size", [(100_000, 100_000), (2**20 + 1, 5), (2**31 - 1, 1), (0, 5), (5, 0)])
def test_an_invalid_size_gives_one_error_and_nothing_on_stderr(tmp_path, capfd, size):
    (tmp_path / "a.png").write_bytes(png(*size))

    with pytest.raises(DataError, match=r"million|declares|Invalid IHDR|damaged"):
        read_image(tmp_path / "a.png")

    assert capfd.readouterr().err == ""


def message_and_peak_of(read, *arguments, **options) -> tuple[str, int]:
    """The message of the error, and the peak of the allocated bytes."""
    tracemalloc.start()
    try:
        with pytest.raises(DataError) as caught:
            read(*arguments, **options)
        return str(caught.value), tracemalloc.get_traced_memory()[1]
    finally:
        tracemalloc.stop()


def with_file_size(archive: bytes, size: int) -> bytes:
    """The archive with another uncompressed size of its one member in the directory."""
    changed = bytearray(archive)
    struct.pack_into("<I", changed, changed.rindex(b"PK\x01\x02") + 24, size)
    return bytes(changed)


HEADER_BYTES = 128
"""Size of the header of each array in these tests."""

WRONG_SIZES = {
    "more pixels than a shot may have": (npz((3, 10_000, 9_000)), 3 * 90_000_000, "256 million"),
    "more frames than a shot may have": (npz((10**12, 1, 1)), 2**32 - 1 - HEADER_BYTES, "not what its header declares"),
    "a negative length": (npz((-1, -10, 10)), 100, "not what its header declares"),
    "less than is stored": (npz((1, 10, 10), 2**22), 100, "CRC"),
    "less than its directory declares": (npz((1, 10, 10), 2**22), 2**22, "not what its header declares"),
}


@pytest.mark.parametrize(("archive", "size", "finding"), WRONG_SIZES.values(), ids=WRONG_SIZES)
def test_an_archive_with_a_wrong_declared_size_is_rejected_within_2_mb(tmp_path, archive, size, finding):
    (tmp_path / "a.npz").write_bytes(with_file_size(archive, HEADER_BYTES + size))

    message, peak = message_and_peak_of(read_shot, tmp_path / "a.npz")

    assert finding in message
    assert peak < 2e6


def test_a_shot_of_another_size_than_the_rig_is_rejected_before_decompression(tmp_path, rig_file):
    (tmp_path / "a.npz").write_bytes(with_file_size(npz((1, 10_000, 9_000)), HEADER_BYTES + 90_000_000))
    rig = read_rig(rig_file())

    message, peak = message_and_peak_of(read_shot, tmp_path / "a.npz", rig=rig)

    assert "9000 x 10000 pixels, the rig's camera has 640 x 480" in message
    assert peak < 2e6


@pytest.mark.parametrize(
    ("key", "descr", "shape", "size"),
    [
        ("stripes.position_px", "<f8", (2**22 + 1, 2), (2**22 + 1) * 16),
        ("meta", f"<U{2**24 + 1}", (), 4 * (2**24 + 1)),
        ("segments.support", "<U0", (2**40,), 0),
    ],
    ids=["numbers", "text", "values without bytes"],
)
def test_other_arrays_are_limited_to_64_mib_in_total(tmp_path, key, descr, shape, size):
    (tmp_path / "a.npz").write_bytes(with_file_size(npz(shape, 0, key, descr), HEADER_BYTES + size))

    message, peak = message_and_peak_of(lambda: Archive(tmp_path / "a.npz").value(key))

    assert message.startswith(f"{tmp_path / 'a.npz'}: {key}: ")
    assert "64 MiB" in message
    assert peak < 2e6


@pytest.mark.parametrize("method", [zipfile.ZIP_BZIP2, zipfile.ZIP_LZMA])
def test_other_compression_methods_are_rejected(tmp_path, method):
    with zipfile.ZipFile(tmp_path / "a.npz", "w", method) as archive:
        archive.writestr("images.npy", bytes(2**22))

    message, peak = message_and_peak_of(read_shot, tmp_path / "a.npz")

    assert "deflation" in message
    assert peak < 2e6


def test_an_endless_header_is_rejected(tmp_path):
    with zipfile.ZipFile(tmp_path / "a.npz", "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("images.npy", b"\x93NUMPY\x02\x00" + struct.pack("<I", 2**22) + b" " * 2**22)

    message, peak = message_and_peak_of(read_shot, tmp_path / "a.npz")

    assert "NPZ archive" in message
    assert peak < 2e6


def test_a_file_of_more_than_2_gib_is_rejected(tmp_path):
    with (tmp_path / "a.npz").open("wb") as stream:
        stream.truncate(2**31 + 1)

    message, peak = message_and_peak_of(read_shot, tmp_path / "a.npz")

    assert "2 GiB" in message
    assert peak < 2e6


WIDTH, HEIGHT = 16_000, 15_812
"""253 million pixels: few enough for one channel."""


@pytest.mark.parametrize(
    ("name", "content", "pixel_bytes"),
    [
        ("a.png", png(WIDTH, HEIGHT, color=2), 3),
        ("a.png", png(WIDTH, HEIGHT, bits=16, color=6), 8),
        ("a.jpg", jpeg(WIDTH, HEIGHT, (3,)), 3),
        ("a.bmp", bmp(WIDTH, HEIGHT), 3),
        ("a.tif", tiff(SMALL, changes={256: WIDTH, 257: HEIGHT, 277: 3}.items()), 3),
        ("a.tif", tiff(SMALL, changes={256: WIDTH, 257: HEIGHT, 258: 32}.items()), 4),
    ],
)
def test_decoded_bytes_of_all_channels_are_limited(tmp_path, name, content, pixel_bytes):
    file = tmp_path / name
    file.write_bytes(content)

    with pytest.raises(DataError) as caught:
        read_image(file)

    assert f"declares {WIDTH} x {HEIGHT} pixels of {pixel_bytes} bytes" in str(caught.value)
    assert "must be at most 512 MB" in str(caught.value)


@pytest.mark.parametrize("suffix", [".png", ".tif", ".bmp", ".jpg"])
@pytest.mark.parametrize("shape", [(4, 5), (4, 5, 3), (4, 5, 4)])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_declared_bytes_of_a_pixel_are_at_least_the_decoded_ones(suffix, shape, dtype):
    if suffix in (".bmp", ".jpg") and (dtype is np.uint16 or shape[2:] == (4,)):
        pytest.skip("the format has no such pixels")
    encoded = cv2.imencode(suffix, np.ones(shape, dtype))[1]

    decoded = cv2.imdecode(encoded, cv2.IMREAD_UNCHANGED)

    header = image_header(encoded.tobytes())
    assert header is not None
    assert header.pixel_bytes * 20 >= decoded.nbytes
    assert header.pixel_bytes * 20 == decoded.nbytes or suffix == ".bmp"  # palettes are decoded to colours
