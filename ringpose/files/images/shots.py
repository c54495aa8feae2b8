"""Shots: one NPZ file each, or a plain image as a shot of one frame."""

from pathlib import Path
from typing import Any

import numpy as np

from ringpose.errors import DataError, NoInputError
from ringpose.files import records
from ringpose.files.images.codecs import IMAGE_SUFFIXES, read_image, read_pages
from ringpose.files.npz import Archive, write_archive
from ringpose.files.schema import Fields, late_stamp
from ringpose.types.arrays import Array, Float64, UInt, UInt8
from ringpose.types.image import ALL_LASERS, Shot, check_shot_size
from ringpose.types.plausible import EXPOSURE_S, STAMP_S
from ringpose.types.rig import Rig

SHOT_SUFFIXES = (".npz", *IMAGE_SUFFIXES)

_REQUIRED = ("images", "lasers", "stamp_s", "exposure_s")
_TIMES = ("device_stamp_s", "gain_db")
_MASKS = ("seen_lasers", "read_lasers")
_KEYS = (*_REQUIRED, *_TIMES, "frame_id", *_MASKS, "meta")

MAX_EXPOSURE = 5.0
"""Maximum exposure as a share of the time between two frames: 1, and a margin for stamps of a busy host."""


def read_shot(path: Path, channel: str | None = None, rig: Rig | None = None) -> Shot:
    """The shot in an NPZ file, or an image as a shot of one frame with all lasers on.

    The shot's name is the file's without suffix. If a rig is given, the shot must match it: the masks contain only
    lasers of the rig, and the images have the camera's size. The mask of a plain image has the bits of all lasers of
    the rig (`ALL_LASERS` without a rig), its stamp is the file's modification time, and its exposure is 0 (unknown).
    """
    if path.suffix.lower() == ".npz":
        return shot_of(Archive(path), rig)
    image = read_image(path, channel, None if rig is None else rig.camera)
    shot = _shot_of_image(path, path.stem, image, ALL_LASERS if rig is None else (1 << len(rig.lasers.names)) - 1)
    return shot if rig is None else checked_shot(shot, rig, str(path))


def read_shots(path: Path, channel: str | None = None) -> list[Shot]:
    """The shot in a file as `read_shot` has it, or one for each page of a TIFF file: a.tif has a_1, a_2, and so on."""
    if path.suffix.lower() == ".npz":
        return [shot_of(Archive(path))]
    pages = read_pages(path, channel)
    names = [path.stem] if len(pages) == 1 else [f"{path.stem}_{number + 1}" for number in range(len(pages))]
    return [_shot_of_image(path, name, page, ALL_LASERS) for name, page in zip(names, pages, strict=True)]


def _shot_of_image(path: Path, name: str, image: UInt[Array, "row column"], lasers: int) -> Shot:
    try:
        changed_s = max(path.stat().st_mtime, 0.0)
    except OSError:
        raise NoInputError(str(path), "disappeared while it was read") from None
    return Shot(
        name=name,
        images=image[None],
        lasers=np.array([lasers], np.uint8),
        stamp_s=np.array([changed_s]),
        exposure_s=np.zeros(1),
    )


def shot_of(archive: Archive, rig: Rig | None = None) -> Shot:
    """The shot in an open archive."""
    if "schema" in archive:
        raise DataError(str(archive.path), "is a detection", "give a shot")
    archive.reject_unknown(_KEYS)
    images = _images(archive, rig)
    frames = len(images)
    optional: dict[str, Any] = {key: archive.numbers(key, (frames,)) for key in _TIMES if key in archive}
    optional |= {key: _masks(archive, key, frames) for key in _MASKS if key in archive}
    if "frame_id" in archive:
        optional["frame_id"] = archive.integers("frame_id", (frames,))
    lasers, meta = _masks(archive, "lasers", frames), _meta(archive)
    stamp_s, exposure_s = _times(archive, frames)
    shot = Shot(
        name=archive.path.stem,
        images=images,
        lasers=lasers,
        stamp_s=stamp_s,
        exposure_s=exposure_s,
        meta=meta,
        **optional,
    )
    if rig is not None:
        _check_masks(shot, rig, str(archive.path))
    return shot


