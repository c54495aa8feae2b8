"""Centres of the laser stripes, column by column (ringpose-method(7), section 3).

Stripes run roughly along the image rows. In each column a stripe is a ridge: the second derivative of the
Gaussian-smoothed grey values has a minimum there, and the zero of the first derivative next to it is the centre; of a
speckled stripe, it is what its flanks say.
"""

import numpy as np

from ringpose.detect.stripe_filters import stripe_filters
from ringpose.kernels import stripes as kernel
from ringpose.types.arrays import Array, Int32, UInt
from ringpose.types.detection import UNLABELLED, Stripes
from ringpose.types.frame import full_scale_dn

STRIPE_SIGMA_PX = 1.6
"""Typical stripe, by which a peak is turned into the response of the ridge filter."""

COARSE_SHARE = 0.27
"""Mean over the 8 rows of a window, for a ridge so narrow that it fills it with sqrt(2 pi) / 8 of its response times
the cube of the filter's sigma (0.31), at the least favourable place in the grid of windows."""

WINDOW_PIXELS = 2 * kernel.CELL * kernel.BLOCK


FILTER_SIGMA_PX = 2.5
"""Smoothing along the column to find stripes: those up to twice as wide are found, and flat-topped, saturated ones up
to 40 px; close ones are told apart if they are some 2.5 of these sigmas apart. To measure them, each piece gets the
filter that suits it."""

BEGIN_SIGMAS, CONTINUE_SIGMAS = 6.0, 4.0
"""A piece must have `LEAST_COLUMNS` that stand out of the local noise of the response by the first factor, and goes on
where they stand out by the second."""

LEAST_PEAK_DN = 3.0
"""And all are this bright above their surroundings, where a pixel is full at 255."""

GAP_COLUMNS = 2
"""Columns that may be missing inside a piece."""

LEAST_COLUMNS = 8
"""Shorter pieces are dropped: noise links over a few columns by chance."""


def find_stripes(
    image: UInt[Array, "row column"],
    dark: UInt[Array, "row column"] | None = None,
    bands: Int32[Array, "band side=4"] | None = None,
    saturation_dn: int | None = None,
) -> Stripes:
    """Sub-pixel stripe centres, linked along x into pieces without gap or jump; their lasers are not known.

    `dark` is the same view with the lasers off; its ambient light is subtracted (and its noise added). `bands` restrict
    the search: first column, the one after the last, and likewise the rows. `saturation_dn` is the grey value at which
    a pixel is full; if it is not known, the image must tell.
    """
    full_dn = full_scale_dn(image) if saturation_dn is None else saturation_dn
    least_peak_dn = LEAST_PEAK_DN * full_dn / 255
    rules = kernel.StripeRules(
        begin_sigmas=BEGIN_SIGMAS,
        continue_sigmas=CONTINUE_SIGMAS,
        least_response=least_peak_dn * STRIPE_SIGMA_PX / (FILTER_SIGMA_PX**2 + STRIPE_SIGMA_PX**2) ** 1.5,
        coarse_per_response=COARSE_SHARE * FILTER_SIGMA_PX**3 * WINDOW_PIXELS,
        full_dn=full_dn,
        gap=GAP_COLUMNS,
        shortest=LEAST_COLUMNS,
    )
    found = kernel.stripes(image, dark, bands, stripe_filters(FILTER_SIGMA_PX), rules)
    pieces = int(found.piece[-1]) + 1 if len(found.piece) else 0
    return Stripes(
        position_px=found.position_px,
        sigma_px=found.sigma_px,
        peak_dn=found.peak_dn,
        piece=found.piece,
        laser=np.full(pieces, UNLABELLED, dtype=np.int64),
    )
