"""Gradient and anchors of an image: where edges may run (MATH.md section 2)."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Int16, Int32, UInt, UInt8

from ringpose import kernels
from ringpose.types.arrays import Array

STEPS_PER_DN = 128
"""Units of the kernels' magnitude in one grey value per pixel: 16 of the smoothing, 8 of the Sobel weights."""

LARGEST_STEPS = 32767
"""More than any 8-bit pattern gives."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Gradient:
    """Gradient magnitude and its maxima across the edge."""

    magnitude: Int16[Array, "row column"]
    """In 1 / `STEPS_PER_DN` grey value per pixel."""
    anchors: Int32[Array, "anchor"]
    """As `row * width + column`, ascending."""
    orientation: UInt8[Array, "anchor"]
    """0: edge along x, 1: down to the right, 2: along y, 3: down to the left."""


def image_gradient(image: UInt8[Array, "row column"], upper_dn: float) -> Gradient:
    """Gradient of the smoothed image, and the anchors of at least `upper_dn` grey values per pixel."""
    magnitude, anchors, orientation = kernels.gradient(image, magnitude_steps(upper_dn))
    return Gradient(magnitude=magnitude, anchors=anchors, orientation=orientation)


def magnitude_steps(gradient_dn: float) -> int:
    """Grey values per pixel in the kernels' unit: 1 to `LARGEST_STEPS`."""
    return round(min(max(1.0, STEPS_PER_DN * gradient_dn), LARGEST_STEPS))


def eight_bit(image: UInt[Array, "row column"]) -> UInt8[Array, "row column"]:
    """The image in 8 bits: a wider one loses low bits until its largest value fits.

    So 12 bits in 16 keep their contrast, and thresholds in grey values mean the same for every camera.
    """
    if image.dtype == np.uint8:
        return image
    excess = max(0, int(image.max(initial=0)).bit_length() - 8)
    return (image >> excess).astype(np.uint8)
