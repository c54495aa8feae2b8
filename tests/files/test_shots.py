import io
import os
import pickle
import zipfile

import cv2
import numpy as np
import pytest

from ringpose.errors import DataError
from ringpose.files.images.shots import read_shot, write_shot
from ringpose.files.rigs import read_rig
from ringpose.types.image import ALL_LASERS, Shot


def arrays(rng, frames=3, size=(480, 640)):
    return {
        "images": rng.integers(0, 255, (frames, *size), dtype=np.uint8),
        "lasers": np.arange(frames, dtype=np.uint8),
        "stamp_s": 1.7e9 + np.arange(frames) * 0.02,
        "exposure_s": np.full(frames, 0.005),
    }


def saved(path, values):
    np.savez(path, **values)
    return path


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_shot_is_read_as_it_was_written(tmp_path, rng, dtype):
    values = arrays(rng) | {
        "device_stamp_s": np.array([5.0, 5.1, 5.2]),
        "gain_db": np.array([-3.0, 0.0, 12.0]),
        "frame_id": np.array([7, 8, 10]),
        "seen_lasers": np.array([0, 1, 2], np.uint8),
        "read_lasers": np.array([0, 1, 3], np.uint8),
    }
    values["images"] = values["images"].astype(dtype) * (dtype(257) if dtype is np.uint16 else dtype(1))
    before = Shot(name="a", meta={"saturation_dn": 4095, "camera": "ä"}, **values)

    write_shot(tmp_path / "a.npz", before)
    after = read_shot(tmp_path / "a.npz")

    assert (after.name, after.meta) == ("a", before.meta)
    assert {key: getattr(after, key).dtype for key in values} == {key: array.dtype for key, array in values.items()}
    assert all(np.array_equal(getattr(after, key), array) for key, array in values.items())


def test_shot_of_another_program_is_read(tmp_path, rng):
    values = arrays(rng)
    values["lasers"] = values["lasers"].astype(np.int64)
    values["stamp_s"] = values["stamp_s"].astype(">f8")
    values["images"] = values["images"].astype(">u2")

    shot = read_shot(saved(tmp_path / "a.npz", values | {"x_mine": np.zeros(1)}))

    assert (shot.lasers.dtype, shot.stamp_s.dtype, shot.images.dtype) == (np.uint8, np.float64, np.uint16)
    np.testing.assert_array_equal(shot.images, values["images"])


@pytest.mark.parametrize(
    ("key", "value", "finding"),
    [
        ("images", np.zeros((3, 4, 5), np.float64), "images: has type float64"),
        ("images", np.zeros((3, 4, 5), np.uint32), "images: has type uint32"),
        ("images", np.zeros((4, 5), np.uint8), "images: has shape 4 x 5, must have frames x rows x columns"),
        ("images", np.zeros((0, 4, 5), np.uint8), "images: has 0 frames"),
        ("lasers", np.zeros(2, np.uint8), "lasers: has shape 2, must have 3"),
        ("lasers", np.array([0, 1, 256]), "lasers: has the mask 256"),
        ("lasers", np.array([0, 1, -1]), "lasers: has the mask -1"),
        ("lasers", np.zeros(3), "lasers: has type float64"),
        ("stamp_s", np.array([1, np.nan, 2]), "stamp_s: has a number that is not finite"),
        ("stamp_s", np.array([1, -1, 2.0]), "stamp_s: is -1 in frame 1, must not be negative"),
        ("exposure_s", np.full(3, 40.0), "exposure_s: is 40 s, but frames are"),
        (
            "exposure_s",
            np.full(3, 4000.0),
            "exposure_s: is 4000, must be 1e-06 to 60 (frame 0); give seconds: 4 if it is in milli",
        ),
        ("stamp_s", 1.7e12 + 20.0 * np.arange(3), "stamp_s: is 1.7e+12, which is after the year 2100; give seconds"),
        ("stamp_s", np.array(["a", "b", "c"]), "stamp_s: has type <U1, must be floating point"),
        ("exposure_s", np.array([1, np.inf, 2]), "exposure_s: has a number that is not finite"),
        ("exposure_s", np.array([0.1, 0.1, -0.1]), "exposure_s: is -0.1 in frame 2"),
        ("gain_db", np.array([np.nan, 0, 0]), "gain_db: has a number that is not finite"),
        ("meta", np.array("{broken"), "meta: is not valid JSON"),
        ("meta", np.array(3), "meta: has type int64"),
        ("meta", np.array('{"saturation_dn": "full"}'), "meta: saturation_dn: is the text 'full', must be a number"),
        ("meta", np.array('{"saturation_dn": 0}'), "meta: saturation_dn: is 0, must be at least 1"),
        ("schema", np.array("ringpose/detection/1"), "is a detection; give a shot"),
        ("image", np.zeros(3), "unknown key 'image'; did you mean 'images'?"),
        *((key, None, f"has no key '{key}'") for key in ("images", "lasers", "stamp_s", "exposure_s")),
    ],
)
def test_an_invalid_shot_is_rejected_with_its_key(tmp_path, rng, key, value, finding):
    values = arrays(rng) | {key: value}
    file = saved(tmp_path / "a.npz", {key: value for key, value in values.items() if value is not None})

    with pytest.raises(DataError) as caught:
        read_shot(file)

    assert str(caught.value).startswith(f"{file}: {finding}")


