"""Laser speckle: the granularity that limits every stripe centre."""

import cv2
import numpy as np

from ringpose.types.arrays import Array, Float32
from ringpose.types.scene import Speckle


def speckle_pattern(
    speckle: Speckle, height: int, width: int, generator: np.random.Generator
) -> Float32[Array, "row column"]:
    """A factor of mean 1 and the given contrast for each pixel.

    Log-normal, which at contrast 0.3 differs little from the gamma law of several speckle patterns added up,
    and which keeps mean and contrast exactly whatever the grain. A Gaussian of sigma s correlates over
    2 sqrt(pi) s.
    """
    pattern = generator.standard_normal((height, width), dtype=np.float32)
    if speckle.grain_px > 1.0:
        sigma_px = speckle.grain_px / (2 * np.sqrt(np.pi))
        pattern = np.asarray(cv2.GaussianBlur(pattern, (0, 0), sigma_px), dtype=np.float32)
        pattern /= max(float(pattern.std()), 1e-6)
    variance = np.log1p(speckle.contrast**2)
    factor: Float32[Array, "row column"] = np.exp(np.float32(np.sqrt(variance)) * pattern - np.float32(variance / 2))
    return factor
