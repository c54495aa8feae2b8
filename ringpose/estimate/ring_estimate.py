"""The maximum-likelihood ring, and whether its measurements agree with it (ringpose-method(7), section 5)."""

from dataclasses import dataclass
from functools import cached_property, partial
from math import inf, isfinite, sqrt

import numpy as np

from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.linearization import (
    PARAMETERS,
    FixedColumns,
    Observations,
    Residuals,
    ring_residuals,
    with_sigmas_raised,
)
from ringpose.estimate.measurements import Measurements
from ringpose.estimate.nuisance import nuisance_columns
from ringpose.estimate.solver import (
    ALARM_SIGMAS,
    CERTAIN_SIGMAS,
    NEAR_SIGMAS,
    OUTLIER_SIGMAS,
    PRECISE_SIGMAS,
    RIDGE,
    RIDGE_MATRIX,
    Iterated,
    gauss_newton,
    initial_guess,
    linearize,
    linearized_at,
    poorly_determined,
)
from ringpose.geometry.ring import CURVATURE, STILL, MovingRing, Rates, RingArcs
from ringpose.types.arrays import Array, Float64
from ringpose.types.detection import JudgedRing

DECISION_SIGMAS = 0.01
"""Estimated distance from the optimum, in standard deviations, from which explanations are compared: their chi-squared
is then known to 1e-4."""

STRIPES_OF_A_PLANE = 2
"""With fewer stripes the tilt about the stripe is determined by the edges only."""

HOPELESS = 1e4
"""Factor on the limits of `poorly_determined` beyond which an iteration that starts without weak priors ends."""


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
    determined: bool
    """Whether no parameter is so open that a weak prior has to hold it (`poorly_determined`)."""

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
        residuals, many = self.residuals, np.flatnonzero(self.residuals.observations.many)
        if not len(many):
            return float(self.degrees_of_freedom)
        counted = np.delete(np.arange(len(residuals.residual)), many)
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

    @cached_property
    def leverages(self) -> Float64[Array, "few"]:
        """Leverages h = a M^-1 a^T of the rows a of stripes and break points in the joint problem of ring and errors.

        The others predict such a number with the variance h / (1 - h) of its own, and not at all if h is 1.
        """
        few = np.flatnonzero(~self.residuals.observations.many)
        rows = np.concatenate([self.residuals.jacobian, self.nuisance], axis=1)[few]
        leverages: Float64[Array, "few"] = (np.linalg.solve(self.joint_information, rows.T) * rows.T).sum(axis=0)
        return leverages

    @property
    def largest_reduction(self) -> float:
        """Largest decrease of chi-squared by leaving out one row of a stripe or break point, r^2 / (1 - h)."""
        few, leverages = np.flatnonzero(~self.residuals.observations.many), self.leverages
        free = leverages < 1.0 - 1e-3  # a number that determines a parameter alone contradicts nothing
        return float((self.remaining[few][free] ** 2 / (1.0 - leverages[free])).max(initial=0.0))

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


def estimate_ring(
    measured: Measurements,
    prior: Prior,
    start: Estimate | JudgedRing | None = None,
    *,
    guess: RingArcs | None = None,
    tolerance_sigmas: float = PRECISE_SIGMAS,
) -> Estimate | None:
    """The maximum-likelihood ring; None if the iteration diverges. `start`: a ring that may be near it.

    Parameters that the shot leaves open (with one stripe the tilt about it, with two the curvature) are held by weak
    priors about the initial guess in a second run, so that they do not degrade the others. If visible edges close such
    a gap, the regularised solution is the start: far from the ring, edges lead to wrong minima. `guess`: the initial
    guess, if it was made already; `tolerance_sigmas`: estimated distance from the optimum at the end.
    """
    edges_seen = {*measured.points.edge.tolist(), *measured.edges.edge.tolist()}
    prior = prior._replace(single_edge=prior.radii is None and len(edges_seen) == 1)
    observations = measured.observations
    solve = partial(_solved, observations)
    with np.errstate(all="ignore"):  # a diverging iteration ends in `retract_ring`
        if isinstance(start, JudgedRing):
            estimate = solve(_moving_ring(start, measured.reference_s), prior, tolerance_sigmas)
            if estimate is not None and estimate.determined:
                return estimate
            start = None
        if guess is None and start is None:
            guess = initial_guess(measured, prior)
        first: RingArcs | Estimate | None = guess if start is None else start
        edges_needed = start is None and len(measured.edges.edge) and len(measured.stripes) < STRIPES_OF_A_PLANE
        if guess is not None and edges_needed:
            regularized = solve(guess, prior._replace(regularize_about=guess), NEAR_SIGMAS)
            first = guess if regularized is None else regularized.arcs
        if first is None:
            return None
        estimate = solve(first, prior, tolerance_sigmas)
        if estimate is None or not estimate.determined:
            guess = initial_guess(measured, prior) if guess is None else guess
            about = first.arcs if guess is None and isinstance(first, Estimate) else guess
            estimate = solve(first, prior._replace(regularize_about=about), tolerance_sigmas)
        # one edge without a line on the face beside it leaves open on which side the centre is: try the other one
        side_open = prior.single_edge and bool(measured.points.isolated.all())
        if estimate is not None and estimate.arcs.curvature < 0 and side_open:
            estimate = solve(estimate.arcs.with_center_opposite(), prior, tolerance_sigmas) or estimate
    return estimate


