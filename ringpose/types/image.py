"""Camera images: a single frame, and a shot, which is a short sequence of frames with different lasers on."""

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.types.arrays import Array, Float64, Int64, UInt, UInt8
from ringpose.types.rig import Camera

ALL_LASERS = 255
"""Laser mask of an image file: all lasers on, whatever their number."""

PER_FRAME = (
    "lasers", "stamp_s", "exposure_s", "device_stamp_s", "gain_db", "frame_id", "seen_lasers", "read_lasers",
)  # fmt: skip
"""Attributes of a shot with one value per frame, besides the images."""

MAX_SHOT_PIXELS = 256_000_000
"""Maximum number of pixels in all frames of a shot together."""

USUAL_BITS = (8, 10, 12, 14)
"""Bit depths of cameras whose grey values occupy the lower bits of 8 or 16."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """One exposure: grey values, the lasers that were on, and time stamps."""

    image: UInt[Array, "row column"]
    lasers: int
    """Mask: bit i is laser i of the rig on."""
    stamp_s: float
    """Host clock (Unix epoch, UTC) at the start of the exposure."""
    exposure_s: float
    device_stamp_s: float | None = None
    """Time stamp of the camera's clock; None if it does not provide one."""
    frame_id: int | None = None
    """Frame number assigned by the camera."""
    gain_db: float | None = None
    attempts: int = 1
    """Number of triggers until this frame was received completely."""
    dropped: int = 0
    """Number of frames lost since the previous one, by the camera's frame numbers."""
    shot: str = ""
    """Name of its shot, if the camera names shots."""

    @property
    def mid_exposure_s(self) -> float:
        """Time stamp of the middle of the exposure."""
        return self.stamp_s + self.exposure_s / 2


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shot:
    """Frames taken in quick succession, each with its laser mask; the target may move between them."""

    name: str
    images: UInt[Array, "frame row column"]
    lasers: UInt8[Array, "frame"]
    stamp_s: Float64[Array, "frame"]
    exposure_s: Float64[Array, "frame"]
    device_stamp_s: Float64[Array, "frame"] | None = None
    gain_db: Float64[Array, "frame"] | None = None
    frame_id: Int64[Array, "frame"] | None = None
    seen_lasers: UInt8[Array, "frame"] | None = None
    """Mask of the lasers visible in the image, as opposed to those commanded."""
    read_lasers: UInt8[Array, "frame"] | None = None
    """Mask read back from the laser board, as opposed to that commanded."""
    meta: Mapping[str, Any] = field(default_factory=dict)

    @property
    def frames(self) -> Iterator[Frame]:
        """The frames in chronological order."""
        for image, lasers, stamp_s, exposure_s in zip(
            self.images, self.lasers, self.stamp_s, self.exposure_s, strict=True
        ):
            yield Frame(image=image, lasers=int(lasers), stamp_s=float(stamp_s), exposure_s=float(exposure_s))

    @property
    def still(self) -> bool:
        """Whether the target was held still while the shot was taken, as `meta` states."""
        return self.meta.get("still") is True

    @property
    def ambient_changed(self) -> bool:
        """Whether ambient light changed within the shot, as `meta` states."""
        return "ambient_change_dn" in self.meta

    @property
    def is_lost(self) -> bool:
        """Whether ambient light changed so much that its frames cannot be compared, as `meta` of a live shot states."""
        return self.meta.get("lost") is True

    @property
    def measured_at_s(self) -> float:
        """Time stamp of the shot: mid exposure of its first frame with a laser on, or of its first frame."""
        lit = np.flatnonzero(self.lasers)
        return self.mid_exposure_s(int(lit[0]) if len(lit) else 0)

    def mid_exposure_s(self, frame: int) -> float:
        """Time stamp of the middle of a frame's exposure."""
        return float(self.stamp_s[frame] + self.exposure_s[frame] / 2)

    @property
    def saturation_dn(self) -> int:
        """Grey value at which a pixel saturates: from `meta`, otherwise estimated from the images."""
        limit = self.meta.get("saturation_dn")
        return int(limit) if limit is not None else full_scale_dn(self.images)

    @property
    def usual_full_dn(self) -> int:
        """Grey value that thresholds are relative to: of merged exposures, the saturation value of the longest."""
        merged = self.merged_full_dn
        return self.saturation_dn if merged is None else merged

    @property
    def merged_full_dn(self) -> int | None:
        """Saturation value of the longest exposure, if several were merged."""
        usual = self.meta.get("usual_full_dn")
        return None if usual is None else int(usual)


