"""Noise of a pixel, and of the speckle of neighbouring pixels, without an image.

Light is in electrons, lengths are in pixels; the sensor is that of EMVA 1288 (`ringpose.optics.sensor`).
"""

from dataclasses import dataclass
from math import erfc, pi, sqrt

import numpy as np

from ringpose.types.arrays import Array, Float64

PIXEL_VARIANCE = 1.0 / 12.0
"""Variance of a uniform distribution over one pixel."""

PIXEL_GRAIN = 0.5 / sqrt(pi)
"""Correlation length at which the speckle of each pixel is independent."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ImageNoise:
    """Blur and noise of one scene's images."""

    blur_px: float
    contrast: float
    grain_px: float
    """Correlation length (sigma) of the speckle in the sense exp(-distance^2 / (4 grain^2))."""
    dark_e2: float
    """Variance of a pixel without light, in square electrons, that of the subtracted frame included."""
    frames: int
    """Number of frames whose background light contributes shot noise: 2 if one is subtracted."""
    response: float
    """Relative standard deviation of the pixels' response."""
    full_e: float
    """Electrons at which a pixel saturates."""

    @property
    def blurred_grain_px(self) -> float:
        """Correlation length of the speckle behind the lens."""
        return sqrt(self.grain_px**2 + self.blur_px**2)


def speckle_correlation(at: Float64[Array, "n"], noise: ImageNoise) -> Float64[Array, "n n"]:
    """Correlation of the speckle of neighbouring pixels before the blur; independent up to a grain of one pixel."""
    lag = at[:, None] - at
    if noise.grain_px <= PIXEL_GRAIN:
        return np.eye(len(at))
    return np.exp(-(lag**2) / (4 * noise.grain_px**2))


def gauss(offset: Float64[Array, "*shape"], sigma: float) -> Float64[Array, "*shape"]:
    """Sampled Gaussian of unit sum; the identity for sigma 0."""
    if sigma == 0.0:
        return (np.abs(offset) < 0.5).astype(np.float64)
    return np.asarray(np.exp(-0.5 * (offset / sigma) ** 2) / (sqrt(2 * pi) * sigma))


def normal_cdf(x: Float64[Array, "*shape"]) -> Float64[Array, "*shape"]:
    """The normal distribution function, interpolated in a table: an edge blurred by 1."""
    return np.asarray(np.interp(x, _CDF_AT, _CDF))


_CDF_AT = np.linspace(-6.0, 6.0, 2401)
_CDF = np.array([0.5 * erfc(-each / sqrt(2.0)) for each in _CDF_AT.tolist()])
