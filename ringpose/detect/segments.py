"""Straight segments of an image: the paper's line detector (MATH.md section 2)."""

from dataclasses import dataclass
from typing import Literal

import numpy as np
from jaxtyping import Int32, UInt

from ringpose import kernels
from ringpose.detect.chains import Chains, edge_chains
from ringpose.detect.gradient import eight_bit, image_gradient
from ringpose.types.arrays import Array
from ringpose.types.segments import Segments


@dataclass(frozen=True, slots=True, kw_only=True)
class SegmentParameters:
    """Thresholds of the line detector."""

    upper_gradient_dn: float = 4.0
    lower_gradient_dn: float = 2.0
    shortest_px: int = 15
    deviation_px: float = 0.5
    share_change: float = 0.7
    window_steps: int = 12


def find_segments(
    image: UInt[Array, "row column"],
    parameters: SegmentParameters = SegmentParameters(),
    method: Literal["length"] = "length",
) -> Segments:
    """Straight edges of the image, each as the chord of its pixels."""
    gradient = image_gradient(eight_bit(image), parameters.upper_gradient_dn)
    chains = edge_chains(gradient, parameters.lower_gradient_dn, parameters.shortest_px)
    return chords(chains, straight_pieces(chains, parameters))


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
    """Each piece as the line from its first to its last pixel."""
    ends = chains.pixels[pieces].astype(np.float64)
    return Segments(start_px=ends[:, 0], end_px=ends[:, 1], support=(pieces[:, 1] - pieces[:, 0] + 1).astype(np.int64))
