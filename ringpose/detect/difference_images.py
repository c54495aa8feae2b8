"""The frames of a shot by laser: each laser alone if switched one by one, else those that were on together."""

import math
from dataclasses import dataclass

import numpy as np

from ringpose.types.arrays import Array, UInt
from ringpose.types.image import Frame, Shot


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaserImage:
    """A frame with lasers on, and the background image to subtract."""

    lit: UInt[Array, "row column"]
    dark: UInt[Array, "row column"] | None
    saturation_dn: int
    """Grey value at which a pixel saturates."""
    lasers: tuple[int, ...]
    """Lasers that its stripes may belong to."""
    stamp_s: float
    """Mid exposure."""
    dark_stamp_s: float = math.nan
    """Mid exposure of the background; NaN without one."""
    usual_full_dn: int | None = None
    """Grey value that thresholds are relative to; `saturation_dn` if None."""

    @property
    def threshold_scale_dn(self) -> int:
        """Saturation value of a single exposure, to which thresholds are relative."""
        return self.saturation_dn if self.usual_full_dn is None else self.usual_full_dn

    @property
    def labelled(self) -> bool:
        """Whether its stripes can belong to a single laser only."""
        return len(self.lasers) == 1


def laser_images(shot: Shot, count: int, earlier: Frame | None = None) -> list[LaserImage]:
    """The frames to search for stripes, such that each of `count` lasers that was on is covered once.

    A frame with a single laser on takes precedence over frames with several. The background is the suitable frame
    nearest in time, because the ambient light on a tumbling target changes. `earlier`: a frame without lasers for a
    shot that has none.
    """
    images, covered = [], 0
    masks: list[int] = shot.lasers.tolist()
    for number in sorted(range(len(masks)), key=lambda each: (masks[each].bit_count(), each)):
        mask = masks[number]
        new = mask & ~covered & ((1 << count) - 1)
        if new:
            lasers = tuple(laser for laser in range(count) if new >> laser & 1)
            images.append(_laser_image(shot, number, lasers, mask & covered, earlier))
            covered |= mask
    return images


def repeated_image(shot: Shot, images: list[LaserImage]) -> LaserImage | None:
    """A frame with several lasers on that shows the stripes of `images`, of one laser each, once more; None without."""
    lasers = {laser for image in images for laser in image.lasers}
    if not all(image.labelled for image in images):
        return None
    for number, mask in enumerate(shot.lasers.tolist()):
        shown = tuple(laser for laser in sorted(lasers) if mask >> laser & 1)
        if len(shown) > 1:
            return _laser_image(shot, number, shown, 0, None)
    return None


def brightest_image(shot: Shot) -> UInt[Array, "row column"]:
    """The first of the images with the most lasers on."""
    on = [mask.bit_count() for mask in shot.lasers.tolist()]
    image: UInt[Array, "row column"] = shot.images[int(np.argmax(on))]
    return image


def _laser_image(shot: Shot, number: int, lasers: tuple[int, ...], also_on: int, earlier: Frame | None) -> LaserImage:
    """A frame with the background nearest in time in which exactly the lasers `also_on` are on, if there is one."""
    dark, dark_stamp_s = None, math.nan
    same = [each for each, mask in enumerate(shot.lasers.tolist()) if mask == also_on]
    if same:
        nearest = min(same, key=lambda each: abs(shot.stamp_s[each] - shot.stamp_s[number]))
        dark, dark_stamp_s = shot.images[nearest], shot.mid_exposure_s(nearest)
    elif earlier is not None and also_on == earlier.lasers:
        dark, dark_stamp_s = earlier.image, earlier.stamp_s + earlier.exposure_s / 2
    return LaserImage(
        lit=shot.images[number],
        dark=dark,
        saturation_dn=shot.saturation_dn,
        lasers=lasers,
        stamp_s=shot.mid_exposure_s(number),
        dark_stamp_s=dark_stamp_s,
        usual_full_dn=shot.merged_full_dn,
    )
