"""Readable NumPy twin of `stripe_centers.c` and `stripe_columns.c`: from linked ridges to sub-pixel centres.

Filters, widths and borders are those of ringpose-method(7), section 3; `_stepped` is Newton's step.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringpose.kernels.reference_stripe_links import Ridge
from ringpose.kernels.reference_stripe_patches import Filter, Pixels, bend, sections, slope
from ringpose.kernels.reference_stripe_sigmas import CLUTTERED, Scatter, raised, scatter, scatter_variance, usual_excess
from ringpose.kernels.stripes import Centers, StripeRules
from ringpose.types.arrays import Array, Float32, Float64, Int64

FILTER_PER_WIDTH, FILTER_PER_HALF_WIDTH = 1.3, 0.82
"""Filter over stripe: a little wider than matched; the same for a flat top, over its half width."""

FLAT_PEAK_PER_RESPONSE = 2.162
"""Peak of a flat top over its response, for a filter of that width and sigma 1."""

NARROWEST_PX, WIDEST = 0.7, 2.0
"""Narrowest stripe sigma believed, and the widest, in sigmas of the ridge filter."""

FLANK_PX = 1.5
"""Sigma of the flanks of a flat top."""

LEAST_TRIED, OTHER_FILTER, BETTER, LOST_ONE_IN = 40, 3, 0.95, 10
"""Another filter, so many narrower or wider, is tried on pieces of so many columns, and taken if it leaves less than
that share of the variance and loses no more than one column in so many."""

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


def centers(
    pixels: Pixels, pieces: Sequence[Sequence[Ridge]], filters: Sequence[Filter], rules: StripeRules
) -> Centers:
    """Centres and their sigmas, of all pieces that keep enough columns."""
    measured_pieces = [_measured_piece(pixels, piece, filters) for piece in pieces]
    kept = [columns for columns, _ in measured_pieces if len(columns.x) >= rules.shortest]
    scatters = [of for columns, of in measured_pieces if len(columns.x) >= rules.shortest]
    usual = usual_excess(scatters)
    variances = [raised(each.y, each.variance, of, usual) for each, of in zip(kept, scatters, strict=True)]
    variance = np.concatenate([np.empty(0), *variances])
    x, y, peak = (
        np.concatenate([np.empty(0), *(getattr(columns, name) for columns in kept)]) for name in ("x", "y", "peak")
    )
    return Centers(
        position_px=np.stack([x, y], axis=-1),
        sigma_px=np.sqrt(variance),
        peak_dn=peak,
        piece=np.repeat(np.arange(len(kept)), [len(columns.x) for columns in kept]),
    )


def _measured_piece(pixels: Pixels, piece: Sequence[Ridge], filters: Sequence[Filter]) -> tuple[Columns, Scatter]:
    """With the filter that suits the piece's width, or with another one if more than the sensor's noise spoils that.

    Surroundings ask for a narrower one, speckle for a wider one; the better of the two is taken.
    """
    number, width = suited_filter(piece, filters)
    columns, of = _measured_with(pixels, piece, filters, number, width)
    if of.excess() > CLUTTERED and width and len(piece) >= LEAST_TRIED:
        trial = number - OTHER_FILTER if of.background else number + OTHER_FILTER
        other, tried = _measured_with(pixels, piece, filters, min(max(trial, 1), len(filters) - 1), width)
        better = scatter_variance(other.y, tried) < BETTER * scatter_variance(columns.y, of)
        if better and LOST_ONE_IN * (len(columns.x) - len(other.x)) <= len(columns.x):
            columns, of = other, tried
    return columns, of


def _measured_with(
    pixels: Pixels, piece: Sequence[Ridge], filters: Sequence[Filter], number: int, width: float
) -> tuple[Columns, Scatter]:
    how = Measure(
        filter_=filters[number], width=width, sigma_per_noise=filters[number].slope_norm / filters[0].bend_norm
    )
    columns = measured(pixels, piece, how)
    return columns, scatter(columns.y, columns.variance)


def suited_filter(piece: Sequence[Ridge], filters: Sequence[Filter]) -> tuple[int, float]:
    """The filter for a piece and the stripe's width: that of its ridges together, or of its flat tops if many are."""
    own = filters[0].sigma
    bends = np.array([ridge.bend for ridge in piece], np.float64)
    if 3 * np.count_nonzero(bends < 0) > len(bends):
        half = -bends[bends < 0].mean() + math.hypot(own, FLANK_PX)
        return _nearest(filters, FILTER_PER_HALF_WIDTH * half), 0.0
    sharpness = bends[bends > 0].sum() / sum(float(ridge.response) for ridge in piece)
    width = math.sqrt(max(response_spread(float(sharpness)) - own**2, NARROWEST_PX**2))
    width = min(width, WIDEST * own)
    return _nearest(filters, FILTER_PER_WIDTH * width), width


def response_spread(sharpness: float) -> float:
    """Square of the sigma of the response from how sharply it falls off at its crest, over the phases of the pixel."""
    b = 3 + 0.125 * sharpness
    return 3.75 / (b - math.sqrt(max(b**2 - 7.5 * sharpness, 0.0)))


def _nearest(filters: Sequence[Filter], sigma: float) -> int:
    """Number of the refining filter with the nearest sigma."""
    return 1 + int(np.argmin([abs(each.sigma - sigma) for each in filters[1:]]))


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