def write_shot(path: Path, shot: Shot, *, force: bool = False) -> None:
    """Write a shot as NPZ, without the keys that it does not have."""
    arrays = {key: getattr(shot, key) for key in _KEYS if key != "meta" and getattr(shot, key) is not None}
    meta = {"meta": np.array(records.line_of(shot.meta).strip())} if shot.meta else {}
    write_archive(path, arrays | meta, force=force)


def checked_shot(shot: Shot, rig: Rig, location: str) -> Shot:
    """The shot; rejected if its masks or image size do not match the rig. `location` is used in messages."""
    _check_masks(shot, rig, location)
    frames, height, width = shot.images.shape
    check_shot_size(location, frames, width, height, rig.camera)
    return shot


def _check_masks(shot: Shot, rig: Rig, location: str) -> None:
    lasers = len(rig.lasers.names)
    for frame, mask in enumerate(shot.lasers.tolist()):
        if mask >> lasers:
            finding = f"frame {frame} names laser {mask.bit_length()}, the rig has {lasers}"
            raise DataError(f"{location}: lasers", finding, "give the rig that took the shot")


def _images(archive: Archive, rig: Rig | None) -> UInt[Array, "frame row column"]:
    """The images in an archive; the declared type and size are checked before memory of that size is allocated."""
    dtype, shape = archive.declared("images", "u", ("frames", "rows", "columns"))
    frames, height, width = shape
    if 0 in shape:
        raise archive.problem("images", f"has {frames} frames of {width} x {height} pixels, must have one or more")
    if dtype.itemsize > 2:
        raise archive.problem("images", f"has type {dtype}, must have 8 or 16 bits")
    check_shot_size(str(archive.path), frames, width, height, None if rig is None else rig.camera)
    return archive.loaded("images").astype(dtype.newbyteorder("="), copy=False)


def _masks(archive: Archive, key: str, frames: int) -> UInt8[Array, "frame"]:
    masks = archive.integers(key, (frames,))
    if masks.min() < 0 or masks.max() > 255:
        raise archive.problem(key, f"has the mask {masks.min() if masks.min() < 0 else masks.max()}, must be 0 to 255")
    return masks.astype(np.uint8)


def _times(archive: Archive, frames: int) -> tuple[Float64[Array, "frame"], Float64[Array, "frame"]]:
    """Stamps and exposures, which must fit between the stamps.

    Stamps may be in any order; equal stamps, of frames without stamps of their own, are accepted.
    """
    times: list[Float64[Array, "frame"]] = [archive.numbers(key, (frames,)) for key in ("stamp_s", "exposure_s")]
    for key, values in zip(("stamp_s", "exposure_s"), times, strict=True):
        if values.min() < 0:
            raise archive.problem(key, f"is {values.min():g} in frame {values.argmin()}, must not be negative")
    stamp_s, exposure_s = times
    if stamp_s.max() > STAMP_S.highest:
        raise archive.problem("stamp_s", *late_stamp(stamp_s.max()))
    if exposure_s.max() > EXPOSURE_S.highest:
        finding, remedy = EXPOSURE_S.finding(float(exposure_s.max()))
        raise archive.problem("exposure_s", f"{finding} (frame {exposure_s.argmax()})", remedy)
    apart_s = np.diff(np.sort(stamp_s))
    least_s, longest_s = apart_s[apart_s > 0].min(initial=np.inf), exposure_s.max()
    if longest_s > MAX_EXPOSURE * least_s:
        finding = f"is {longest_s:g} s, but frames are {least_s:g} s apart"
        raise archive.problem("exposure_s", finding, "give both in seconds")
    return stamp_s, exposure_s


def _meta(archive: Archive) -> dict[str, Any]:
    if "meta" not in archive:
        return {}
    location = f"{archive.path}: meta"
    meta = records.parsed_record(archive.text("meta"), location)
    for key in ("saturation_dn", "usual_full_dn"):
        if meta.get(key) is not None:
            Fields(location, meta).number(key, least=1)
    return meta
