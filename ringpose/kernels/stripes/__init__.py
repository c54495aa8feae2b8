"""Sub-pixel stripe centres (ringpose-method(7), section 2).

The sources are stripe_search.c (noise, coarse search, ridges), stripe_patches.c (image patches and their derivatives),
stripe_links.c (ridges linked into pieces), stripe_centers.c (sub-pixel centres), stripe_sigmas.c (standard deviations)
and stripes.c (the call from Python).
"""

from typing import NamedTuple

import numpy as np

from ringpose.kernels import _kernels
from ringpose.types.arrays import Array, Float32, Float64, Int32, Int64, UInt

BLOCK = 16
"""Columns that are processed together."""

CELL = 4
"""Rows of a cell of the coarse search; a cell is one block wide."""


class Filters(NamedTuple):
    """Derivative-of-Gaussian filters: the first one detects ridges, the others, by ascending sigma, refine them."""

    taps: Float32[Array, "filter derivative=2 tap"]
    """First and second derivative, from the middle tap on; the first is odd (positive downwards), the second even."""
    figures: Float64[Array, "filter figure=4"]
    """Sigma, taps on one side, and the response of each derivative to white noise of standard deviation 1."""


class StripeParams(NamedTuple):
    """Detection thresholds."""

    begin_sigmas: float
    """Response over its noise (clutter included) that at least `shortest` columns of a piece must have."""
    continue_sigmas: float
    """Response over its noise that every column must have."""
    min_response: float
    """Smallest response of the ridge filter."""
    coarse_per_response: float
    """Sum over a window of 8 x 16 pixels, less its surroundings, for a ridge with a response of 1."""
    full_dn: float
    """Grey value of a saturated pixel; speckle weights are not used on pieces with many of them."""
    gap: int
    """Largest number of missing columns inside a piece."""
    shortest: int
    """Smallest number of columns of a piece."""


class Centers(NamedTuple):
    """Stripe centres, sorted by piece, then column."""

    position_px: Float64[Array, "center xy=2"]
    sigma_px: Float64[Array, "center"]
    peak_dn: Float64[Array, "center"]
    piece: Int64[Array, "center"]


def stripes(
    image: UInt[Array, "row column"],
    dark: UInt[Array, "row column"] | None,
    bands: Int32[Array, "band side=4"] | None,
    filters: Filters,
    params: StripeParams,
) -> Centers:
    """Sub-pixel centres of ridges, column by column, linked into pieces; 8 or 16 bits a pixel.

    `dark` is the same view with the lasers off and is subtracted. `bands` restrict the search: first column, the one
    after the last, and likewise the rows, rounded outwards to cells of 4 x 16 pixels. Each piece is measured with the
    filter matched to its width, with a narrower one if clutter disturbs it, or by weighted least squares if speckle
    dominates. Sigmas are propagated from the sensor noise and raised to the scatter that second differences of the
    centres show.
    """
    lit = np.ascontiguousarray(image)
    black = None if dark is None else np.ascontiguousarray(dark)
    where = None if bands is None else np.ascontiguousarray(bands)
    position, sigma, peak, piece = _kernels.stripes(lit, black, where, filters.taps, filters.figures, params)
    return Centers(
        position_px=np.frombuffer(position, np.float64).reshape(-1, 2),
        sigma_px=np.frombuffer(sigma, np.float64),
        peak_dn=np.frombuffer(peak, np.float64),
        piece=np.frombuffer(piece, np.int64),
    )
