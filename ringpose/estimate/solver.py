"""Maximum-likelihood ring by Gauss-Newton (ringpose-method(7), section 5).

Huber weights bring the iteration near the solution; from there on visible edge points count fully or not at all, and
break points fully: outliers among them are judged by `ringpose.estimate.hypotheses`.
"""

from math import isfinite, sqrt
from typing import NamedTuple

import numpy as np

from ringpose.estimate.initial_guess import initial_guess
from ringpose.estimate.measurements import Measurements, Observations
from ringpose.estimate.nuisance import (
    edge_jacobian,
    form_jacobian,
    form_sd_m,
    mean_ray_jacobian,
    rate_sds,
    rig_errors,
    rig_jacobian,
)
from ringpose.estimate.residuals import PARAMETERS, RATES, STILL, Prior, Residuals, ring_residuals
from ringpose.geometry.ring import CURVATURE, LIFT, SHIFT, TILT_ALONG, TILT_INWARD, TURN, Rates, RingArcs
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

_RIDGE = RIDGE * np.eye(PARAMETERS)

MIN_DEPTH_M, MAX_DEPTH_M = 1e-3, 1e3
"""Bounds of the plane's distance; beyond them the iteration has diverged."""

MAX_CURVATURE = 20.0
"""Bound in 1/m; beyond it the iteration has diverged."""

MAX_TILT_RAD = 0.7
"""Largest tilt in one iteration; a longer step is shortened as a whole."""


class Estimate(NamedTuple):
    """A maximum-likelihood ring, and the linearised problem at the solution."""

    arcs: RingArcs
    """At the reference time of the measurements."""
    rates: Rates
    residuals: Residuals
    weights: Float64[Array, "row"]
    """1 for a residual that was used, 0 for a rejected edge point."""
    rig: Float64[Array, "row parameter"] | None
    """Derivatives of the residuals by the rig's parameters, in their own units; None if the rig counts as exact."""
    nuisance: Float64[Array, "row error"]
    """Derivatives of the residuals by common errors of unit variance: rates, rig, form of the ring, visible edges."""
    mean_ray_wrt_nuisance: Float64[Array, "xy=2 error"]
    """Derivatives of the mean of the predicted break points by rates and rig's errors, for a fixed ring."""
    nuisance_step: Float64[Array, "error"]
    """The estimated common errors, in their standard deviations; 0 for the rates, which the residuals contain."""
    rate_deviations: Float64[Array, "rate"]
    """The estimated rates in standard deviations of their prior; empty for a still ring."""
    form: Float64[Array, "row amplitude"] | None
    """Derivatives of the residuals by the amplitudes of the ring's form, in metres; None for a perfect ring."""
    normal_matrix: Float64[Array, "7 7"]
    """Inverse covariance of the ring's step, the common errors marginalised."""
    inverse: Float64[Array, "7 7"]
    """Of the normal matrix with `RIDGE`."""
    edge_errors: int
    """Number of common errors that are those of visible edges, the last ones."""
    prior: Prior
    """As used; with weak priors (`regularize_about`) if the shot leaves parameters open."""

    @property
    def common_chi2(self) -> float:
        """Chi-squared of the estimated rates, rig's errors and form of the ring with respect to their priors."""
        edges = self.nuisance.shape[1] - self.edge_errors
        common = np.concatenate([self.nuisance_step[:edges], self.rate_deviations])
        return float(common @ common)

    @property
    def regularized(self) -> bool:
        """Whether parameters that the shot leaves open were held by weak priors."""
        return self.prior.regularize_about is not None

    @property
    def remaining(self) -> Float64[Array, "row"]:
        """Residuals at the estimated ring less those that the estimated rig and edge errors explain, in sigmas."""
        remaining: Float64[Array, "row"] = self.residuals.residual + self.nuisance @ self.nuisance_step
        return remaining


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
) -> Estimate | None:
    """Iteratively reweighted Gauss-Newton from a ring; None if it diverges."""
    problem = _Problem(measured, observations, rig, prior)
    rates = STILL
    residuals = problem.residuals(arcs, rates)  # r and J, whitened
    nuisance = problem.nuisance(residuals, None)
    fixed, predicted, weights, near = None, residuals.residual, np.ones(len(residuals.residual)), False
    for iteration in range(MAX_ITERATIONS):
        if iteration == 1:  # these derivatives hardly change from here
            fixed = problem.fixed_columns(residuals, arcs)
            nuisance = problem.nuisance(residuals, fixed)
        if not near:
            # weights from the residuals that the last step predicts: before it, outliers hide among large residuals
            weights = _robust_weights(predicted, residuals)
        deviations = problem.rate_deviations(arcs, rates)
        normal_matrix, step, nuisance_step = solve_normal_equations(residuals, weights, nuisance, deviations)
        step = _shortened(step)
        if not _plausible(arcs, step):
            return None
        sigmas = sqrt(max(float(step @ normal_matrix @ step), 0.0))  # Mahalanobis length
        predicted = residuals.residual + residuals.jacobian @ step + nuisance @ nuisance_step
        moved = arcs.moved(step)
        rates, arcs = problem.moved_rates(arcs, moved, rates, nuisance_step), moved
        residuals = problem.residuals(arcs, rates)
        nuisance = problem.nuisance(residuals, fixed)
        if near and sigmas < MIN_STEP_SIGMAS:
            break
        if iteration and not near and sigmas < NEAR_SIGMAS:
            near, weights = True, _inlier_weights(predicted, residuals)
    inverse = _inverse(normal_matrix)
    if inverse is None or fixed is None:
        return None
    mean_ray_wrt_rig = mean_ray_jacobian(residuals, measured, observations, problem.errors, rig)
    by_rates = residuals.y_wrt_rates[residuals.ends :].mean(axis=0) * problem.rate_sds
    count = len(problem.rate_sds)
    return Estimate(
        arcs=arcs,
        rates=rates,
        residuals=residuals,
        weights=weights,
        rig=fixed.rig,
        nuisance=nuisance,
        mean_ray_wrt_nuisance=np.concatenate([[np.zeros(count), by_rates], mean_ray_wrt_rig], axis=1),
        nuisance_step=np.concatenate([np.zeros(count), nuisance_step[count:]]),
        rate_deviations=problem.rate_deviations(arcs, rates),
        form=fixed.form,
        normal_matrix=normal_matrix,
        inverse=inverse,
        edge_errors=measured.edges.common.shape[1] if len(measured.edges.edge) else 0,
        prior=prior,
    )


