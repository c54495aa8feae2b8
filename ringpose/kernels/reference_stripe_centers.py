"""Readable NumPy twin of `stripe_centers.c`: from linked ridges to sub-pixel centres.

Filters and widths are those of ringpose-method(7), section 3.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from ringpose.kernels.reference_stripe_columns import Columns, Measure, measured
from ringpose.kernels.reference_stripe_links import Ridge, is_kept
from ringpose.kernels.reference_stripe_patches import Filter, Pixels
from ringpose.kernels.reference_stripe_sigmas import Scatter, raised, scatter, scatter_variance, usual_excess
from ringpose.kernels.reference_stripe_weights import weighed
from ringpose.kernels.stripes import Centers, StripeRules
from ringpose.types.arrays import Array, Bool, Float64

FILTER_PER_WIDTH, FILTER_PER_HALF_WIDTH = 1.3, 0.82
"""Filter over stripe: a little wider than matched; the same for a flat top, over its half width."""

NARROWEST_PX, WIDEST = 0.7, 2.0
"""Narrowest stripe sigma believed, and the widest, in sigmas of the ridge filter."""

FLANK_PX = 1.5
"""Sigma of the flanks of a flat top."""

CLUTTERED, SPECKLED = 8.0, 10.0
"""An excess above these comes from clutter or bends, or from speckle; shot noise of bright stripes makes up to 9."""

NARROWER, LEAST_CLUTTERED, LEAST_SPECKLED = 3, 24, 14
"""A filter so many narrower is tried on pieces of so many columns then, weights for speckle on pieces of so many."""

BETTER, LOST_ONE_IN = 0.95, 10
"""They are taken if they leave less than that share of the variance and lose no more than one column in so many."""


OTHERS_FROM, OTHERS_TO, FAINT_SHARE, CROWDED_ONE_IN = 3.0, 8.0, 0.05, 10
"""Ridges so far from one of a stripe, in its widths, are others, whose light bends what lies beneath it, unless it is
less than that share: where one of so many columns has such a neighbour, speckle is not weighed."""

FULL_WIDTHS, FULL_ONE_IN = 0.75, 3
"""Nor where one of so many columns is full on both sides of its middle, at that share of a width: of a skewed section
that is cut off the flanks alone say less of the middle than the filter does."""


class Light(NamedTuple):
    """An image without ambient light, and where it is saturated."""

    pixels: Pixels
    full: Bool[Array, "row column"]


class MeasuredPiece(NamedTuple):
    """A piece's centres, how they scatter, and how they did with the filter that suited the piece's width."""

    columns: Columns
    of: Scatter
    first: Scatter


def centers(light: Light, pieces: Sequence[Sequence[Ridge]], filters: Sequence[Filter], rules: StripeRules) -> Centers:
    """Centres and their sigmas, of all pieces that are long and strong enough and keep enough columns."""
    columns: dict[int, list[Ridge]] = {}
    for ridge in (ridge for piece in pieces for ridge in piece):
        columns.setdefault(ridge.x, []).append(ridge)
    every = [_measured_piece(light, piece, columns, filters) for piece in pieces if is_kept(piece, rules)]
    kept = [piece for piece in every if len(piece.columns.x) >= rules.shortest]
    usual = usual_excess([piece.first for piece in kept])
    variance = np.concatenate([np.empty(0), *(_raised(piece, usual) for piece in kept)])
    x, y, peak = (
        np.concatenate([np.empty(0), *(getattr(piece.columns, name) for piece in kept)]) for name in ("x", "y", "peak")
    )
    return Centers(
        position_px=np.stack([x, y], axis=-1),
        sigma_px=np.sqrt(variance),
        peak_dn=peak,
        piece=np.repeat(np.arange(len(kept)), [len(piece.columns.x) for piece in kept]),
    )


def _raised(piece: MeasuredPiece, usual: float) -> Float64[Array, "n"]:
    """Its variances; what is usual is by the filter that suited."""
    own = usual * piece.of.excess() / piece.first.excess()
    return raised(piece.columns.y, piece.columns.variance, piece.of, own)


def _measured_piece(
    light: Light, piece: Sequence[Ridge], ridges: dict[int, list[Ridge]], filters: Sequence[Filter]
) -> MeasuredPiece:
    """With the filter that suits the piece's width.

    If its surroundings spoil that, a narrower one is tried; if speckle does, centres by weights that suit that. What
    scatters them less is taken.
    """
    pixels, (number, width) = light.pixels, suited_filter(piece, filters)
    columns, of = _measured_with(pixels, piece, filters, number, width)
    if not width or len(piece) < LEAST_SPECKLED or of.excess() < CLUTTERED:
        return MeasuredPiece(columns, of, of)
    if of.background and len(piece) >= LEAST_CLUTTERED:
        other, tried = _measured_with(pixels, piece, filters, max(number - NARROWER, 1), width)
        better = scatter_variance(other.y, tried) < BETTER * scatter_variance(columns.y, of)
        if better and _keeps(columns, other):
            return MeasuredPiece(other, tried, of)
    if of.excess() < SPECKLED or not _shows_flanks(light, piece, ridges, width):
        return MeasuredPiece(columns, of, of)
    other, left = weighed(pixels, columns, of, _measure(filters, number, width))
    if left.excess() < BETTER * of.excess() and _keeps(columns, other):
        return MeasuredPiece(other, scatter(other.y, other.variance), of)
    return MeasuredPiece(columns, of, of)


def _shows_flanks(light: Light, piece: Sequence[Ridge], ridges: dict[int, list[Ridge]], width: float) -> bool:
    """Whether a piece's flanks are those of a stripe alone that is not saturated."""
    others = sum(any(_is_other(ridge, each, width) for each in ridges[ridge.x]) for ridge in piece)
    rows = int(FULL_WIDTHS * width + 0.5) * np.array([-1, 1])
    full = sum(bool(light.full[np.clip(ridge.row + rows, 0, len(light.full) - 1), ridge.x].all()) for ridge in piece)
    return CROWDED_ONE_IN * others <= len(piece) and FULL_ONE_IN * full <= len(piece)


def _is_other(own: Ridge, other: Ridge, width: float) -> bool:
    """Whether a ridge of the column lies near one, and is no grain of it."""
    bright = other.response > np.float32(FAINT_SHARE) * own.response
    return bool(bright and OTHERS_FROM * width < abs(other.y - own.y) <= OTHERS_TO * width)


def _keeps(columns: Columns, other: Columns) -> bool:
    """Whether hardly any column is lost."""
    return LOST_ONE_IN * (len(columns.x) - len(other.x)) <= len(columns.x)


def _measured_with(
    pixels: Pixels, piece: Sequence[Ridge], filters: Sequence[Filter], number: int, width: float
) -> tuple[Columns, Scatter]:
    columns = measured(pixels, piece, _measure(filters, number, width))
    return columns, scatter(columns.y, columns.variance)


def _measure(filters: Sequence[Filter], number: int, width: float) -> Measure:
    return Measure(
        filter_=filters[number], width=width, sigma_per_noise=filters[number].slope_norm / filters[0].bend_norm
    )


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
