"""Maximum-likelihood ring by Gauss-Newton (ringpose-method(7), section 5).

Huber weights bring the iteration near the solution; from there on visible edge points count fully or not at all, and
break points fully: outliers among them are judged by `ringpose.estimate.hypotheses`.
"""

from math import inf, sqrt
from typing import NamedTuple

import numpy as np

from ringpose.estimate.initial_guess import initial_guess
from ringpose.estimate.measurements import Measurements, Observations
from ringpose.estimate.nuisance import FixedColumns, fixed_columns, mean_ray_jacobian
from ringpose.estimate.residuals import PARAMETERS, STILL, Prior, Residuals, moved_residuals, ring_residuals
from ringpose.geometry.ring import CURVATURE, TILT_ALONG, TILT_INWARD, TURN, Rates, RingArcs
from ringpose.geometry.robust import huber_weights, redescending_weights
from ringpose.types.arrays import Array, Float64
from ringpose.types.rig import Rig

HUBER_SIGMAS = 3.0
"""Residual of a break point or visible edge point from which it counts linearly while the iteration approaches."""

OUTLIER_SIGMAS = 3.5
"""Visible edge points with a larger residual near the solution are rejected: one in two thousand by chance."""

MAX_ITERATIONS = 20

NEAR_SIGMAS, MIN_STEP_SIGMAS = 0.1, 1e-7
"""Steps below the first length (in standard deviations) end the robust phase, below the second one the iteration.

After the last step, which is made, the next one would be a hundred to a thousand times shorter: the measurement of a
record and its priors give its pose to a nanometre.
"""

STRIPES_OF_A_PLANE = 2
"""With fewer stripes the tilt about the stripe is determined by the edges only."""

RIDGE = 1e-7
"""Added to the diagonal of the normal matrix (m, rad, 1/m), so that undetermined parameters keep their values."""


class Estimate(NamedTuple):
    """A maximum-likelihood ring, and the linearised problem at the solution."""

    residuals: Residuals
    weights: Float64[Array, "row"]
    """1 for a residual that was used, 0 for a rejected edge point."""
    fixed: FixedColumns
    nuisance: Float64[Array, "row error"]
    """Derivatives of the residuals by common errors of unit variance: rates, rig, form of the ring, visible edges."""
    mean_ray_wrt_nuisance: Float64[Array, "xy=2 error"]
    """Derivatives of the mean of the predicted break points by rates and rig's errors, for a fixed ring."""
    nuisance_step: Float64[Array, "error"]
    """The estimated common errors, in their standard deviations; 0 for the rates, which the residuals contain."""
    normal_matrix: Float64[Array, "7 7"]
    """Inverse covariance of the ring's step, the common errors marginalised."""
    inverse: Float64[Array, "7 7"]
    """Of the normal matrix with `RIDGE`."""
    prior: Prior
    """As used; with weak priors (`regularize_about`) if the shot leaves parameters open."""
    remaining: Float64[Array, "row"]
    """Residuals at the estimated ring less those that the estimated rig and edge errors explain, in sigmas."""
    chi2: float
    """Chi-squared of stripes, break points and priors; visible edges are too many to be compared with these."""

    @property
    def arcs(self) -> RingArcs:
        """The ring at the reference time of the measurements."""
        return self.residuals.arcs

    @property
    def rates(self) -> Rates:
        """Its motion."""
        return self.residuals.rates

    @property
    def regularized(self) -> bool:
        """Whether parameters that the shot leaves open were held by weak priors."""
        return self.prior.regularize_about is not None

    @property
    def degrees_of_freedom(self) -> int:
        """Numbers of stripes, break points and radii less the parameters.

        Rows of weak priors count like measurements.
        """
        prior_rows = len(self.residuals.residual) - self.residuals.data_rows
        return max(self.residuals.stripe_rows + prior_rows - PARAMETERS, 0)

    @property
    def edge_residuals(self) -> Float64[Array, "visible"]:
        """Residuals of the visible edge points, less common errors, in standard deviations."""
        return self.remaining[self.residuals.stripe_rows : self.residuals.data_rows]

    @property
    def edge_weights(self) -> Float64[Array, "visible"]:
        """1 for visible edge points that were used."""
        return self.weights[self.residuals.stripe_rows : self.residuals.data_rows]

    @property
    def joint_information(self) -> Float64[Array, "n n"]:
        """Information on the ring's step and the common errors, with their priors and the ridge."""
        jacobian = np.concatenate([self.residuals.jacobian, self.nuisance], axis=1)
        information: Float64[Array, "n n"] = (jacobian.T * self.weights) @ jacobian
        diagonal = np.ones(len(information))
        diagonal[:PARAMETERS] = RIDGE
        information[range(len(information)), range(len(information))] += diagonal
        return information

    @property
    def log_determinant(self) -> float:
        """Of the information on ring and common errors: how much wider their priors are than the result."""
        return float(np.linalg.slogdet(self.joint_information)[1])

    @property
    def largest_reduction(self) -> float:
        """By how much chi-squared would fall without the number of stripes and break points that contradicts most.

        r^2 / (1 - h), with the leverage h = a M^-1 a^T of its row a in the joint problem of ring and common errors.
        """
        count = self.residuals.stripe_rows
        rows = np.concatenate([self.residuals.jacobian, self.nuisance], axis=1)[:count]
        leverage = (np.linalg.solve(self.joint_information, rows.T) * rows.T).sum(axis=0)
        free = leverage < 1.0 - 1e-3  # a number that determines a parameter alone contradicts nothing
        return float((self.remaining[:count][free] ** 2 / (1.0 - leverage[free])).max(initial=0.0))

    @property
    def curvature_alone(self) -> tuple[float, float]:
        """The curvature by the shot alone, without the prior, and its standard deviation.

        From the normal equations without the rows of the prior, whose gradient balances that of the data.
        """
        prior = self.residuals.jacobian[self.residuals.data_rows :]
        information = self.normal_matrix - prior.T @ prior + RIDGE * np.eye(PARAMETERS)
        try:
            covariance = np.linalg.inv(information)
        except np.linalg.LinAlgError:
            return 0.0, inf
        step = covariance @ (prior.T @ self.residuals.residual[self.residuals.data_rows :])
        variance = float(covariance[CURVATURE, CURVATURE])
        return self.arcs.curvature + float(step[CURVATURE]), sqrt(variance) if variance > 0 else inf