class _FixedColumns(NamedTuple):
    """Derivatives by common errors that are evaluated once, near the solution."""

    rig: Float64[Array, "row parameter"] | None
    form: Float64[Array, "row amplitude"] | None
    columns: Float64[Array, "row error"]
    """Of the rig's errors, the form and the visible edges, in standard deviations."""


class _Problem:
    """The residuals of one shot and their derivatives by common errors of unit variance."""

    def __init__(self, measured: Measurements, observations: Observations, rig: Rig, prior: Prior) -> None:
        self._measured, self._observations, self._rig, self._prior = measured, observations, rig, prior
        self.errors = rig_errors(rig, prior.assumptions.stability)
        motion = prior.assumptions.motion if observations.moving else None
        self.rate_sds = np.zeros(0) if motion is None else rate_sds(motion)

    def residuals(self, arcs: RingArcs, rates: Rates) -> Residuals:
        """At a ring that moves with these rates."""
        return ring_residuals(arcs, self._measured, self._observations, self._prior, rates)

    def fixed_columns(self, residuals: Residuals, arcs: RingArcs) -> _FixedColumns:
        """Derivatives by the errors of rig, form and visible edges."""
        measured, rig, form, columns = self._measured, None, None, []
        if self.errors is not None:
            rig = rig_jacobian(residuals, measured, self._observations, self.errors, self._rig)
            columns.append(rig @ self.errors.root)
        if self._prior.assumptions.ring_tolerance_m > 0.0:
            form = form_jacobian(residuals, measured, arcs)
            columns.append(form_sd_m(self._prior.assumptions.ring_tolerance_m) * form)
        if len(measured.edges.edge):
            columns.append(edge_jacobian(residuals, measured))
        empty = np.zeros((len(residuals.residual), 0))
        return _FixedColumns(rig, form, np.concatenate([empty, *columns], axis=1))

    def nuisance(self, residuals: Residuals, fixed: _FixedColumns | None) -> Float64[Array, "row error"]:
        """B: derivatives by the rates, then by the other common errors."""
        by_rates = residuals.wrt_rates * self.rate_sds
        return by_rates if fixed is None else np.concatenate([by_rates, fixed.columns], axis=1)

    def rate_deviations(self, arcs: RingArcs, rates: Rates) -> Float64[Array, "rate"]:
        """The rates in standard deviations of their prior; empty for a still ring."""
        if not len(self.rate_sds):
            return self.rate_sds
        values = np.concatenate([rates.velocity_m_s, arcs.axes[:2] @ rates.rate_rad_s])
        return values / np.maximum(self.rate_sds, np.finfo(float).tiny)

    def moved_rates(
        self, arcs: RingArcs, moved: RingArcs, rates: Rates, nuisance_step: Float64[Array, "error"]
    ) -> Rates:
        """The rates after a step of the common errors and of the ring; the angular velocity stays across its normal."""
        if not len(self.rate_sds):
            return rates
        change = nuisance_step[:RATES] * self.rate_sds
        across = arcs.axes[:2] @ rates.rate_rad_s + change[3:]
        return Rates(rates.velocity_m_s + change[:3], across @ moved.axes[:2])


