import os
import struct
import threading

import cv2
import numpy as np
import pytest

from ringpose.errors import DataError, NoInputError
from ringpose.files.images.codecs import read_image
from ringpose.files.images.shots import read_shots

LOSSLESS = {
    ".webp": [cv2.IMWRITE_WEBP_QUALITY, 101],
    ".jp2": [cv2.IMWRITE_JPEG2000_COMPRESSION_X1000, 1000],
}


def encoded(suffix: str, image) -> bytes:
    return cv2.imencode(suffix, image, LOSSLESS.get(suffix, []))[1].tobytes()


def grey(rng, dtype=np.uint8):
    return rng.integers(0, np.iinfo(dtype).max, (48, 64), dtype=dtype, endpoint=True)


@pytest.mark.parametrize(
    ("suffix", "dtype"),
    [
        (".png", np.uint8),
        (".png", np.uint16),
        (".tif", np.uint8),
        (".tiff", np.uint16),
        (".bmp", np.uint8),
        (".pgm", np.uint8),
        (".pgm", np.uint16),
        (".webp", np.uint8),
        (".jp2", np.uint8),
        (".jp2", np.uint16),
    ],
)
def test_grey_values_are_read_as_they_are(tmp_path, rng, suffix, dtype):
    image = grey(rng, dtype)
    (tmp_path / f"a{suffix}").write_bytes(encoded(suffix, image))

    read = read_image(tmp_path / f"a{suffix}")

    np.testing.assert_array_equal(read, image)
    assert read.dtype == dtype
    np.testing.assert_array_equal(read_image(tmp_path / f"a{suffix}", "r"), image)


def test_a_codestream_of_jpeg_2000_and_one_with_boxes_after_it_are_read(tmp_path, rng):
    whole = encoded(".jp2", grey(rng))
    at = whole.index(b"jp2c") - 4
    (tmp_path / "a.j2k").write_bytes(whole[at + 8 :])
    closed = (len(whole) - at).to_bytes(4, "big") + whole[at + 4 :]
    (tmp_path / "a.jp2").write_bytes(whole[:at] + closed + b"\0\0\0\x0cxml <a/>")

    codestream, boxed = read_image(tmp_path / "a.j2k"), read_image(tmp_path / "a.jp2")

    np.testing.assert_array_equal(codestream, boxed)


def test_jpeg_is_read(tmp_path):
    image = np.add.outer(np.arange(48), np.arange(64)).astype(np.uint8)
    (tmp_path / "a.jpg").write_bytes(encoded(".jpg", image))

    assert read_image(tmp_path / "a.jpg") == pytest.approx(image, abs=4)


@pytest.mark.parametrize(
    ("header", "pixels", "values"),
    [
        (b"P5 3 2 255\n", b"abcdef", [[97, 98, 99], [100, 101, 102]]),
        (b"P5\n# 1 1 of a comment\n3\t2\n#\n100\n", b"\n#0123", [[10, 35, 48], [49, 50, 51]]),
        (b"P5 1 2 4095 ", b"\x0f\xff\x00\x01", [[4095], [1]]),
    ],
)
def test_pgm_is_read_as_netpbm_describes_it(tmp_path, header, pixels, values):
    (tmp_path / "a.pgm").write_bytes(header + pixels)

    assert read_image(tmp_path / "a.pgm").tolist() == values


@pytest.mark.parametrize("suffix", [".hdr", ".ppm"])
def test_other_formats_are_rejected(tmp_path, suffix):
    (tmp_path / "a.png").write_bytes(
        encoded(suffix, np.zeros((64, 64, 3), np.float32 if suffix == ".hdr" else np.uint8))
    )

    with pytest.raises(DataError, match="known format"):
        read_image(tmp_path / "a.png")