def _moving_ring(judged: JudgedRing, reference_s: float) -> MovingRing:
    """The ring at the reference time."""
    arcs = RingArcs(
        origin=judged.origin_m, axes=judged.axes, curvature=judged.curvature_per_m, half_band_m=judged.half_band_m
    )
    if judged.stamp_s is not None and isfinite(reference_s):
        arcs = arcs.predict(reference_s - judged.stamp_s, judged.velocity_m_s, judged.rate_rad_s)
    return MovingRing(arcs, Rates(judged.velocity_m_s, judged.rate_rad_s))


def _solved(
    observations: Observations, start: RingArcs | MovingRing | Estimate, prior: Prior, tolerance_sigmas: float
) -> Estimate | None:
    """The ring by an iteration from `start`; None if that diverges, or is useless without weak priors.

    None, too, without break points on the arc at which the ring is described: it would have no place there.
    """
    if not len(observations.described):
        return None
    errors = start.nuisance_step if isinstance(start, Estimate) else None
    ring = start if isinstance(start, RingArcs) else MovingRing(start.arcs, start.rates)
    hopeless = HOPELESS if prior.regularize_about is None else inf
    try:
        problem = linearize(ring, observations, prior, errors, hopeless)
        return _estimate(gauss_newton(problem, prior, tolerance_sigmas))
    except np.linalg.LinAlgError:
        return None


def precise_ring(estimate: Estimate) -> Estimate | None:
    """The estimate, iterated further to the precision of a pose; None if the iteration diverges."""
    observations, prior, errors = estimate.residuals.observations, estimate.prior, estimate.nuisance_step
    try:
        problem = linearize(MovingRing(estimate.arcs, estimate.rates), observations, prior, errors)
        return _estimate(gauss_newton(problem, prior))
    except np.linalg.LinAlgError:
        return None


def reweighted_ring(
    estimate: Estimate, measured: Measurements, factor: Float64[Array, "row"], tolerance_sigmas: float
) -> Estimate | None:
    """The ring by measurements whose standard deviations are higher by a factor; None if the iteration diverges.

    The iteration goes on where that of the estimate ended, with its rows divided by the factor.
    """
    try:
        residuals = with_sigmas_raised(estimate.residuals, factor, measured.observations)
        problem = linearized_at(residuals, estimate.prior, estimate.nuisance_step)
        return _estimate(gauss_newton(problem, estimate.prior, tolerance_sigmas))
    except np.linalg.LinAlgError:
        return None


def refine_ring(
    measured: Measurements, prior: Prior, arcs: RingArcs, iterations: int
) -> tuple[RingArcs, Float64[Array, "step=7 step=7"]] | None:
    """A ring near `arcs` after some iterations, and the covariance of its step; None if it diverges.

    For the edge search: many visible edge points may be outliers, so that these have the redescending weights of Geman
    and McClure's loss (Statistical Methods for Tomographic Image Reconstruction, 1987), (1 + (r / s)^2)^-2.
    """
    start, observations = MovingRing(arcs, STILL), measured.observations
    try:
        problem = linearize(start, observations, prior)
        end = gauss_newton(problem, prior, 0.0, iterations=iterations, redescending=True)
        return end.residuals.arcs, _inverse(end.normal_matrix)
    except np.linalg.LinAlgError:
        return None


