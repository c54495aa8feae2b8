"""Straight segments of an image: the paper's line detector (MATH.md section 2)."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Float64, Int32, UInt

from ringpose import kernels
from ringpose.detect.chains import Chains, edge_chains
from ringpose.detect.gradient import Gradient, image_gradient
from ringpose.types.arrays import Array
from ringpose.types.segments import Segments

Method = Literal["length", "refined"]
"""`length`: the paper's chords; `refined`: one sub-pixel least-squares line for each of the same pieces."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentParameters:
    """Thresholds of the line detector, for 8-bit images.

    The paper does not give its own. These stand where recall on the York Urban photographs and on synthetic laser
    stripes (grey-value peaks of 38 and 170, speckle) is flat: a third more or less changes it by a hundredth or two.
    """

    upper_gradient_dn: float = 3.0
    """An anchor has at least this gradient, in grey values per pixel of the smoothed image."""
    lower_gradient_dn: float = 1.5
    """Where the gradient is less, there is no edge."""
    shortest_px: int = 12
    """Chains and straight pieces of fewer pixels are dropped."""
    deviation_px: float = 1.0
    """A piece ends where its estimated length exceeds its chord by more; the cut goes to its farthest pixel."""
    share_change: float = 0.7
    """A piece ends where the direction shares differ by more (sum over the three; 2 is a right angle); digitising
    alone changes the shares of a straight line by up to 2 / `window_steps`."""
    window_steps: int = 8
    """Steps over which the shares are taken; the cut goes back half of them."""


def find_segments(
    image: UInt[Array, "row column"],
    parameters: SegmentParameters = SegmentParameters(),
    method: Method = "length",
) -> Segments:
    """Straight edges of the image; thresholds mean grey values of 8 bits whatever the image has."""
    gradient = image_gradient(image, parameters.upper_gradient_dn)
    chains = edge_chains(gradient, parameters.lower_gradient_dn, parameters.shortest_px)
    pieces = straight_pieces(chains, parameters)
    if method == "refined":
        return lines(gradient, chains, pieces, trim=parameters.window_steps // 2)
    return chords(chains, pieces)


def straight_pieces(chains: Chains, parameters: SegmentParameters) -> Int32[Array, "piece end=2"]:
    """First and last pixel of each straight piece: length condition and direction shares."""
    return kernels.cuts(
        chains.pixels,
        chains.starts,
        parameters.deviation_px,
        parameters.share_change,
        parameters.window_steps,
        parameters.shortest_px,
    )


def chords(chains: Chains, pieces: Int32[Array, "piece end=2"]) -> Segments:
    """Each piece as the line from its first to its last pixel: within a pixel of the edge."""
    return segments_between(chains.pixels[pieces].astype(np.float64), pieces)


def lines(gradient: Gradient, chains: Chains, pieces: Int32[Array, "piece end=2"], trim: int) -> Segments:
    """Each piece as the least-squares line of its sub-pixel positions, `trim` pixels left out at both ends."""
    return segments_between(kernels.fits(gradient.magnitude, chains.pixels, pieces, trim), pieces)


def segments_between(ends_px: Float64[Array, "piece end=2 xy=2"], pieces: Int32[Array, "piece end=2"]) -> Segments:
    """The record of segments between given ends."""
    support = (pieces[:, 1] - pieces[:, 0] + 1).astype(np.int64)
    return Segments(start_px=ends_px[:, 0], end_px=ends_px[:, 1], support=support)
