"""The line detector of the paper (ringpose-method(7), section 2).

The sources are gradient.c (gradient and anchors), chains.c (edge chains and their straight pieces) and segments.c (line
fits and collinear lines).
"""

import numpy as np

from ringpose.kernels import _kernels
from ringpose.types.arrays import Array, Float64, Int16, Int32, Int64, UInt8, UInt16


def gradient(
    image: UInt8[Array, "row column"] | UInt16[Array, "row column"], upper: int, bits: int = 8
) -> tuple[Int16[Array, "row column"], Int32[Array, "anchor"], UInt8[Array, "anchor"]]:
    """Gradient magnitude, anchors (its local maxima), and the orientation of the edge at each anchor.

    The image is smoothed with the binomial 1 4 6 4 1 (sigma 1 px); then Sobel. The magnitude is max + 3/8 min of the
    two absolute components (7 % from the Euclidean one), in units of 1/128 grey value per pixel. It is 0 on the
    outermost three pixels, whose gradient needs pixels outside the image: extrapolation would bend the edges there.
    Anchors are maxima of at least `upper` (same unit): along the row in every eighth row, if the edge is nearer to
    upright, else down the column in every eighth column. They come as `row * width + column` in ascending order; their
    orientation is 0 for an edge along x, 1 down to the right, 2 along y, 3 down to the left. Images of 16-bit elements
    have values of `bits` bits, 9 to 16, and are scaled to 8 bits with `bits` - 8 fractional bits.
    """
    magnitude = np.empty(image.shape, np.int16)
    anchors, orientation = _kernels.gradient(np.ascontiguousarray(image), bits, upper, magnitude)
    return magnitude, np.frombuffer(anchors, np.int32), np.frombuffer(orientation, np.uint8)


def chains(
    magnitude: Int16[Array, "row column"],
    anchors: Int32[Array, "anchor"],
    orientation: UInt8[Array, "anchor"],
    lower: int,
    shortest: int,
) -> tuple[Int32[Array, "pixel xy=2"], Int32[Array, "start"]]:
    """Edge chains, one pixel wide: their pixels, and the index of the first pixel of each chain (last entry: the end).

    From each anchor, the strongest first, two walks in opposite directions; a walk goes to the largest magnitude of
    the three pixels ahead (straight on, if equal; then left) and stops below `lower`, on another chain, or where one
    of the three is among the image's outermost three pixels; anchors must not lie there. Chains of fewer than
    `shortest` pixels are dropped, but no other chain may cross them.
    The magnitude serves as scratch memory and is restored on return: no other thread may use it in the meantime.
    """
    pixels, starts = _kernels.chains(magnitude, anchors, orientation, lower, shortest)
    return np.frombuffer(pixels, np.int32).reshape(-1, 2), np.frombuffer(starts, np.int32)


def cuts(
    pixels: Int32[Array, "pixel xy=2"],
    starts: Int32[Array, "start"],
    deviation_px: float,
    share_change: float,
    window: int,
    shortest: int,
) -> Int32[Array, "piece end=2"]:
    """First and last pixel of each straight piece of the chains (method(7), section 2); neighbours share the corner."""
    pieces = _kernels.cuts(pixels, starts, deviation_px, share_change, window, shortest)
    return np.frombuffer(pieces, np.int32).reshape(-1, 2)


def fits(
    magnitude: Int16[Array, "row column"],
    pixels: Int32[Array, "pixel xy=2"],
    pieces: Int32[Array, "piece end=2"],
    trim: int,
) -> tuple[Float64[Array, "piece end=2 xy=2"], Float64[Array, "piece moment=6"]]:
    """Ends of the least-squares line through the sub-pixel maxima of the magnitude along each piece.

    A maximum is the vertex of the parabola through three magnitudes across the piece's longer side, down a column or
    along a row. `trim` pixels at both ends, but never more than a quarter of the piece, are rounded corners and
    stay out.
    The line ends at the end pixels of the piece, projected along its longer side; with fewer than two maxima it is the
    chord. The moments are the sums over the maxima of 1, x, y, x x, x y and y y.
    """
    lines, moments = _kernels.fits(magnitude, pixels, pieces, trim)
    return np.frombuffer(lines).reshape(-1, 2, 2), np.frombuffer(moments).reshape(-1, 6)


def joins(
    lines: Float64[Array, "piece end=2 xy=2"],
    moments: Float64[Array, "piece moment=6"],
    pieces: Int32[Array, "piece end=2"],
    gap_px: float,
    aside_px: float,
    shortest: int,
) -> tuple[Float64[Array, "line end=2 xy=2"], Int64[Array, "line"]]:
    """Lines after joining those that continue each other, and the number of supporting pixels of each.

    From the first line to the last, each of at least `shortest` pixels takes the nearest line beyond its end, at
    most `gap_px` ahead and 2 `aside_px` beside or behind, and again from the new end, as long as all ends of both lie
    within `aside_px` (measured along x or y) of the least-squares line through the maxima of both; then beyond its
    start. Shorter lines that were not joined to another are dropped.
    """
    flat = np.ascontiguousarray(lines).reshape(-1, 4)
    joined, support = _kernels.joins(flat, moments, pieces, gap_px, aside_px, shortest)
    return np.frombuffer(joined).reshape(-1, 2, 2), np.frombuffer(support, np.int64)
