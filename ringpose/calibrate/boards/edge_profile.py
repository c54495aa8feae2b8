"""How grey rises across an edge, as an image itself shows it (ringpose-method(7), section 6).

An error function is not how lens and pixels blur. Where it is wrong, an edge is drawn aside by up to 0.03 px as its
place within a pixel has it: that is evened out along sides that cross many pixels, and bends those nearly along a row
or a column, by 0.05 px at their corners. What is wrong with it shows across all of a marker's sides.
"""

from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr

from ringpose.geometry.robust import robust_std
from ringpose.types.arrays import Array, Float64

KNOT_PX = 0.5
"""Distance of the knots of the cubic spline that is added to the error function."""

RIDGE = 1.0
"""Samples of no rise but the error function's that each weight of the spline is held by, where pixels leave gaps."""

MIN_BLUR_PX = 0.4
"""Standard deviation of the sharpest edges: pixels blur by 0.29, lenses by as much."""

ROBUST_SIGMAS = 3.0
"""Samples beyond so many standard deviations pull no harder: something lies in front of the board."""

_ROUNDS = 2

_TABLE_PX = np.linspace(-8.0, 8.0, 801)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeProfile:
    """Share of the rise from dark to bright by the distance from the edge, as a table.

    As much of the rise lies within as beyond.
    """

    blur_px: float
    """Standard deviation of the error function that is nearest to it."""
    shares: Float64[Array, "place"]
    """At the places of the table."""
    steepnesses: Float64[Array, "place"]
    """Their derivatives, per pixel."""

    def share(self, across: Float64[Array, "*shape"]) -> Float64[Array, "*shape"]:
        """At distances in pixels, positive where it is bright."""
        return _interpolated(across, self.shares)

    def denominator(self, across: Float64[Array, "*shape"]) -> Float64[Array, "*shape"]:
        """Derivative of the share, per pixel."""
        return _interpolated(across, self.steepnesses)


def normal_profile(blur_px: float) -> EdgeProfile:
    """The error function."""
    return _tabled(blur_px, np.zeros(0))


def seen_profile(
    across: Float64[Array, "n"], share: Float64[Array, "n"], blur_px: float, reach_px: float
) -> EdgeProfile:
    """The profile of shares that pixels show so far from the edge."""
    basis = _odd(across, int(np.ceil(reach_px / KNOT_PX)))
    missed = share - ndtr(across / blur_px)
    trust, weights = np.ones(len(missed)), np.zeros(basis.shape[1])
    for _ in range(_ROUNDS):
        weighed = basis * trust[:, None]
        weights = np.linalg.solve(weighed.T @ basis + RIDGE * np.eye(len(weights)), weighed.T @ missed)
        left = missed - basis @ weights
        trust = np.minimum(1.0, ROBUST_SIGMAS * robust_std(left) / np.maximum(np.abs(left), 1e-12))
    return _tabled(blur_px, weights)


def _tabled(blur_px: float, weights: Float64[Array, "knot"]) -> EdgeProfile:
    """The error function and the spline with these weights."""
    normal = np.exp(-0.5 * (_TABLE_PX / blur_px) ** 2) / (np.sqrt(2 * np.pi) * blur_px)
    return EdgeProfile(
        blur_px=blur_px,
        shares=ndtr(_TABLE_PX / blur_px) + _odd(_TABLE_PX, len(weights)) @ weights,
        steepnesses=normal + _odd_slope(_TABLE_PX, len(weights)) @ weights,
    )


def _interpolated(across: Float64[Array, "*shape"], table: Float64[Array, "place"]) -> Float64[Array, "*shape"]:
    values: Float64[Array, "*shape"] = np.interp(across.ravel(), _TABLE_PX, table).reshape(across.shape)
    return values


def _odd(across: Float64[Array, "n"], knots: int) -> Float64[Array, "n knot"]:
    """Cubic B-splines around each knot, less those around its mirror image."""
    place, knot = across[..., None] / KNOT_PX, np.arange(1.0, knots + 1)
    odd: Float64[Array, "n knot"] = _bump(place - knot) - _bump(place + knot)
    return odd


def _odd_slope(across: Float64[Array, "n"], knots: int) -> Float64[Array, "n knot"]:
    place, knot = across[..., None] / KNOT_PX, np.arange(1.0, knots + 1)
    slope: Float64[Array, "n knot"] = (_bump_slope(place - knot) - _bump_slope(place + knot)) / KNOT_PX
    return slope


def _bump(place: Float64[Array, "*shape"]) -> Float64[Array, "*shape"]:
    """The cubic B-spline on whole-numbered knots, about zero."""
    far, near = np.maximum(2.0 - np.abs(place), 0.0), np.maximum(1.0 - np.abs(place), 0.0)
    bump: Float64[Array, "*shape"] = (far * far * far - 4.0 * near * near * near) / 6.0
    return bump


def _bump_slope(place: Float64[Array, "*shape"]) -> Float64[Array, "*shape"]:
    far, near = np.maximum(2.0 - np.abs(place), 0.0), np.maximum(1.0 - np.abs(place), 0.0)
    slope: Float64[Array, "*shape"] = -np.sign(place) * (far * far - 4.0 * near * near) / 2.0
    return slope
