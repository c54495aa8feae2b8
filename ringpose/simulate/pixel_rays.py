"""One ray for every pixel, through the lens, and sixteen where one is not enough."""

import functools
from dataclasses import dataclass

import numpy as np

from ringpose.geometry.rays import undistort
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.camera import Camera

SAMPLES = 16
"""Samples of a refined pixel: an edge moves by 0.003 px rms against 256 of them."""

FINE_SAMPLES = 256
"""Samples of a pixel in which an edge cuts a stripe: sixteen moved a stripe's end by up to 0.06 px."""

_KNOTS = 100
"""Knots each way between which the lens is interpolated: 1e-6 px off for an 8 mm lens."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PixelRays:
    """Rays (x, y, 1) through the pixels' centres, and how they turn within a pixel."""

    direction: Float64[Array, "xy=2 pixel"]
    per_px: Float64[Array, "axis=2 xy=2 pixel"]
    """Change of (x, y) for one pixel along the row, and for one along the column."""
    height: int
    width: int

    @property
    def angle_per_px(self) -> float:
        """What one pixel covers at depth 1, in the middle of the picture."""
        return float(np.abs(self.per_px[:, :, self.direction.shape[1] // 2 + self.width // 2]).max())


@functools.lru_cache(maxsize=2)
def pixel_rays(camera: Camera) -> PixelRays:
    """The rays of a camera; a spline between knots undistorts two million pixels in 30 ms."""
    from scipy.interpolate import RectBivariateSpline

    height, width = camera.image_height, camera.image_width
    knots_x, knots_y = _knots(width), _knots(height)
    knots_px = np.stack(np.meshgrid(knots_x, knots_y), axis=-1)
    splines = [RectBivariateSpline(knots_y, knots_x, part) for part in np.moveaxis(undistort(knots_px, camera), -1, 0)]
    rows, columns = np.arange(height, dtype=np.float64), np.arange(width, dtype=np.float64)
    direction, along_row, along_column = (
        np.stack([spline(rows, columns, dx=of_row, dy=of_column).ravel() for spline in splines])
        for of_row, of_column in ((0, 0), (0, 1), (1, 0))
    )
    return PixelRays(direction=direction, per_px=np.stack([along_row, along_column]), height=height, width=width)


def centre_directions(rays: PixelRays, pixels: slice) -> Float64[Array, "xyz=3 ray"]:
    """Rays through the centres of a run of pixels."""
    x, y = rays.direction[:, pixels]
    return np.stack([x, y, np.ones_like(x)])


def sample_directions(
    rays: PixelRays, pixels: Int64[Array, "n"], samples: int = SAMPLES
) -> Float64[Array, "xyz=3 ray"]:
    """Rays of the samples of some pixels, sample by sample: ray s * n + k is sample s of pixel k."""
    shift_x, shift_y = _shifts_px(pixels, rays.width, samples)
    along_row, along_column = rays.per_px[:, :, None, pixels]
    x, y = rays.direction[:, None, pixels] + shift_x * along_row + shift_y * along_column
    return np.stack([x.ravel(), y.ravel(), np.ones(x.size)])


def _shifts_px(
    pixels: Int64[Array, "n"], width: int, samples: int
) -> tuple[Float64[Array, "sample n"], Float64[Array, "sample #n"]]:
    """As many rows and columns as samples, each taken once (Hammersley's set; a power of two).

    The rows are the same in all pixels, so that a stripe's profile is integrated by the midpoint rule;
    the columns are shifted around from pixel to pixel, so that upright edges show no bands.
    """
    bits, order = samples.bit_length() - 1, np.arange(samples)
    reversed_bits = sum(((order >> bit) & 1) << (bits - 1 - bit) for bit in range(bits))
    turn = np.modf(0.7548776662 * (pixels % width) + 0.5698402910 * (pixels // width))[0]
    across = np.modf(order[:, None] / samples + turn)[0] - 0.5
    return across, ((np.asarray(reversed_bits) + 0.5) / samples - 0.5)[:, None]


def _knots(length: int) -> Float64[Array, "knot"]:
    return np.linspace(-1.0, float(length), _KNOTS)
