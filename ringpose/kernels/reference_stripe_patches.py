"""Readable NumPy twin of `stripe_patches.c`: derivatives of the smoothed image down its columns."""

from typing import NamedTuple

import numpy as np

from ringpose.kernels.stripes import Filters
from ringpose.types.arrays import Array, Float32, Int64, UInt

Pixels = Float32[Array, "row column"]


class Filter(NamedTuple):
    """One of `Filters`."""

    slope: Float32[Array, "tap"]
    bend: Float32[Array, "tap"]
    sigma: float
    slope_norm: float
    bend_norm: float

    @property
    def reach(self) -> int:
        """Taps beyond the middle."""
        return len(self.bend) - 1


def split_filters(filters: Filters) -> list[Filter]:
    """The filters one by one."""
    return [
        Filter(taps[0, : int(reach) + 1], taps[1, : int(reach) + 1], float(sigma), float(slope_norm), float(bend_norm))
        for taps, (sigma, reach, slope_norm, bend_norm) in zip(filters.taps, filters.figures, strict=True)
    ]


def pixels_of(image: UInt[Array, "row column"], dark: UInt[Array, "row column"] | None) -> Pixels:
    """Grey values without ambient light."""
    ambient = 0 if dark is None else dark.astype(np.int64)
    return (image.astype(np.int64) - ambient).astype(np.float32)


def sections(
    pixels: Pixels, row: Int64[Array, "*place"], column: Int64[Array, "*place"], reach: int
) -> Float32[Array, "*place height"]:
    """The pixels above and below some places; beyond the border the outermost pixels are repeated."""
    height, width = pixels.shape
    rows = np.clip(row[..., None] + np.arange(-reach, reach + 1), 0, height - 1)
    section: Float32[Array, "*place height"] = pixels[rows, np.clip(column, 0, width - 1)[..., None]]
    return section


def bend(filter_: Filter, section: Float32[Array, "*place height"]) -> Float32[Array, "*place"]:
    """Second derivative in the middle of each section, summed in the order in which the kernel does."""
    total: Float32[Array, "*place"] = filter_.bend[0] * section[..., filter_.reach]
    for k in range(1, filter_.reach + 1):
        total = total + filter_.bend[k] * (section[..., filter_.reach - k] + section[..., filter_.reach + k])
    return total


def slope(filter_: Filter, section: Float32[Array, "*place height"]) -> Float32[Array, "*place"]:
    """First derivative, likewise; positive where it grows brighter downwards."""
    total: Float32[Array, "*place"] = np.zeros(section.shape[:-1], np.float32)
    for k in range(1, filter_.reach + 1):
        total = total + filter_.slope[k] * (section[..., filter_.reach + k] - section[..., filter_.reach - k])
    return total
