"""The estimation of one shot's ring as a linearised problem: prior, residuals and estimate.

All residuals are in units of their standard deviations, in this order: the lines of the stripes (residual a), the
break points along their lines (b), the ordinates of break points without a line, the visible edges (c), and the prior
(d) (ringpose-method(7), section 5). They are evaluated in `ringpose.estimate.solver`; the ring is described by
`ringpose.geometry.ring`.
"""

from dataclasses import dataclass
from functools import cached_property
from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from ringpose.estimate.measurements import Points
from ringpose.geometry.ring import (
    CURVATURE,
    STEP,
    EdgeDistances,
    Rates,
    RingArcs,
    StripePrediction,
)
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.assumptions import Assumptions
from ringpose.types.pose import KnownRadii

PARAMETERS = len(STEP)

RIDGE = 1e-7
"""Added to the diagonal of the normal matrix (m, rad, 1/m), so that undetermined parameters keep their values."""

RIDGE_MATRIX = RIDGE * np.eye(PARAMETERS)

EXPECTED_CURVATURE, CURVATURE_SD = 1.5, 1.5
"""Weak prior in 1/m (a radius of 0.3 m has 3.3; the largest ring in launcher manuals has 0.76)."""

TURN_SD_RAD = 0.5
"""Weak prior on the angle between the stripes and the radius, if a single stripe has to determine it."""

TILT_SD_RAD = 0.6
"""Weak prior on the angle between the ring's normal and the optical axis, if a single stripe leaves it open."""

EXPECTED_HALF_BAND_M, HALF_BAND_SD_M = 0.015, 0.015
"""Prior on half the width of the face if only one edge was seen: faces in launcher manuals are 0.03 m wide."""

DECISION_SIGMAS = 0.01
"""Estimated distance from the optimum, in standard deviations, from which explanations are compared: their chi-squared
is then known to 1e-4."""

STILL = Rates(np.zeros(3), np.zeros(3))


class Prior(NamedTuple):
    """What is known about the ring before the measurement."""

    radii: KnownRadii | None = None
    assumptions: Assumptions = Assumptions()
    """Assumptions on motion, the ring's form and the rig."""
    regularize_about: RingArcs | None = None
    """The ring about which curvature, turn and tilt have weak priors; None to estimate from the shot alone."""
    single_edge: bool = False
    """Whether only one edge was seen, so that the width of the face needs a prior."""


class OrdinateScale(NamedTuple):
    """Weights of the ordinates of isolated break points: residual (y - y(x) - share * distance) * scale."""

    which: Int64[Array, "isolated"]
    share: Float64[Array, "isolated"]
    scale: Float64[Array, "isolated"]


class Residuals(NamedTuple):
    """The whitened residuals, their Jacobian, and the predictions that the nuisance parameters need."""

    arcs: RingArcs
    """The ring at the reference time ..."""
    rates: Rates
    """... and its motion, at which they are linearised."""
    rate_sds: Float64[Array, "rate"]
    """Standard deviations of the rates by their prior; empty if the ring is still or all rows are of one instant."""
    rate_deviations: Float64[Array, "rate"]
    """The rates in these standard deviations."""
    system: Float64[Array, "row 8"]
    """[r J]: the residuals r, and their derivatives J by the ring's step ..."""
    residual: Float64[Array, "row"]
    jacobian: Float64[Array, "row step=7"]
    """... and both as parts of it."""
    wrt_rates: Float64[Array, "row rate"]
    """Derivatives by the rates: velocity of the ring's centre, and angular velocities about its inward axis and about
    the axis along its face. No columns for a still ring."""
    wrt_camera: Float64[Array, "row error"]
    """Derivatives by the mount's parameters (`Mount.uncertain`); no columns for a camera at rest."""
    ends: int
    """Number of the lines' ends: their residuals and predictions come before those of the break points."""
    stripe_rows: int
    """Number of residuals of stripes and break points, which come before those of visible edges."""
    data_rows: int
    """Number of residuals before those of the prior."""
    stripes: StripePrediction
    """Derivatives by the ring's step, its rates, and errors of the camera's motion."""
    points: EdgeDistances
    """Distances of the break points from their edges."""
    edges: EdgeDistances
    """Distances of the visible edge points from their edges."""
    edge_scale: Float64[Array, "visible"]
    """1 / standard deviation of their distances."""
    distance_wrt_x: Float64[Array, "point"]
    """Derivative of a break point's distance from its edge along the predicted line."""
    distance_scale: Float64[Array, "point"]
    """1 / standard deviation of that distance."""
    ordinates: OrdinateScale
    described: Bool[Array, "point"]
    """Whether a break point lies on the arc at which the ring is described."""


