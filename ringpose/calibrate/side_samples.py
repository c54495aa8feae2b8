"""The pixels beside a marker's side, as shares of the rise from dark to bright.

Rows are read where a side runs down the image, columns where it runs along: between pixels nothing is interpolated.
"""

from typing import NamedTuple

import numpy as np

from ringpose.calibrate.side_curves import MINIMUM_SAMPLES, Side
from ringpose.calibrate.side_light import Light, smooth_level
from ringpose.types.arrays import Array, Bool, Float64, UInt8

FLANK_BLURS, LEAST_FLANK, LARGEST_FLANK = 3.0, 0.3, 0.6
"""Pixels beyond so many standard deviations of the blur tell dark and bright; between these shares of the reach."""

LEAST_RISE = 0.5
"""Share of the rise that a line of pixels shows at least where there is an edge."""


class SideSamples(NamedTuple):
    """One row for each line of pixels across the side."""

    t: Float64[Array, "line"]
    """Where it crosses the side."""
    across: Float64[Array, "line pixel"]
    """How far outside the side."""
    share: Float64[Array, "line pixel"]
    """Of the rise."""
    used: Bool[Array, "line pixel"]
    """Within reach, where there is an edge."""
    spacing: float
    """Distance of a line's pixels across the side."""


def side_samples(
    image: UInt8[Array, "row column"], side: Side, extent: tuple[float, float], light: Light, blur_px: float
) -> SideSamples | None:
    """Of a side less a share at its ends, and so far across it; None where too little of its edge is seen."""
    left_out, reach = extent
    clear_px = float(np.clip(FLANK_BLURS * blur_px, LEAST_FLANK * reach, LARGEST_FLANK * reach))
    t, across, grey = _pixels(image, side, left_out, reach)
    inside, outside = ((sign * across >= clear_px) & (np.abs(across) <= reach) for sign in (-1.0, 1.0))
    seen = inside.any(axis=1) & outside.any(axis=1)
    if seen.sum() < MINIMUM_SAMPLES:
        return None
    t, across, grey, inside, outside = (each[seen] for each in (t, across, grey, inside, outside))
    in_image = np.where(np.isfinite(across), across, 0.0)
    falls = [float(slope @ side.normal) * in_image for slope in light]
    levels = [_mean(grey - fall, flank) for fall, flank in zip(falls, (inside, outside), strict=True)]
    dark, bright = (smooth_level(t, level)[:, None] + fall for level, fall in zip(levels, falls, strict=True))
    rise = np.median(bright - dark, axis=1)
    there = (rise > 0) & (levels[1] - levels[0] > LEAST_RISE * rise)
    if there.sum() < MINIMUM_SAMPLES:
        return None
    share = (grey - dark) / np.where(there[:, None], bright - dark, 1.0)
    used = there[:, None] & (np.abs(across) <= reach)
    return SideSamples(t, across, share, used, _spacing(side))


def _pixels(
    image: UInt8[Array, "row column"], side: Side, left_out: float, reach: float
) -> tuple[Float64[Array, "line"], Float64[Array, "line pixel"], Float64[Array, "line pixel"]]:
    """Where each line of pixels crosses the side, how far outside the side its pixels are, and their grey."""
    lies = abs(side.along[0]) >= abs(side.along[1])
    lined, crossed = (0, 1) if lies else (1, 0)
    ends = np.sort(side.start[lined] + np.array([left_out, 1.0 - left_out]) * side.length * side.along[lined])
    lines = np.arange(np.ceil(ends[0]), np.floor(ends[1]) + 1)
    t = (lines - side.start[lined]) / side.along[lined]
    t = t - side.offset(t) * side.normal[lined] / side.along[lined]
    middle = side.points(t, np.zeros(len(t)))[:, crossed]
    most = int(np.ceil(reach / _spacing(side)))
    pixels = np.rint(middle)[:, None] + np.arange(-most, most + 1)
    upright = side.normal[crossed] - side.slope(t) * side.along[crossed]
    across = (pixels - middle[:, None]) * upright[:, None]
    picture = image if lies else image.T
    size = picture.shape
    within = (pixels >= 0) & (pixels < size[0]) & ((lines >= 0) & (lines < size[1]))[:, None]
    row = np.clip(pixels, 0, size[0] - 1).astype(np.int64)
    column = np.clip(lines, 0, size[1] - 1).astype(np.int64)
    return t, np.where(within, across, np.inf), picture[row, column[:, None]].astype(np.float64)


def _spacing(side: Side) -> float:
    return float(np.abs(side.normal).max())


def _mean(grey: Float64[Array, "line pixel"], flank: Bool[Array, "line pixel"]) -> Float64[Array, "line"]:
    mean: Float64[Array, "line"] = np.sum(grey, axis=1, where=flank) / flank.sum(axis=1)
    return mean
