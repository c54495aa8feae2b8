"""Crinkled foil: a periodic height field with its slopes, computed once from its seed."""

import functools
from typing import NamedTuple

import numpy as np

from ringpose.kernels.render import TEXELS
from ringpose.types.arrays import Array, Float32, Float64
from ringpose.types.target import Foil


class Relief(NamedTuple):
    """Height and slopes on a periodic grid, in rows along the first axis of a face."""

    texel_m: float
    height_m: Float32[Array, "row column"]
    slope: Float32[Array, "row column uv=2"]


_CRINKLES = 16
"""Number of the largest crinkles along one period."""

_OCTAVES = 3


@functools.lru_cache(maxsize=4)
def relief(foil: Foil) -> Relief:
    """The height field of a foil: ridged noise, each octave finer and lower than the one before.

    Folding smooth noise at zero gives the sharp creases between smooth facets that crinkled foil has.
    """
    texel_m = foil.crinkle_m * _CRINKLES / TEXELS
    generator = np.random.default_rng(foil.seed)
    height = sum(_ridges(generator, _CRINKLES * 2**octave) / 2.2**octave for octave in range(_OCTAVES))
    height = np.asarray(height - np.mean(height))
    height *= foil.rms_m / height.std()
    slopes = [(np.roll(height, -1, axis) - np.roll(height, 1, axis)) / (2 * texel_m) for axis in (1, 0)]
    return Relief(texel_m, height.astype(np.float32), np.stack(slopes, axis=-1).astype(np.float32))


def _ridges(generator: np.random.Generator, crinkles: int) -> Float64[Array, "row column"]:
    """Smooth periodic noise with about this number of bumps along a side, folded at zero."""
    frequency = np.hypot(*np.meshgrid(np.fft.fftfreq(TEXELS, 1 / TEXELS), np.fft.fftfreq(TEXELS, 1 / TEXELS)))
    band = np.exp(-(((frequency - crinkles / 2) / (crinkles / 4)) ** 2))
    noise = np.fft.ifft2(band * np.fft.fft2(generator.standard_normal((TEXELS, TEXELS)))).real
    noise /= noise.std()
    ridges: Float64[Array, "row column"] = -np.sqrt(noise**2 + 0.02)
    return ridges