class FixedColumns(NamedTuple):
    """Derivatives of the residuals with respect to common errors, evaluated once, near the solution."""

    rig: Float64[Array, "row parameter"] | None
    """Derivatives by the rig's parameters, in their own units; None if the rig counts as exact."""
    form: Float64[Array, "row amplitude"] | None
    """Derivatives by the amplitudes of the ring's form, in metres; None for a perfect ring."""
    slope: Float64[Array, "row"] | None
    """Derivatives by the slope of the face; None if it is flat."""
    camera: Float64[Array, "row parameter"]
    """Derivatives by the mount's parameters, in their own units."""
    mean_ray_wrt_rig: Float64[Array, "xy=2 error"]
    """Derivatives of the mean of the predicted break points by the rig's errors (in sigmas), for a fixed ring."""
    columns: Float64[Array, "row error"]
    """Derivatives by the errors of rig, form, mount and visible edges, in standard deviations."""
    edge_errors: int
    """Number of columns by errors of visible edges, which are the last ones."""


@dataclass(frozen=True, kw_only=True, eq=False)
class Estimate:
    """A maximum-likelihood ring, and the linearised problem at the solution."""

    residuals: Residuals
    arcs: RingArcs
    """The ring at the reference time of the measurements."""
    rates: Rates
    """Motion of the ring."""
    weights: Float64[Array, "row"]
    """1 for a residual that was used, 0 for a rejected edge point."""
    fixed: FixedColumns
    nuisance: Float64[Array, "row error"]
    """Derivatives of the residuals by common errors of unit variance: rates, rig, form of the ring, visible edges."""
    nuisance_step: Float64[Array, "error"]
    """The estimated common errors, in their standard deviations; 0 for the rates, which the residuals contain."""
    normal_matrix: Float64[Array, "7 7"]
    """Inverse covariance of the ring's step, the common errors marginalised."""
    inverse: Float64[Array, "7 7"]
    """Inverse of the normal matrix with `RIDGE`."""
    prior: Prior
    """The prior that was used; with weak priors (`regularize_about`) if the shot leaves parameters open."""
    remaining: Float64[Array, "row"]
    """Residuals at the estimated ring less those that the estimated rig and edge errors explain, in sigmas ..."""
    edge_residuals: Float64[Array, "visible"]
    """... and those of the visible edge points among them."""
    chi2: float
    """Chi-squared of stripes, break points and priors; visible edges are too many to be compared with these."""
    numbers: int
    """Number of values of stripes, break points and radii; rows of weak priors count like measurements."""
    degrees_of_freedom: int
    """Degrees of freedom of the stripes alone: that number less the number of parameters, at least 0."""
    distance_sigmas: float
    """Estimated distance from the optimum at the end of the iteration, in standard deviations."""
    converged: bool
    """Whether the iteration came near the optimum before it reached its limit."""

    @cached_property
    def joint_information(self) -> Float64[Array, "n n"]:
        """Information on the ring's step and the common errors, with their priors and the ridge."""
        jacobian = np.concatenate([self.residuals.jacobian, self.nuisance], axis=1)
        information: Float64[Array, "n n"] = (jacobian.T * self.weights) @ jacobian
        diagonal = np.ones(len(information))
        diagonal[:PARAMETERS] = RIDGE
        information[range(len(information)), range(len(information))] += diagonal
        return information

    @cached_property
    def expected_chi2(self) -> float:
        """Expectation of chi-squared, to which the degrees of freedom of a test of it correspond.

        The expectation is the number of terms less their leverages. Without visible edges the leverages add up to the
        number of parameters; with visible edges to less, as the edges determine a part of the parameters.
        """
        residuals = self.residuals
        if residuals.stripe_rows == residuals.data_rows:
            return float(self.degrees_of_freedom)
        counted = np.r_[: residuals.stripe_rows, residuals.data_rows : len(residuals.residual)]
        covariance = np.linalg.inv(self.joint_information)
        rows = np.concatenate([residuals.jacobian, self.nuisance], axis=1)[counted]
        common = len(covariance) - PARAMETERS - self.fixed.edge_errors
        of_common = covariance.diagonal()[PARAMETERS : PARAMETERS + common].sum()
        leverages = float(((rows @ covariance) * rows).sum()) + float(of_common)
        return max(self.numbers + common - leverages, 0.0)

    @property
    def log_determinant(self) -> float:
        """Log determinant of the information on ring and common errors: how much the data narrow their priors."""
        return float(np.linalg.slogdet(self.joint_information)[1])

    @property
    def largest_reduction(self) -> float:
        """Largest decrease of chi-squared by leaving out one row of a stripe or break point.

        r^2 / (1 - h), with the leverage h = a M^-1 a^T of its row a in the joint problem of ring and common errors.
        """
        count = self.residuals.stripe_rows
        rows = np.concatenate([self.residuals.jacobian, self.nuisance], axis=1)[:count]
        leverage = (np.linalg.solve(self.joint_information, rows.T) * rows.T).sum(axis=0)
        free = leverage < 1.0 - 1e-3  # a number that determines a parameter alone contradicts nothing
        return float((self.remaining[:count][free] ** 2 / (1.0 - leverage[free])).max(initial=0.0))

    @cached_property
    def curvature_alone(self) -> tuple[float, float]:
        """The curvature by the shot alone, without the prior, and its standard deviation.

        It follows from the normal equations without the rows of the prior, whose gradient balances that of the data.
        """
        prior = self.residuals.jacobian[self.residuals.data_rows :]
        information = self.normal_matrix - prior.T @ prior + RIDGE_MATRIX
        try:
            covariance = np.linalg.inv(information)
        except np.linalg.LinAlgError:
            return 0.0, inf
        step = covariance @ (prior.T @ self.residuals.residual[self.residuals.data_rows :])
        variance = float(covariance[CURVATURE, CURVATURE])
        return self.arcs.curvature + float(step[CURVATURE]), sqrt(variance) if variance > 0 else inf


NO_ORDINATES = OrdinateScale(np.zeros(0, dtype=np.int64), np.zeros(0), np.zeros(0))


def ordinate_scale(
    points: Points, slope: Float64[Array, "point"], distance_wrt_x: Float64[Array, "point"]
) -> OrdinateScale:
    """Weights of the ordinates of break points without a line.

    The height of such a point above the predicted line is correlated with the error of its abscissa, which residual b
    uses. The coefficient of the regression on the abscissa is `share`; the remainder is independent of the abscissa and
    has the standard deviation 1 / scale.
    """
    which = np.flatnonzero(points.isolated)
    covariance, slope = points.covariance[which], slope[which]
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    cross_covariance = xy - slope * xx
    remainder = yy - 2.0 * slope * xy + slope**2 * xx - cross_covariance**2 / xx
    scale = 1.0 / np.sqrt(np.maximum(remainder, 1e-12 * xx))
    return OrdinateScale(which, cross_covariance / xx / distance_wrt_x[which], scale)