@pytest.mark.parametrize(
    ("channel", "value"), [("r", 30), ("g", 20), ("b", 10), (None, 0.299 * 30 + 0.587 * 20 + 0.114 * 10)]
)
@pytest.mark.parametrize("alpha", [[], [255]])
def test_colour_becomes_luminance_or_the_requested_channel(tmp_path, channel, value, alpha):
    (tmp_path / "a.png").write_bytes(encoded(".png", np.full((4, 4, 3 + len(alpha)), [10, 20, 30, *alpha], np.uint8)))

    assert read_image(tmp_path / "a.png", channel) == pytest.approx(value, abs=0.5)


@pytest.mark.parametrize("suffix", [".png", ".jpg", ".tif", ".bmp", ".pgm", ".webp", ".jp2"])
@pytest.mark.parametrize("kept", [0.0, 0.02, 0.5, 0.98])
def test_a_truncated_image_gives_one_error_and_nothing_on_stderr(tmp_path, rng, capfd, suffix, kept):
    whole = encoded(suffix, grey(rng))
    (tmp_path / f"a{suffix}").write_bytes(whole[: int(kept * len(whole))])

    with pytest.raises(DataError, match=r"cut short|not an image"):
        read_image(tmp_path / f"a{suffix}")

    assert capfd.readouterr().err == ""


