"""Straight line segments in an image."""

from dataclasses import dataclass

from jaxtyping import Float64, Int64

from ringpose.types.arrays import Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Segments:
    """Line segments of one image, in (distorted) pixels."""

    start_px: Float64[Array, "segment xy=2"]
    end_px: Float64[Array, "segment xy=2"]
    support: Int64[Array, "segment"]
    """Number of edge pixels that the segment stands for."""
