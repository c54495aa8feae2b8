"""The kernel that finds stripe centres, behind a typed function."""

from typing import NamedTuple

import numpy as np

from ringpose.kernels import _kernels
from ringpose.types.arrays import Array, Float32, Float64, Int32, Int64, UInt

BLOCK = 16
"""Columns that are worked on together."""

CELL = 4
"""Rows of a cell of the coarse search, which is a block wide."""


class Filters(NamedTuple):
    """Derivatives of Gaussians: the first finds ridges, the others, by ascending sigma, refine them."""

    taps: Float32[Array, "filter derivative=2 tap"]
    """First and second derivative, from the middle on; the first is odd (positive downwards), the second even."""
    figures: Float64[Array, "filter figure=4"]
    """Sigma, taps on one side, and how each derivative answers white noise of 1."""


class StripeParams(NamedTuple):
    """What counts as a stripe."""

    begin_sigmas: float
    """A piece has enough columns that stand out of the noise so far,"""
    continue_sigmas: float
    """and others that stand out so far; the noise is that of the ridge filter's response."""
    min_response: float
    """And a ridge answers that much at least."""
    coarse_per_response: float
    """Sum over a window of 8 x 16 pixels, its surroundings subtracted, for a ridge that answers 1."""
    full_dn: float
    """Grey value of a saturated pixel: what speckle leaves of such a stripe says less than its shape."""
    gap: int
    """Columns that may be missing inside a piece."""
    shortest: int
    """Columns."""


class Centers(NamedTuple):
    """Centres sorted by piece, then column."""

    position_px: Float64[Array, "center xy=2"]
    sigma_px: Float64[Array, "center"]
    peak_dn: Float64[Array, "center"]
    piece: Int64[Array, "center"]


def stripes(
    image: UInt[Array, "row column"],
    dark: UInt[Array, "row column"] | None,
    bands: Int32[Array, "band side=4"] | None,
    filters: Filters,
    rules: StripeParams,
) -> Centers:
    """Sub-pixel centres of ridges, column by column, linked into pieces; 8 or 16 bits a pixel.

    `dark` is subtracted. `bands` give the first column of each band, the one after the last, and likewise its rows; all
    else is left out, in blocks of 4 x 16 pixels. Each piece is measured with the filter that suits its width, or with
    a narrower one or by its flanks if its surroundings or speckle ask for it; sigmas are those of the sensor's noise,
    raised to what differences between the centres of a piece show.
    """
    lit = np.ascontiguousarray(image)
    black = None if dark is None else np.ascontiguousarray(dark)
    where = None if bands is None else np.ascontiguousarray(bands)
    position, sigma, peak, piece = _kernels.stripes(lit, black, where, filters.taps, filters.figures, rules)
    return Centers(
        position_px=np.frombuffer(position, np.float64).reshape(-1, 2),
        sigma_px=np.frombuffer(sigma, np.float64),
        peak_dn=np.frombuffer(peak, np.float64),
        piece=np.frombuffer(piece, np.int64),
    )
