"""The laser stripes' centres, column by column."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringpose.types.arrays import Array, Float64, Int64

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


def joined_stripes(parts: Sequence[Stripes]) -> Stripes:
    """Stripes of several frames or windows in one record, their pieces numbered on."""
    if len(parts) == 1:
        return parts[0]
    before = np.cumsum([0, *(len(part.laser) for part in parts[:-1])])
    return Stripes(
        position_px=np.concatenate([part.position_px for part in parts]),
        sigma_px=np.concatenate([part.sigma_px for part in parts]),
        peak_dn=np.concatenate([part.peak_dn for part in parts]),
        piece=np.concatenate([part.piece + start for part, start in zip(parts, before, strict=True)]),
        laser=np.concatenate([part.laser for part in parts]),
    )