def shot_with_frames(shot: Shot, chosen: Int64[Array, "chosen"]) -> Shot:
    """The shot with the chosen frames, in the given order."""
    known = {name: getattr(shot, name) for name in ("images", *PER_FRAME)}
    return replace(shot, **{name: values[chosen] for name, values in known.items() if values is not None})


def searched_frames(masks: Sequence[int], count: int) -> list[tuple[int, tuple[int, ...], int]]:
    """The frames of a shot that are searched for stripes, such that each of `count` lasers that is on is covered once.

    For each frame its number, the lasers whose stripes are searched in it, and the mask of the others that are on.
    Frames with fewer lasers on take precedence.
    """
    frames, covered = [], 0
    for number in sorted(range(len(masks)), key=lambda each: (masks[each].bit_count(), each)):
        mask = masks[number]
        if new := mask & ~covered & ((1 << count) - 1):
            frames.append((number, tuple(laser for laser in range(count) if new >> laser & 1), mask & covered))
            covered |= mask
    return frames


def check_shot_size(location: str, frames: int, width: int, height: int, camera: Camera | None) -> None:
    """Reject a shot that is too large, or whose size is not the camera's; `location` is used in messages."""
    if camera is not None and (width, height) != (camera.image_width, camera.image_height):
        finding = f"{width} x {height} pixels, the rig's camera has {camera.image_width} x {camera.image_height}"
        raise DataError(location, finding, "give the rig that took the shot")
    if frames * width * height > MAX_SHOT_PIXELS:
        finding = f"declares {frames} x {width} x {height} pixels, must have at most {MAX_SHOT_PIXELS / 1e6:g} million"
        raise DataError(location, finding, "give fewer frames, or crop them")


def board_image(shot: Shot) -> UInt[Array, "row column"]:
    """The image of a shot in which the board is searched: the frame with the lasers off.

    Without such a frame, the minimum of all frames, which removes switched stripes.
    """
    dark = dark_image(shot)
    return np.min(shot.images, axis=0) if dark is None else dark


def dark_image(shot: Shot) -> UInt[Array, "row column"] | None:
    """The first frame with the lasers off, if there is one."""
    off = np.flatnonzero(shot.lasers == 0)
    return shot.images[off[0]] if len(off) else None


def full_scale_dn(images: UInt[Array, "*shape"]) -> int:
    """Saturation value of the camera, estimated from the images.

    255 for elements of 8 bits. For wider ones, the maximum of the smallest bit depth of 8, 10, 12, 14 and 16 that holds
    every value; of 16 bits without the lowest bits that are zero everywhere, as of a camera that aligns its values to
    the top. Hence no unsaturated pixel is taken as saturated, but a dim image may be attributed a smaller bit depth.
    """
    full_dn = (1 << 8 * images.dtype.itemsize) - 1
    if images.dtype.itemsize == 1:
        return full_dn
    used = int(np.bitwise_or.reduce(images, axis=None, initial=0))
    unused = (used & -used) - 1
    return next((2**bits - 1 for bits in USUAL_BITS if used < 2**bits), full_dn - unused)


def name_order(name: str) -> list[tuple[int, str]]:
    """Sorts names by the numbers in them, the order in which the images were taken: view 2 before view 10."""
    return [(int(part), "") if part.isdecimal() else (0, part) for part in re.split(r"(\d+)", name)]