class _Bomb:
    def __reduce__(self):
        return os.mkdir, ("should-never-exist",)


def test_pickled_objects_are_never_run(tmp_path, rng, monkeypatch):
    monkeypatch.chdir(tmp_path)
    file = tmp_path / "a.npz"
    np.savez(file, allow_pickle=True, **arrays(rng), meta=np.array([_Bomb()], dtype=object))

    with pytest.raises(DataError, match="pickle"):
        read_shot(file)

    assert not (tmp_path / "should-never-exist").exists()


def _npy(values) -> bytes:
    stream = io.BytesIO()
    np.save(stream, values)
    return stream.getvalue()


def _archive(member: bytes) -> bytes:
    """An archive with these bytes as its images."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        archive.writestr("images.npy", member)
    return stream.getvalue()


CONTENTS = {
    "empty": b"",
    "letters": b"PK",
    "zeros": b"PK\x03\x04" + bytes(60),
    "pickle": pickle.dumps({"images": 1}),
    "png": b"\x89PNG",
    "npy": _npy(np.zeros(3)),
    "header without end": _archive(b"\x93NUMPY\x01\x00v\x00{"),
    "invalid header": _archive(b"\x93NUMPY\x01\x00\x04\x00{:(\n"),
    "no array": _archive(b"no array"),
}


@pytest.mark.parametrize("content", CONTENTS.values(), ids=CONTENTS)
def test_a_file_that_is_not_an_archive_is_rejected(tmp_path, content):
    (tmp_path / "a.npz").write_bytes(content)

    with pytest.raises(DataError, match="NPZ archive") as caught:
        read_shot(tmp_path / "a.npz")

    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("kept", [0.001, 0.3, 0.7, 0.999, None])
def test_a_truncated_or_damaged_shot_is_rejected(tmp_path, rng, kept):
    write_shot(tmp_path / "a.npz", Shot(name="a", **arrays(rng)))
    content = bytearray((tmp_path / "a.npz").read_bytes())
    if kept is None:
        content[len(content) // 2] ^= 0xFF
    (tmp_path / "a.npz").write_bytes(content if kept is None else content[: int(kept * len(content))])

    with pytest.raises(DataError, match="NPZ archive"):
        read_shot(tmp_path / "a.npz")


def test_an_image_is_a_shot_of_one_frame_with_all_lasers_on(tmp_path, rng, rig_file):
    image = rng.integers(0, 255, (480, 640), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), image)
    os.utime(tmp_path / "a.png", (1.5e9, 1.5e9))

    shot = read_shot(tmp_path / "a.png", rig=read_rig(rig_file()))

    assert (shot.name, shot.lasers.tolist(), shot.stamp_s.tolist()) == ("a", [0b11], [1.5e9])
    np.testing.assert_array_equal(shot.images, image[None])
    assert read_shot(tmp_path / "a.png").lasers.tolist() == [ALL_LASERS]


def test_a_mask_of_a_laser_that_the_rig_does_not_have_is_rejected(tmp_path, rng, rig_file):
    file = saved(tmp_path / "a.npz", arrays(rng) | {"lasers": np.array([0, 3, 4], np.uint8)})

    with pytest.raises(DataError, match="lasers: frame 2 names laser 3, the rig has 2"):
        read_shot(file, rig=read_rig(rig_file()))
