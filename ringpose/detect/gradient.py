"""Gradient and anchors of an image: where edges may run (ringpose-method(7), section 2)."""

from dataclasses import dataclass

import numpy as np

from ringpose.kernels import segments as kernels
from ringpose.types.arrays import Array, Int16, Int32, UInt, UInt8, UInt16
from ringpose.types.frame import full_scale_dn

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


def image_gradient(
    image: UInt8[Array, "row column"] | UInt16[Array, "row column"], upper_dn: float, bits: int = 8
) -> Gradient:
    """Gradient of the smoothed image, and the anchors of at least `upper_dn` grey values per pixel.

    Grey values are those of 8 bits: of 12 `bits`, the last four count as fractions.
    """
    magnitude, anchors, orientation = kernels.gradient(image, magnitude_steps(upper_dn), bits)
    return Gradient(magnitude=magnitude, anchors=anchors, orientation=orientation)


def magnitude_steps(gradient_dn: float) -> int:
    """Grey values per pixel in the kernels' unit: 1 to `LARGEST_STEPS`."""
    return round(min(max(1.0, STEPS_PER_DN * gradient_dn), LARGEST_STEPS))


def in_sixteen_bits(
    image: UInt[Array, "row column"], saturation_dn: int | None = None
) -> tuple[UInt8[Array, "row column"] | UInt16[Array, "row column"], int]:
    """The image in elements of 8 or 16 bits, and how many bits its values have; a wider one loses low bits.

    `saturation_dn` is the grey value at which a pixel is full; if it is not given, the image is asked.
    """
    if image.dtype == np.uint8:
        return image, 8
    if saturation_dn is None:
        saturation_dn = full_scale_dn(image) if image.itemsize == 2 else 0
    bits = max(saturation_dn, int(image.max(initial=0))).bit_length()
    if bits <= 8:
        return image.astype(np.uint8), 8
    if bits <= 16:
        return image.astype(np.uint16, copy=False), bits
    return (image >> (bits - 16)).astype(np.uint16), 16


def eight_bit(image: UInt[Array, "row column"]) -> UInt8[Array, "row column"]:
    """The image in 8 bits: a wider one loses low bits until its largest value fits, so 12 bits keep their contrast."""
    if image.dtype == np.uint8:
        return image
    excess = max(0, int(image.max(initial=0)).bit_length() - 8)
    return (image >> excess).astype(np.uint8)
