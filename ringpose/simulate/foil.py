"""Crinkled foil: a periodic height field with its slopes, baked once from its seed."""

import functools
from dataclasses import dataclass

import numpy as np

from ringpose.types.arrays import Array, Complex64, Float32, Float64, Int64
from ringpose.types.scene import Foil

_TEXELS = 512
_CRINKLES = 16
"""Of the largest size, along one period."""
_OCTAVES = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Relief:
    """Height and slopes on a periodic grid over the body's front face, row by row."""

    texel_m: float
    height_m: Float32[Array, "texel"]
    slope: Complex64[Array, "texel"]
    """Slope along x as the real part, along y as the imaginary one: a single look-up fetches both."""

    def tangent(
        self, x: Float64[Array, "ray"], y: Float64[Array, "ray"]
    ) -> tuple[Float64[Array, "ray"], Complex64[Array, "ray"]]:
        """Height and slope of the plane that touches the relief at the nearest point of the grid."""
        column, row = np.rint(x / self.texel_m), np.rint(y / self.texel_m)
        index = _index(column.astype(np.int64), row.astype(np.int64))
        slope = self.slope.take(index)
        off_x, off_y = x - column * self.texel_m, y - row * self.texel_m
        return self.height_m.take(index) + slope.real * off_x + slope.imag * off_y, slope

    def slopes(self, x: Float64[Array, "ray"], y: Float64[Array, "ray"]) -> Complex64[Array, "ray"]:
        """Slope, bilinear between the grid's points, so that glints show no grid."""
        column, share_x = _split(x / self.texel_m)
        row, share_y = _split(y / self.texel_m)
        corners = ((column, row), (column + 1, row), (column, row + 1), (column + 1, row + 1))
        near, right, below, far = (self.slope.take(_index(*corner)) for corner in corners)
        top, bottom = near + (right - near) * share_x, below + (far - below) * share_x
        slope: Complex64[Array, "ray"] = top + (bottom - top) * share_y
        return slope


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
    slope = (slopes[0] + 1j * slopes[1]).astype(np.complex64)
    return Relief(texel_m=texel_m, height_m=height.astype(np.float32).ravel(), slope=slope.ravel())


def _ridges(generator: np.random.Generator, crinkles: int) -> Float64[Array, "row column"]:
    """Smooth periodic noise with about so many bumps along a side, folded at zero, warped along one direction."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(_TEXELS, 1 / _TEXELS), np.fft.fftfreq(_TEXELS, 1 / _TEXELS)))
    band = np.exp(-(((frequency - crinkles / 2) / (crinkles / 4)) ** 2))
    noise = np.fft.ifft2(band * np.fft.fft2(generator.standard_normal((_TEXELS, _TEXELS)))).real
    noise /= noise.std()
    ridges: Float64[Array, "row column"] = -np.sqrt(noise**2 + 0.02)
    return ridges


def _index(column: Int64[Array, "ray"], row: Int64[Array, "ray"]) -> Int64[Array, "ray"]:
    index: Int64[Array, "ray"] = (row % _TEXELS) * _TEXELS + column % _TEXELS
    return index


def _split(position: Float64[Array, "ray"]) -> tuple[Int64[Array, "ray"], Float32[Array, "ray"]]:
    whole = np.floor(position)
    return whole.astype(np.int64), (position - whole).astype(np.float32)
