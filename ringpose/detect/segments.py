"""Straight segments of an image: the paper's line detector (ringpose-method(7), section 2)."""

from dataclasses import dataclass

import numpy as np

from ringpose.detect.chains import Chains, edge_chains
from ringpose.detect.gradient import Gradient, image_gradient, in_sixteen_bits
from ringpose.kernels import segments as kernels
from ringpose.types.arrays import Array, Int32, UInt
from ringpose.types.detection import Segments
from ringpose.types.options import SegmentMethod


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentParameters:
    """Thresholds of the line detector, for 8-bit images.

    The paper does not give its own. These stand where recall on the York Urban photographs and on synthetic laser
    stripes (grey-value peaks of 38 and 170, speckle) is flat: a quarter more or less changes it by a hundredth or two.
    """

    upper_gradient_dn: float = 4.0
    """An anchor has at least this gradient, in grey values per pixel of the smoothed image."""
    lower_gradient_dn: float = 2.0
    """Where the gradient is less, there is no edge. In clutter thresholds of 3.0 and 1.5 cost a fifth more time and
    recall two hundredths more on the York Urban photographs; on stripes they change nothing."""
    shortest_px: int = 12
    """Chains of fewer pixels are dropped, and segments that rest on fewer."""
    deviation_px: float = 1.0
    """A piece ends where its estimated length exceeds its chord by more; the cut goes to its farthest pixel."""
    share_change: float = 0.7
    """A piece ends where the direction shares differ by more (sum over the three; 2 is a right angle); digitising
    alone changes the shares of a straight line by up to 2 / `window_steps`."""
    window_steps: int = 8
    """Steps over which the shares are taken; the cut goes back half of them."""
    shortest_joined_px: int = 6
    """Straight pieces of so many pixels may become part of a refined segment: speckle breaks an edge into short ones,
    and with those of 12 pixels alone a fiftieth of the length recalled on the York Urban photographs is lost."""
    gap_px: float = 8.0
    """Lines with a larger gap between them are not joined; a laser's shadow at the edge of a ring is wider."""
    aside_px: float = 1.5
    """Nor those with an end farther aside of the joined line. Speckle moves edges by a pixel: 1.0 leaves twice as many
    fragments of a stripe as 1.5."""


def find_segments(
    image: UInt[Array, "row column"],
    parameters: SegmentParameters = SegmentParameters(),
    method: SegmentMethod = SegmentMethod.REFINED,
    saturation_dn: int | None = None,
) -> Segments:
    """Straight edges of the image; thresholds mean grey values of 8 bits whatever the image has.

    How many bits that are follows from the grey value at which a pixel is full; without it the image is asked, and a
    dim one may be taken for that of a narrower camera.
    """
    narrowed, bits = in_sixteen_bits(image, saturation_dn)
    gradient = image_gradient(narrowed, parameters.upper_gradient_dn, bits)
    chains = edge_chains(gradient, parameters.lower_gradient_dn, parameters.shortest_px)
    return chords(chains, parameters) if method is SegmentMethod.LENGTH else refined(gradient, chains, parameters)


def chords(chains: Chains, parameters: SegmentParameters) -> Segments:
    """Each straight piece as the line from its first to its last pixel: within a pixel of the edge."""
    pieces = straight_pieces(chains, parameters, parameters.shortest_px)
    ends_px = chains.pixels[pieces].astype(np.float64)
    support = (pieces[:, 1] - pieces[:, 0] + 1).astype(np.int64)
    return Segments(start_px=ends_px[:, 0], end_px=ends_px[:, 1], support=support)


def refined(gradient: Gradient, chains: Chains, parameters: SegmentParameters) -> Segments:
    """Least-squares lines through the sub-pixel positions of straight pieces, those joined that make one line."""
    pieces = straight_pieces(chains, parameters, parameters.shortest_joined_px)
    lines_px, moments = kernels.fits(gradient.magnitude, chains.pixels, pieces, parameters.window_steps // 2)
    ends_px, support = kernels.joins(
        lines_px, moments, pieces, parameters.gap_px, parameters.aside_px, parameters.shortest_px
    )
    return Segments(start_px=ends_px[:, 0], end_px=ends_px[:, 1], support=support)


def straight_pieces(chains: Chains, parameters: SegmentParameters, shortest_px: int) -> Int32[Array, "piece end=2"]:
    """First and last pixel of each straight piece of so many pixels or more: length condition and direction shares."""
    return kernels.cuts(
        chains.pixels,
        chains.starts,
        parameters.deviation_px,
        parameters.share_change,
        parameters.window_steps,
        shortest_px,
    )