def estimate_ring(measured: Measurements, rig: Rig, prior: Prior, start: RingArcs | None = None) -> Estimate | None:
    """The maximum-likelihood ring; None if the iteration diverges. `start`: an approximate ring, if one is known.

    Parameters that the shot leaves open (with one stripe the tilt about it, with two the curvature) are held by weak
    priors in a second run, so that they do not degrade the others. If visible edges close such a gap, the regularised
    solution is the start: far from the ring, edges lead to wrong minima.
    """
    edges_seen = {*measured.points.edge.tolist(), *measured.edges.edge.tolist()}
    prior = prior._replace(single_edge=prior.radii is None and len(edges_seen) == 1)
    observations = measured.observations(rig.lasers)

    def solve(start: RingArcs, prior: Prior) -> Estimate | None:
        try:
            return _gauss_newton(measured, observations, rig, start, prior)
        except np.linalg.LinAlgError:
            return None

    with np.errstate(all="ignore"):  # a diverging iteration ends in `_plausible`
        guess = start
        start = initial_guess(measured, observations, prior) if guess is None else guess
        if start is None:
            return None
        if guess is None and len(measured.edges.edge) and len(measured.lines.laser) < STRIPES_OF_A_PLANE:
            regularized = solve(start, prior._replace(regularize_about=start))
            start = start if regularized is None else regularized.arcs
        estimate = solve(start, prior)
        if estimate is None or is_poorly_determined(estimate):
            estimate = solve(start, prior._replace(regularize_about=start))
        # one edge without a line on the face beside it leaves open on which side the centre is: try the other one
        side_open = prior.single_edge and bool(measured.points.isolated.all())
        if estimate is not None and estimate.arcs.curvature < 0 and side_open:
            estimate = solve(estimate.arcs.with_center_opposite(), prior) or estimate
    return estimate


