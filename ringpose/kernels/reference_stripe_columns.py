"""Readable NumPy twin of `stripe_columns.c`: sub-pixel centres of one piece.

Borders are those of ringpose-method(7), section 3; `_stepped` is Newton's step.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringpose.kernels.reference_stripe_links import Ridge
from ringpose.kernels.reference_stripe_patches import Filter, Pixels, bend, sections, slope
from ringpose.types.arrays import Array, Float32, Float64, Int64

FLAT_PEAK_PER_RESPONSE = 2.162
"""Peak of a flat top over its response, for a filter of that width and sigma 1."""

NEAR_PX, ROUNDS, STRAYED_PX = 1.0, 2, 2.5
"""A centre farther than this from its pixel is looked for again, so often; one so far from its ridge is none."""

WHOLE_SPREADS = 1.5
"""Nearer to the upper or lower border than so many sigmas of the stripe's response a centre is drawn to it: rows beyond
are taken as the outermost one. From here on by less than a hundredth of the stripe's sigma."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Columns:
    """Centres of one piece."""

    x: Int64[Array, "n"]
    y: Float64[Array, "n"]
    variance: Float64[Array, "n"]
    peak: Float64[Array, "n"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measure:
    """A filter for a stripe of that width (sigma), or for a flat top (0)."""

    filter_: Filter
    width: float
    sigma_per_noise: float

    @property
    def inverse_spread(self) -> float:
        """One over the square of the sigma of the stripe's response; 0 for a flat top."""
        return 1 / (self.filter_.sigma**2 + self.width**2) if self.width else 0.0

    @property
    def peak_per_response(self) -> float:
        """What turns a response into a peak."""
        if not self.width:
            return FLAT_PEAK_PER_RESPONSE * self.filter_.sigma**2
        return math.hypot(self.filter_.sigma, self.width) ** 3 / self.width


def measured(pixels: Pixels, piece: Sequence[Ridge], how: Measure) -> Columns:
    """The centres, with the variances that the sensor's noise explains; without columns that show no ridge near by."""
    x, row = (np.array([getattr(ridge, name) for ridge in piece], np.int64) for name in ("x", "row"))
    noise, ridge_y, bends = (
        np.array([getattr(ridge, name) for ridge in piece], np.float32) for name in ("noise", "y", "bend")
    )
    y, variance, peak = _stepped(pixels, x, row, noise, how)
    for _ in range(ROUNDS):
        far = (variance > 0) & (abs(y - row) > NEAR_PX)
        row[far] = np.clip(np.floor(y[far] + 0.5), 0, len(pixels) - 1)
        y[far], variance[far], peak[far] = _stepped(pixels, x[far], row[far], noise[far], how)
    whole = WHOLE_SPREADS * math.hypot(how.filter_.sigma, how.width)
    kept = (variance > 0) & (abs(y - ridge_y) < STRAYED_PX + np.maximum(-bends, 0))
    kept &= (y >= whole) & (y <= len(pixels) - 1 - whole)
    return Columns(x=x[kept], y=y[kept], variance=variance[kept], peak=peak[kept])


def _stepped(
    pixels: Pixels, x: Int64[Array, "n"], row: Int64[Array, "n"], noise: Float32[Array, "n"], how: Measure
) -> tuple[Float64[Array, "n"], Float64[Array, "n"], Float64[Array, "n"]]:
    """From the pixel to the zero of the first derivative of a Gaussian ridge; no ridge: a variance of nothing.

    With Newton's step t and the response's sigma S the zero lies at 2 t / (1 + sqrt(1 + 4 t^2 / S^2)), here as a
    quotient of polynomials that is within 1e-4 px. Returns position, variance and peak.
    """
    section = sections(pixels, row, x, how.filter_.reach)
    bent = bend(how.filter_, section)
    fall = np.where(bent < 0, -bent.astype(np.float64), 1.0)
    newton = slope(how.filter_, section) / fall
    q = newton**2 * how.inverse_spread
    step = newton * (1 + 3 * q + q * q) / (1 + 4 * q + 3 * q * q)
    crest = fall * (1 + 1.5 * step**2 * how.inverse_spread)
    sigma = np.where(bent < 0, how.sigma_per_noise * noise.astype(np.float64) / crest, 0.0)
    return row + step, sigma**2, crest * how.peak_per_response
