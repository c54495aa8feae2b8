"""Edge-spread function of a marker's sides, measured in the image itself (ringpose-method(7), section 6).

The blur of lens and pixels is not exactly Gaussian. A wrong profile displaces an edge by up to 0.03 px, depending on
its position within a pixel. Along sides that cross many pixels this averages out, but sides nearly parallel to a row or
a column are bent by it, by 0.05 px at their corners. The deviation from the error function is estimated from all pixels
beside a marker's sides.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.special import ndtr

from ringpose.geometry.least_squares import huber_weights, robust_std
from ringpose.types.arrays import Array, Float64

KNOT_PX = 0.5
"""Knot spacing of the cubic spline that is added to the error function."""

RIDGE = 1.0
"""Ridge penalty of the spline's coefficients, as a number of samples: bounds coefficients in gaps of the samples."""

MIN_BLUR_PX = 0.4
"""Standard deviation of the sharpest edges: pixels blur by 0.29 px, lenses by as much."""

ROBUST_SIGMAS = 3.0
"""Limit of the Huber loss in standard deviations: larger residuals come from objects in front of the board."""

_ITERATIONS = 2

_TABLE_PX = np.linspace(-8.0, 8.0, 801)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeProfile:
    """Edge-spread function: 0 on the dark side, 1 on the bright side, tabulated by the distance from the edge.

    It is point-symmetric about the edge, where it is 0.5.
    """

    blur_px: float
    """Standard deviation of the closest error function."""
    shares: Float64[Array, "sample"]
    """Values at the tabulated distances, -8 to 8 px."""
    slopes: Float64[Array, "sample"]
    """Derivatives there, per pixel."""

    def share(self, across: Float64[Array, "*shape"]) -> Float64[Array, "*shape"]:
        """Value at distances in pixels, positive on the bright side."""
        return _interpolated(across, self.shares)

    def slope(self, across: Float64[Array, "*shape"]) -> Float64[Array, "*shape"]:
        """Derivative at distances in pixels, per pixel."""
        return _interpolated(across, self.slopes)


def gaussian_profile(blur_px: float) -> EdgeProfile:
    """The error function of a Gaussian blur."""
    return _tabulated(blur_px, np.zeros(0))


def fitted_profile(
    across: Float64[Array, "n"], share: Float64[Array, "n"], blur_px: float, reach_px: float
) -> EdgeProfile:
    """The profile of a dark-to-bright edge, fitted to samples.

    `across`: distance from the edge in pixels, at most `reach_px`; `share`: intensity, 0 on the dark side and 1 on the
    bright one; `blur_px`: initial value of the blur.
    """
    basis = _odd_splines(across, int(np.ceil(reach_px / KNOT_PX)))
    deviation = share - ndtr(across / blur_px)
    weights, coefficients = np.ones(len(deviation)), np.zeros(basis.shape[1])
    for _ in range(_ITERATIONS):
        weighted = basis * weights[:, None]
        normal_matrix = weighted.T @ basis + RIDGE * np.eye(len(coefficients))
        coefficients = np.linalg.solve(normal_matrix, weighted.T @ deviation)
        residual = deviation - basis @ coefficients
        weights = huber_weights(residual, max(ROBUST_SIGMAS * robust_std(residual), 1e-12))
    return _tabulated(blur_px, coefficients)


def _tabulated(blur_px: float, coefficients: Float64[Array, "knot"]) -> EdgeProfile:
    """Error function plus spline with these coefficients."""
    density = np.exp(-0.5 * (_TABLE_PX / blur_px) ** 2) / (np.sqrt(2 * np.pi) * blur_px)
    splines, slopes = _tabulated_splines(len(coefficients))
    return EdgeProfile(
        blur_px=blur_px,
        shares=ndtr(_TABLE_PX / blur_px) + splines @ coefficients,
        slopes=density + slopes @ coefficients,
    )


@cache
def _tabulated_splines(knots: int) -> tuple[Float64[Array, "sample knot"], Float64[Array, "sample knot"]]:
    """The splines and their derivatives at the tabulated distances."""
    return _odd_splines(_TABLE_PX, knots), _odd_spline_slopes(_TABLE_PX, knots)


def _interpolated(across: Float64[Array, "*shape"], table: Float64[Array, "sample"]) -> Float64[Array, "*shape"]:
    return np.interp(across.ravel(), _TABLE_PX, table).reshape(across.shape)


def _odd_splines(across: Float64[Array, "n"], knots: int) -> Float64[Array, "n knot"]:
    """Cubic B-spline at each knot minus its mirror image: odd functions keep the profile 0.5 at the edge."""

    def spline(x: Float64[Array, "n knot"]) -> Float64[Array, "n knot"]:  # centred at zero, with integer knots
        outer, inner = np.maximum(2.0 - np.abs(x), 0.0), np.maximum(1.0 - np.abs(x), 0.0)
        return (outer * outer * outer - 4.0 * inner * inner * inner) / 6.0

    x, knot = across[..., None] / KNOT_PX, np.arange(1.0, knots + 1)
    return spline(x - knot) - spline(x + knot)


def _odd_spline_slopes(across: Float64[Array, "n"], knots: int) -> Float64[Array, "n knot"]:
    """Derivatives of these functions, per pixel."""

    def slope(x: Float64[Array, "n knot"]) -> Float64[Array, "n knot"]:
        outer, inner = np.maximum(2.0 - np.abs(x), 0.0), np.maximum(1.0 - np.abs(x), 0.0)
        return -np.sign(x) * (outer * outer - 4.0 * inner * inner) / 2.0

    x, knot = across[..., None] / KNOT_PX, np.arange(1.0, knots + 1)
    return (slope(x - knot) - slope(x + knot)) / KNOT_PX