def _gauss_newton(
    measured: Measurements,
    observations: Observations,
    rig: Rig,
    arcs: RingArcs,
    prior: Prior,
    rates: Rates = STILL,
) -> Estimate | None:
    """Iteratively reweighted Gauss-Newton from a ring; None if it diverges."""
    residuals = ring_residuals(arcs, measured, observations, prior, rates)  # r and J, whitened
    count = len(residuals.rate_sds)
    nuisance = residuals.wrt_rates * residuals.rate_sds
    fixed, predicted, weights, near = None, residuals.residual, np.ones(len(residuals.residual)), False
    for iteration in range(MAX_ITERATIONS):
        if iteration == 1:  # these derivatives hardly change from here
            fixed = fixed_columns(residuals, measured, observations, prior, rig)
            nuisance = _nuisance(residuals, fixed)
        if not near:
            # weights from the residuals that the last step predicts: before it, outliers hide among large residuals
            weights = _robust_weights(predicted, residuals)
        normal_matrix, step, nuisance_step = solve_normal_equations(residuals, weights, nuisance)
        sigmas = sqrt(max(float(step @ normal_matrix @ step), 0.0))  # Mahalanobis length
        predicted = residuals.residual + residuals.jacobian @ step + nuisance @ nuisance_step
        moved = moved_residuals(residuals, step, nuisance_step[:count], measured, observations, prior)
        if moved is None:
            return None
        residuals, nuisance = moved, _nuisance(moved, fixed)
        if near and sigmas < MIN_STEP_SIGMAS:
            break
        if iteration and not near and sigmas < NEAR_SIGMAS:
            near, weights = True, _inlier_weights(predicted, residuals)
    inverse = _inverse(normal_matrix)
    if inverse is None or fixed is None:
        return None
    nuisance_step[:count] = 0.0
    remaining = residuals.residual + nuisance @ nuisance_step
    squares = np.minimum(remaining**2, 1e6)
    squares[residuals.stripe_rows : residuals.data_rows] = 0.0
    common = np.concatenate([nuisance_step[: len(nuisance_step) - fixed.edge_errors], residuals.rate_deviations])
    return Estimate(
        residuals=residuals,
        weights=weights,
        fixed=fixed,
        nuisance=nuisance,
        mean_ray_wrt_nuisance=mean_ray_jacobian(residuals, measured, observations, prior, rig),
        nuisance_step=nuisance_step,
        normal_matrix=normal_matrix,
        inverse=inverse,
        prior=prior,
        remaining=remaining,
        chi2=float(squares.sum()) + float(common @ common),
    )


def _nuisance(residuals: Residuals, fixed: FixedColumns | None) -> Float64[Array, "row error"]:
    """B: derivatives by the rates, then by the other common errors, in standard deviations of their priors."""
    by_rates = residuals.wrt_rates * residuals.rate_sds
    return by_rates if fixed is None else np.concatenate([by_rates, fixed.columns], axis=1)


def predicted_residuals(
    estimate: Estimate, measured: Measurements, rig: Rig
) -> tuple[Float64[Array, "row"], Float64[Array, "row row"]]:
    """Residuals of stripes and break points at a ring that was estimated without some of them, and their covariance.

    1 + [J B] C [J B]^T, with the joint covariance C of ring and common errors.
    """
    observations = measured.observations(rig.lasers)
    residuals = ring_residuals(estimate.arcs, measured, observations, estimate.prior, estimate.rates)
    fixed = fixed_columns(residuals, measured, observations, estimate.prior, rig)
    jacobian = np.concatenate([residuals.jacobian, _nuisance(residuals, fixed)], axis=1)
    step = np.concatenate([np.zeros(PARAMETERS), estimate.nuisance_step])
    covariance = np.linalg.inv(estimate.joint_information)
    rows = slice(residuals.data_rows)
    return (residuals.residual + jacobian @ step)[rows], (
        np.eye(residuals.data_rows) + jacobian[rows] @ covariance @ jacobian[rows].T
    )


def refine_ring(
    measured: Measurements, rig: Rig, prior: Prior, arcs: RingArcs, iterations: int
) -> tuple[RingArcs, Float64[Array, "step=7 step=7"]] | None:
    """A ring near `arcs` after some iterations, and the covariance of its step; None if it diverges.

    For tracking: many visible edge points may be outliers, so that these have redescending weights.
    """
    observations = measured.observations(rig.lasers)
    residuals = ring_residuals(arcs, measured, observations, prior)
    fixed = fixed_columns(residuals, measured, observations, prior, rig)
    normal_matrix = np.zeros((PARAMETERS, PARAMETERS))
    robust = slice(residuals.ends, residuals.data_rows)
    try:
        for _ in range(iterations):
            weights = np.ones(len(residuals.residual))
            weights[robust] = redescending_weights(residuals.residual[robust], HUBER_SIGMAS)
            normal_matrix, step, nuisance_step = solve_normal_equations(residuals, weights, _nuisance(residuals, fixed))
            rate_step = nuisance_step[: len(residuals.rate_sds)]
            moved = moved_residuals(residuals, step, rate_step, measured, observations, prior)
            if moved is None:
                return None
            residuals = moved
    except np.linalg.LinAlgError:
        return None
    inverse = _inverse(normal_matrix)
    return None if inverse is None else (residuals.arcs, inverse)


