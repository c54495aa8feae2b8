"""What a camera delivers: one frame, and the shot that several frames of one moment make up."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from ringpose.types.arrays import Array, Float64, Int64, UInt, UInt8

ALL_LASERS = 255
"""Mask of an image that is read without a rig: all lasers on, however many there are."""

PER_FRAME = (
    "lasers", "stamp_s", "exposure_s", "device_stamp_s", "gain_db", "frame_id", "seen_lasers", "read_lasers",
)  # fmt: skip
"""What a shot knows of each of its frames beside the image."""

USUAL_BITS = (8, 10, 12, 14)
"""Of cameras whose grey values lie in the lower bits of 16."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """One exposure: grey values and what was lit while it was taken."""

    image: UInt[Array, "row column"]
    lasers: int
    """Mask: bit i is laser i of the rig on."""
    stamp_s: float
    """Host clock (Unix epoch, UTC) at the start of exposure."""
    exposure_s: float
    device_stamp_s: float | None = None
    """The camera's own clock; None where it has none."""
    frame_id: int | None = None
    """The camera's own number of the frame."""
    gain_db: float | None = None
    attempts: int = 1
    """Triggers that it took to get this frame whole."""
    dropped: int = 0
    """Frames that the camera numbered since the one before, and that never came."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shot:
    """The frames of one moment, each with its laser mask; the target is taken as at rest between them."""

    name: str
    images: UInt[Array, "frame row column"]
    lasers: UInt8[Array, "frame"]
    stamp_s: Float64[Array, "frame"]
    exposure_s: Float64[Array, "frame"]
    device_stamp_s: Float64[Array, "frame"] | None = None
    gain_db: Float64[Array, "frame"] | None = None
    frame_id: Int64[Array, "frame"] | None = None
    seen_lasers: UInt8[Array, "frame"] | None = None
    """What the images show, as opposed to what was commanded."""
    read_lasers: UInt8[Array, "frame"] | None = None
    """What the laser board reported, as opposed to what was commanded."""
    meta: Mapping[str, Any] = field(default_factory=dict)

    @property
    def frames(self) -> Iterator[Frame]:
        """The frames in the order in which they were taken."""
        for image, lasers, stamp_s, exposure_s in zip(
            self.images, self.lasers, self.stamp_s, self.exposure_s, strict=True
        ):
            yield Frame(image=image, lasers=int(lasers), stamp_s=float(stamp_s), exposure_s=float(exposure_s))

    @property
    def measured_at_s(self) -> float:
        """The shot's own stamp: mid exposure of its first laser-on frame, of its first frame if none is lit."""
        lit = np.flatnonzero(self.lasers)
        first = int(lit[0]) if len(lit) else 0
        return float(self.stamp_s[first] + self.exposure_s[first] / 2)

    @property
    def saturation_dn(self) -> int:
        """The grey value at which a pixel is full: what `meta` says, else what the images allow."""
        limit = self.meta.get("saturation_dn")
        return int(limit) if limit is not None else full_scale_dn(self.images)

    @property
    def usual_full_dn(self) -> int:
        """What thresholds on grey values scale with: of merged exposures the full value of the longest alone."""
        merged = self.merged_full_dn
        return self.saturation_dn if merged is None else merged

    @property
    def merged_full_dn(self) -> int | None:
        """The full value of the longest exposure, if several were merged."""
        usual = self.meta.get("usual_full_dn")
        return None if usual is None else int(usual)


def shot_with_frames(shot: Shot, chosen: Int64[Array, "chosen"]) -> Shot:
    """The shot with some of its frames, in the order in which they are named."""
    known = {name: getattr(shot, name) for name in ("images", *PER_FRAME)}
    return replace(shot, **{name: values[chosen] for name, values in known.items() if values is not None})


def full_scale_dn(images: UInt[Array, "*shape"]) -> int:
    """The largest grey value that a camera could have given, as far as the images tell.

    8 bits have 255. Of more, it is that of the least of 8, 10, 12, 14 and 16 bits that hold every value; in 16 without
    the lowest bits that no value has, as a camera leaves them that fills elements from the top. So nothing is called
    full that is not, and a dim image is taken for one of a narrower camera.
    """
    most = (1 << 8 * images.dtype.itemsize) - 1
    if images.dtype.itemsize == 1:
        return most
    used = int(np.bitwise_or.reduce(images, axis=None, initial=0))
    unused = (used & -used) - 1
    return next((2**bits - 1 for bits in USUAL_BITS if used < 2**bits), most - unused)
