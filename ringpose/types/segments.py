"""Straight line segments in an image."""

from dataclasses import dataclass

from ringpose.types.arrays import Array, Float64, Int64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Segments:
    """Line segments of one image, in (distorted) pixels."""

    start_px: Float64[Array, "segment xy=2"]
    end_px: Float64[Array, "segment xy=2"]
    support: Int64[Array, "segment"]
    """Number of edge pixels that the segment stands for."""