def _inverse(normal_matrix: Float64[Array, "7 7"]) -> Float64[Array, "7 7"] | None:
    """The covariance; None if the matrix is singular, where rounding may leave variances that are not positive."""
    try:
        inverse = np.linalg.inv(normal_matrix + RIDGE * np.eye(PARAMETERS))
    except np.linalg.LinAlgError:
        return None
    return inverse if bool((inverse.diagonal() > 0).all()) else None


def solve_normal_equations(
    residuals: Residuals, weights: Float64[Array, "row"], nuisance: Float64[Array, "row error"]
) -> tuple[Float64[Array, "7 7"], Float64[Array, "7"], Float64[Array, "error"]]:
    """The normal matrix with the common errors marginalised, the ring's step, and the step of the common errors.

    With residuals r, Jacobian J, weights W and the derivatives B with respect to the common errors (unit variance),
    the Schur complement of [J B]^T W [J B] + diag(0, 1): S = J^T W J - J^T W B (1 + B^T W B)^-1 B^T W J, and
    S step = -(J^T W r - J^T W B (1 + B^T W B)^-1 (B^T W r + q)), Eq. (5.9). The residuals contain the common errors q
    that are estimated already, the rates, which come first; the others are 0 there.
    """
    weighted = residuals.jacobian.T * weights  # J^T W
    normal_matrix, gradient = weighted @ residuals.jacobian, weighted @ residuals.residual
    count = nuisance.shape[1]
    if not count:
        return normal_matrix, -np.linalg.solve(normal_matrix + RIDGE * np.eye(PARAMETERS), gradient), np.zeros(0)
    weighted_nuisance = nuisance.T * weights  # B^T W
    cross_information = np.empty((count, PARAMETERS + 1))  # B^T W [J r]
    cross_information[:, :-1] = weighted_nuisance @ residuals.jacobian
    cross_information[:, -1] = weighted_nuisance @ residuals.residual
    deviations = residuals.rate_deviations
    cross_information[: len(deviations), -1] += deviations
    solution = np.linalg.solve(weighted_nuisance @ nuisance + np.eye(count), cross_information)
    eliminated = cross_information[:, :-1].T @ solution
    normal_matrix = normal_matrix - eliminated[:, :-1]
    step = -np.linalg.solve(normal_matrix + RIDGE * np.eye(PARAMETERS), gradient - eliminated[:, -1])
    return normal_matrix, step, -solution[:, -1] - solution[:, :-1] @ step


def _robust_weights(residual: Float64[Array, "row"], residuals: Residuals) -> Float64[Array, "row"]:
    """Huber weights of break points and visible edges; 1 for lines, which are robust fits, and for the prior."""
    first, last = residuals.ends, residuals.data_rows
    weights = np.ones(len(residual))
    weights[first:last] = huber_weights(residual[first:last], HUBER_SIGMAS)
    return weights


def _inlier_weights(residual: Float64[Array, "row"], residuals: Residuals) -> Float64[Array, "row"]:
    """0 for the visible edge points that are outliers, 1 for everything else."""
    weights = np.ones(len(residual))
    edges = slice(residuals.data_rows - len(residuals.edge_scale), residuals.data_rows)
    weights[edges] = np.abs(residual[edges]) < OUTLIER_SIGMAS
    return weights


def is_poorly_determined(estimate: Estimate) -> bool:
    """Whether the shot leaves tilt or in-plane rotation to more than 0.5 rad, or curvature to more than 1/m (sigmas).

    The weak priors of `ring_residuals` have about these standard deviations.
    """
    variance = estimate.inverse.diagonal().tolist()
    return bool(max(variance[TILT_INWARD], variance[TILT_ALONG], variance[TURN]) > 0.25 or variance[CURVATURE] > 1.0)
