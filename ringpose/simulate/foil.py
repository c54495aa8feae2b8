"""Crinkled foil: a periodic height field with its slopes, baked once from its seed."""

import functools
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float32, Float64

from ringpose.types.arrays import Array
from ringpose.types.scene import Foil

_TEXELS = 512
_CRINKLES = 16
"""Of the largest size, along one period."""
_OCTAVES = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Relief:
    """Height and slopes on a periodic grid over the body's front face."""

    texel_m: float
    height_slopes: Float32[Array, "row column height_slope=3"]
    """Height in metres, slope along x, slope along y."""

    def tangent(
        self, x: Float64[Array, "ray"], y: Float64[Array, "ray"]
    ) -> tuple[Float32[Array, "ray"], Float32[Array, "ray"], Float32[Array, "ray"]]:
        """Height and slopes of the plane that touches the relief at the nearest point of the grid."""
        column, row = np.rint(x / self.texel_m), np.rint(y / self.texel_m)
        index = (row.astype(np.int64) % _TEXELS) * _TEXELS + column.astype(np.int64) % _TEXELS
        height, slope_x, slope_y = self.height_slopes.reshape(-1, 3).take(index, axis=0).T
        off_x, off_y = (x - column * self.texel_m, y - row * self.texel_m)
        return (height + slope_x * off_x + slope_y * off_y).astype(np.float32), slope_x, slope_y

    def slopes(
        self, x: Float64[Array, "ray"], y: Float64[Array, "ray"]
    ) -> tuple[Float32[Array, "ray"], Float32[Array, "ray"]]:
        """Slopes along x and y, bilinear between the grid's points, so that glints show no grid."""
        column, share_x = _split(x / self.texel_m)
        row, share_y = _split(y / self.texel_m)
        right, below = (column + 1) % _TEXELS, ((row + 1) % _TEXELS) * _TEXELS
        row *= _TEXELS
        grid = self.height_slopes.reshape(-1, 3)[:, 1:]
        top = grid.take(row + column, axis=0) * (1 - share_x) + grid.take(row + right, axis=0) * share_x
        bottom = grid.take(below + column, axis=0) * (1 - share_x) + grid.take(below + right, axis=0) * share_x
        slope_x, slope_y = (top + (bottom - top) * share_y).T
        return slope_x, slope_y


@functools.lru_cache(maxsize=4)
def relief(foil: Foil) -> Relief:
    """The height field of a foil: ridged noise, finer and lower octave by octave.

    Folding smooth noise at zero gives the sharp creases between smooth facets that crinkled foil has.
    """
    texel_m = foil.crinkle_m * _CRINKLES / _TEXELS
    generator = np.random.default_rng(foil.seed)
    height = sum(_ridges(generator, _CRINKLES * 2**octave) / 2.2**octave for octave in range(_OCTAVES))
    height = np.asarray(height - np.mean(height))
    height *= foil.rms_m / height.std()
    slopes = [(np.roll(height, -1, axis) - np.roll(height, 1, axis)) / (2 * texel_m) for axis in (1, 0)]
    return Relief(texel_m=texel_m, height_slopes=np.stack([height, *slopes], axis=-1).astype(np.float32))


def _ridges(generator: np.random.Generator, crinkles: int) -> Float64[Array, "row column"]:
    """Smooth periodic noise with about so many bumps along a side, folded at zero, warped along one direction."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(_TEXELS, 1 / _TEXELS), np.fft.fftfreq(_TEXELS, 1 / _TEXELS)))
    band = np.exp(-(((frequency - crinkles / 2) / (crinkles / 4)) ** 2))
    noise = np.fft.ifft2(band * np.fft.fft2(generator.standard_normal((_TEXELS, _TEXELS)))).real
    noise /= noise.std()
    return -np.sqrt(noise**2 + 0.02)


def _split(position: Float64[Array, "ray"]) -> tuple[np.ndarray, np.ndarray]:
    whole = np.floor(position)
    return whole.astype(np.int64) % _TEXELS, (position - whole).astype(np.float32)[:, None]