def _estimate(end: Iterated) -> Estimate:
    """The estimate at the end of an iteration; LinAlgError if it is singular."""
    fixed, nuisance_step, inverse = end.fixed, end.nuisance_step, _inverse(end.normal_matrix)
    residuals = end.residuals
    if not end.distance_sigmas < NEAR_SIGMAS:  # the last step was too long to predict the residuals
        residuals = ring_residuals(residuals.arcs, residuals.observations, end.prior, residuals.rates)
    determined = not poorly_determined(inverse)
    nuisance, many = nuisance_columns(residuals, fixed), np.flatnonzero(residuals.observations.many)
    nuisance_step[: len(residuals.rate_sds)] = 0.0
    remaining = residuals.residual + nuisance @ nuisance_step
    squares = np.minimum(remaining**2, 1e6)
    squares[many] = 0.0
    numbers = residuals.observations.numbers + len(remaining) - residuals.data_rows
    common = np.concatenate([nuisance_step[: len(nuisance_step) - fixed.edge_errors], residuals.rate_deviations])
    return Estimate(
        residuals=residuals,
        arcs=residuals.arcs,
        rates=residuals.rates,
        weights=end.weights,
        fixed=fixed,
        nuisance=nuisance,
        nuisance_step=nuisance_step,
        normal_matrix=end.normal_matrix,
        inverse=inverse,
        prior=end.prior,
        remaining=remaining,
        chi2=float(squares.sum()) + float(common @ common),
        numbers=numbers,
        degrees_of_freedom=max(numbers - PARAMETERS, 0),
        distance_sigmas=end.distance_sigmas,
        converged=end.distance_sigmas < DECISION_SIGMAS,
        determined=determined,
        edge_residuals=remaining[many],
    )


def _inverse(normal_matrix: Float64[Array, "7 7"]) -> Float64[Array, "7 7"]:
    """The covariance; LinAlgError if the matrix is singular: rounding may leave variances that are not positive."""
    inverse = np.linalg.inv(normal_matrix + RIDGE_MATRIX)
    if not bool((inverse.diagonal() > 0).all()):
        raise np.linalg.LinAlgError("the normal matrix is singular")
    return inverse


# Whether the measurements agree

MAX_EDGE_MEAN_SQUARE = 2.0
"""Mean square of the whitened edge residuals from which visible edges contradict the rest. The standard deviations are
those of the fit to all measurements: 150 drawn shots without outliers have at most 1.05."""

MIN_FREEDOM = 0.1
"""Degrees of freedom of a test below which there is nothing to test."""


def is_suspicious(estimate: Estimate) -> bool:
    """Whether the measurements contradict each other, or the ring would fit much better without one of its numbers."""
    return contradicts_itself(estimate) or estimate.largest_reduction > CERTAIN_SIGMAS**2


def contradicts_itself(estimate: Estimate) -> bool:
    """Whether stripes and break points fail the chi-squared test of one ring, or the visible edges do not fit it.

    Visible edges are too many, and their errors too correlated, to be added to the few numbers of stripes and break
    points.
    """
    dof = estimate.expected_chi2
    fails_test = dof > MIN_FREEDOM and estimate.chi2 > chi2_quantile(dof, ALARM_SIGMAS)
    return fails_test or edge_mean_square(estimate) > MAX_EDGE_MEAN_SQUARE


def edge_mean_square(estimate: Estimate) -> float:
    """Mean square of the whitened edge residuals, each limited as in the robust fit; 0 without visible edges."""
    squares = np.minimum(estimate.edge_residuals**2, OUTLIER_SIGMAS**2)
    return float(squares.mean()) if len(squares) else 0.0


def chi2_quantile(degrees_of_freedom: float | int, sigmas: float) -> float:
    """Quantile of chi-squared at the probability of a normal quantile (Wilson and Hilferty 1931)."""
    spread = 2.0 / (9.0 * degrees_of_freedom)
    return degrees_of_freedom * (1.0 - spread + sigmas * sqrt(spread)) ** 3