def predicted_residuals(
    estimate: Estimate, measured: Measurements, rig: Rig
) -> tuple[Float64[Array, "row"], Float64[Array, "row row"]]:
    """Residuals of stripes and break points at a ring that was estimated without some of them, and their covariance.

    1 + [J B] C [J B]^T, with the joint covariance C of ring and common errors.
    """
    problem = _Problem(measured, measured.observations(rig.lasers), rig, estimate.prior)
    residuals = problem.residuals(estimate.arcs, estimate.rates)
    fixed = problem.fixed_columns(residuals, estimate.arcs)
    jacobian = np.concatenate([residuals.jacobian, problem.nuisance(residuals, fixed)], axis=1)
    step = np.concatenate([np.zeros(PARAMETERS), estimate.nuisance_step])
    covariance = np.linalg.inv(_joint_information(estimate))
    rows = slice(residuals.data_rows)
    return (residuals.residual + jacobian @ step)[rows], (
        np.eye(residuals.data_rows) + jacobian[rows] @ covariance @ jacobian[rows].T
    )


def log_determinant(estimate: Estimate) -> float:
    """Log determinant of the information on ring and common errors: how much wider their priors are than the result."""
    return float(np.linalg.slogdet(_joint_information(estimate))[1])


def _joint_information(estimate: Estimate) -> Float64[Array, "n n"]:
    """Information on the ring's step and the common errors, with their priors and the ridge."""
    jacobian = np.concatenate([estimate.residuals.jacobian, estimate.nuisance], axis=1)
    information: Float64[Array, "n n"] = (jacobian.T * estimate.weights) @ jacobian
    diagonal = np.ones(len(information))
    diagonal[:PARAMETERS] = RIDGE
    information[range(len(information)), range(len(information))] += diagonal
    return information


def refine_ring(
    measured: Measurements, rig: Rig, prior: Prior, arcs: RingArcs, iterations: int
) -> tuple[RingArcs, Float64[Array, "step=7 step=7"]] | None:
    """A ring near `arcs` after some iterations, and the covariance of its step; None if it diverges.

    For tracking: many visible edge points may be outliers, so that these have redescending weights.
    """
    problem = _Problem(measured, measured.observations(rig.lasers), rig, prior)
    normal_matrix, fixed, rates = np.zeros((PARAMETERS, PARAMETERS)), None, STILL
    try:
        for _ in range(iterations):
            residuals = problem.residuals(arcs, rates)
            fixed = problem.fixed_columns(residuals, arcs) if fixed is None else fixed
            nuisance = problem.nuisance(residuals, fixed)
            weights, robust = np.ones(len(residuals.residual)), slice(residuals.ends, residuals.data_rows)
            weights[robust] = redescending_weights(residuals.residual[robust], HUBER_SIGMAS)
            deviations = problem.rate_deviations(arcs, rates)
            normal_matrix, step, nuisance_step = solve_normal_equations(residuals, weights, nuisance, deviations)
            step = _shortened(step)
            if not _plausible(arcs, step):
                return None
            moved = arcs.moved(step)
            rates, arcs = problem.moved_rates(arcs, moved, rates, nuisance_step), moved
    except np.linalg.LinAlgError:
        return None
    inverse = _inverse(normal_matrix)
    return None if inverse is None else (arcs, inverse)


