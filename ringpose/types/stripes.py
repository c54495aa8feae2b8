"""The laser stripes' centres, column by column."""

from dataclasses import dataclass

from jaxtyping import Float64, Int64

from ringpose.types.arrays import Array

UNLABELLED = -1
"""Laser of a stripe piece whose laser is not known."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stripes:
    """Sub-pixel centres of the stripes of one shot, in (distorted) pixels, sorted by piece, then column."""

    position_px: Float64[Array, "center xy=2"]
    sigma_px: Float64[Array, "center"]
    """Standard deviation along the column."""
    peak_dn: Float64[Array, "center"]
    piece: Int64[Array, "center"]
    """Number of the piece, from 0: centres linked along x without a gap or a jump."""
    laser: Int64[Array, "piece"]
    """Laser of each piece, or `UNLABELLED`."""