def test_a_damaged_png_gives_one_error_and_nothing_on_stderr(tmp_path, rng, capfd):
    damaged = bytearray(encoded(".png", grey(rng)))
    damaged[len(damaged) // 2] ^= 0xFF
    (tmp_path / "a.png").write_bytes(damaged)

    with pytest.raises(DataError, match="chunk 'IDAT' fails its check"):
        read_image(tmp_path / "a.png")

    assert capfd.readouterr().err == ""


def test_a_damaged_jpeg_is_rejected_although_it_can_be_decoded(tmp_path, rng, capfd):
    damaged = bytearray(encoded(".jpg", grey(rng)))
    damaged[len(damaged) // 2 :] = rng.bytes(len(damaged) // 2 - 2).replace(b"\xff", b"\xfe") + b"\xff\xd9"
    assert cv2.imdecode(np.frombuffer(damaged, np.uint8), cv2.IMREAD_UNCHANGED) is not None
    assert "Corrupt JPEG data" in capfd.readouterr().err
    (tmp_path / "a.jpg").write_bytes(damaged)

    with pytest.raises(DataError, match="damaged"):
        read_image(tmp_path / "a.jpg")

    assert capfd.readouterr().err == ""


@pytest.mark.parametrize("padding", [bytes(16), b"\x7f" * 16, b"\xff" * 16, bytes(9) + b"\xff" * 9])
def test_jpeg_with_padding_before_its_end_marker_is_read(tmp_path, rng, capfd, padding):
    """Padding as in the motion JPEG frames of webcams."""
    whole = encoded(".jpg", grey(rng))
    (tmp_path / "a.jpg").write_bytes(whole[:-2] + padding + b"\xff\xd9")

    read = read_image(tmp_path / "a.jpg")

    np.testing.assert_array_equal(read, cv2.imdecode(np.frombuffer(whole, np.uint8), cv2.IMREAD_UNCHANGED))
    assert capfd.readouterr().err == ""


def test_a_jpeg_with_excess_pixels_is_rejected(tmp_path, rng):
    """A duplicated packet shifts all pixels after it, and the last ones remain before the end marker."""
    whole = encoded(".jpg", grey(rng))
    middle = len(whole) // 2
    (tmp_path / "a.jpg").write_bytes(whole[:middle] + whole[middle - 200 : middle] + whole[middle:])

    with pytest.raises(DataError, match="damaged"):
        read_image(tmp_path / "a.jpg")


def test_output_of_other_threads_on_stderr_is_passed_on_and_is_not_taken_as_damage(tmp_path, rng, capfd, monkeypatch):
    image = rng.integers(0, 256, (8, 8), dtype=np.uint8)
    (tmp_path / "a.png").write_bytes(encoded(".png", image))
    progress, decode = b"\x1b[2K3 shots\n", cv2.imdecode

    def decode_while_another_thread_writes(*arguments):
        thread = threading.Thread(target=os.write, args=(2, progress))
        thread.start()
        thread.join()
        return decode(*arguments)

    monkeypatch.setattr(cv2, "imdecode", decode_while_another_thread_writes)

    np.testing.assert_array_equal(read_image(tmp_path / "a.png"), image)
    assert capfd.readouterr().err.encode() == progress


def test_the_log_level_of_opencv_is_restored(tmp_path, rng, capfd):
    (tmp_path / "a.tif").write_bytes(encoded(".tif", grey(rng))[:-9])
    with pytest.raises(DataError):
        read_image(tmp_path / "a.tif")
    assert capfd.readouterr().err == ""

    cv2.imread(str(tmp_path / "missing.tif"))

    assert "missing.tif" in capfd.readouterr().err


@pytest.mark.parametrize(
    "content",
    [
        *(b"just words\n", b"PK\x03\x04", b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"%PDF-1.4"),
        *(b"P5 3 2 255\nabcde", b"P5 3 2 0 abcdef", b"P5 3 2 65536 " + bytes(18), b"P5 3 2"),
    ],
)
def test_a_file_that_is_not_an_image_is_rejected(tmp_path, capfd, content):
    (tmp_path / "a.png").write_bytes(content)

    with pytest.raises(DataError, match=r"a\.png: "):
        read_image(tmp_path / "a.png")

    assert capfd.readouterr().err == ""


@pytest.mark.parametrize(
    ("name", "finding"),
    [
        ("/dev/zero", "is a device, must be a file"),
        ("missing.png", "does not exist"),
        ("link.png", "cannot be opened: too many levels of symbolic links"),
    ],
)
def test_an_image_that_cannot_be_opened_is_a_missing_input(tmp_path, name, finding):
    (tmp_path / "link.png").symlink_to("link.png")

    with pytest.raises(NoInputError, match=finding):
        read_image(tmp_path / name)


def test_floating_point_pixels_are_rejected(tmp_path, rng):
    (tmp_path / "a.tif").write_bytes(encoded(".tif", grey(rng).astype(np.float32)))

    with pytest.raises(DataError, match="pixels of type float32"):
        read_image(tmp_path / "a.tif")


def pages(count: int) -> list[np.ndarray]:
    return [np.full((48, 64), 10 * page + 5, np.uint8) for page in range(count)]


def test_each_page_of_a_tiff_file_is_a_shot_of_its_own(tmp_path):
    assert cv2.imwritemulti(str(tmp_path / "stack.tif"), pages(12))

    shots = read_shots(tmp_path / "stack.tif")

    assert [shot.name for shot in shots] == [f"stack_{number}" for number in range(1, 13)]
    for shot, page in zip(shots, pages(12), strict=True):
        np.testing.assert_array_equal(shot.images, page[None])


def test_a_command_that_reads_one_image_rejects_several_pages(tmp_path):
    assert cv2.imwritemulti(str(tmp_path / "stack.tif"), pages(3))

    with pytest.raises(DataError, match="has 3 pages, must have one; give each page as an image"):
        read_image(tmp_path / "stack.tif")


def test_a_thumbnail_in_a_tiff_file_is_not_a_page(tmp_path):
    assert cv2.imwritemulti(str(tmp_path / "a.tif"), pages(2))
    whole = bytearray((tmp_path / "a.tif").read_bytes())
    entry = struct.pack("<HHI", 254, 4, 1)  # NewSubfileType, which OpenCV writes first
    second = whole.index(entry, whole.index(entry) + 1)
    whole[second + 8] = 1
    (tmp_path / "a.tif").write_bytes(whole)

    np.testing.assert_array_equal(read_image(tmp_path / "a.tif"), pages(1)[0])