def _inverse(normal_matrix: Float64[Array, "7 7"]) -> Float64[Array, "7 7"] | None:
    """The covariance; None if the matrix is singular, where rounding may leave variances that are not positive."""
    try:
        inverse = np.linalg.inv(normal_matrix + _RIDGE)
    except np.linalg.LinAlgError:
        return None
    return inverse if bool((inverse.diagonal() > 0).all()) else None


def solve_normal_equations(
    residuals: Residuals,
    weights: Float64[Array, "row"],
    nuisance: Float64[Array, "row error"],
    deviations: Float64[Array, "rate"],
) -> tuple[Float64[Array, "7 7"], Float64[Array, "7"], Float64[Array, "error"]]:
    """The normal matrix with the common errors marginalised, the ring's step, and the step of the common errors.

    With residuals r, Jacobian J, weights W and the derivatives B with respect to the common errors (unit variance),
    the Schur complement of [J B]^T W [J B] + diag(0, 1): S = J^T W J - J^T W B (1 + B^T W B)^-1 B^T W J, and
    S step = -(J^T W r - J^T W B (1 + B^T W B)^-1 (B^T W r + q)), Eq. (5.9). The residuals contain the common errors q
    that are estimated already, the first ones (`deviations`); the others are 0 there.
    """
    weighted = residuals.jacobian.T * weights  # J^T W
    normal_matrix, gradient = weighted @ residuals.jacobian, weighted @ residuals.residual
    count = nuisance.shape[1]
    if not count:
        return normal_matrix, -np.linalg.solve(normal_matrix + _RIDGE, gradient), np.zeros(0)
    weighted_nuisance = nuisance.T * weights  # B^T W
    cross_information = np.empty((count, PARAMETERS + 1))  # B^T W [J r]
    cross_information[:, :-1] = weighted_nuisance @ residuals.jacobian
    cross_information[:, -1] = weighted_nuisance @ residuals.residual
    cross_information[: len(deviations), -1] += deviations
    solution = np.linalg.solve(weighted_nuisance @ nuisance + np.eye(count), cross_information)
    eliminated = cross_information[:, :-1].T @ solution
    normal_matrix = normal_matrix - eliminated[:, :-1]
    step = -np.linalg.solve(normal_matrix + _RIDGE, gradient - eliminated[:, -1])
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


def _shortened(step: Float64[Array, "7"]) -> Float64[Array, "7"]:
    """The step, as a whole not longer than a tilt or turn by `MAX_TILT_RAD`."""
    largest = max(map(abs, step[[TILT_INWARD, TILT_ALONG, TURN]].tolist()))
    return step * (MAX_TILT_RAD / largest) if largest > MAX_TILT_RAD else step


def _plausible(arcs: RingArcs, step: Float64[Array, "7"]) -> bool:
    """Whether the next ring is in front of the camera and has a possible size."""
    depth_m = -float(arcs.normal @ (arcs.origin + step[LIFT] * arcs.normal + step[SHIFT] * arcs.axes[0]))
    curvature = abs(arcs.curvature + float(step[CURVATURE]))
    return all(map(isfinite, step.tolist())) and MIN_DEPTH_M < depth_m < MAX_DEPTH_M and curvature < MAX_CURVATURE


def is_poorly_determined(estimate: Estimate) -> bool:
    """Whether the shot leaves tilt or in-plane rotation to more than 0.5 rad, or curvature to more than 1/m (sigmas).

    The weak priors of `ring_residuals` have about these standard deviations.
    """
    variance = estimate.inverse.diagonal().tolist()
    return bool(max(variance[TILT_INWARD], variance[TILT_ALONG], variance[TURN]) > 0.25 or variance[CURVATURE] > 1.0)
