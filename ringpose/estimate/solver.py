"""Maximum-likelihood ring by Gauss-Newton (ringpose-method(7), section 5).

The residuals and their derivatives are those of `ringpose.estimate.factors`, of which the iteration needs no more than
the rows. Huber weights bring it near the solution; from there on rows of which there are many count fully or not at
all, and the others fully: outliers among them are judged by `ringpose.estimate.explanation`.
"""

from dataclasses import dataclass
from functools import cached_property, partial
from math import inf, isfinite, sqrt
from typing import NamedTuple

import numpy as np

from ringpose.estimate.factors import (
    EXPECTED_CURVATURE,
    EXPECTED_HALF_BAND_M,
    HOPELESS,
    PARAMETERS,
    RIDGE,
    RIDGE_MATRIX,
    STILL,
    Prior,
    common_errors,
    linearize,
    linearized_at,
    poorly_determined,
    retract_ring,
    ring_residuals,
    with_sigmas_raised,
)
from ringpose.estimate.linearization import FixedColumns, LinearProblem, Observations, Residuals
from ringpose.estimate.measurements import Measurements, Points
from ringpose.geometry.least_squares import huber_weights
from ringpose.geometry.ring import (
    CURVATURE,
    GENERATORS,
    TINY,
    MovingRing,
    Rates,
    RingArcs,
)
from ringpose.types.arrays import Array, Float64
from ringpose.types.detection import JudgedRing

DECISION_SIGMAS = 0.01
"""Estimated distance from the optimum, in standard deviations, from which explanations are compared: their chi-squared
is then known to 1e-4."""

HUBER_SIGMAS = 3.0
"""Residual of a break point or visible edge point from which it counts linearly while the iteration approaches."""

OUTLIER_SIGMAS = 3.5
"""Visible edge points with a larger residual near the solution are rejected: one in two thousand by chance."""

MAX_ITERATIONS = 20

MIN_RATIO, MAX_EXTRAPOLATED = 0.002, 0.5
"""Smallest ratio of successive steps that is relied on, and the largest one from which their sum is extrapolated."""

NEAR_SIGMAS = 0.1
"""Length of a step, in standard deviations, below which the robust phase ends."""

STEADY_SIGMAS = 0.3
"""Way of the ring, in standard deviations, over which its derivatives by common errors hardly change."""

PRECISE_SIGMAS = 1e-6
"""Estimated distance from the optimum, in standard deviations, at which the iteration of a pose ends: the measurement
of a record and its priors give it to some nanometres."""

STRIPES_OF_A_PLANE = 2
"""With fewer stripes the tilt about the stripe is determined by the edges only."""


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

    @property
    def largest_reduction(self) -> float:
        """Largest decrease of chi-squared by leaving out one row of a stripe or break point.

        r^2 / (1 - h), with the leverage h = a M^-1 a^T of its row a in the joint problem of ring and common errors.
        """
        few = np.flatnonzero(~self.residuals.observations.many)
        rows = np.concatenate([self.residuals.jacobian, self.nuisance], axis=1)[few]
        leverage = (np.linalg.solve(self.joint_information, rows.T) * rows.T).sum(axis=0)
        free = leverage < 1.0 - 1e-3  # a number that determines a parameter alone contradicts nothing
        return float((self.remaining[few][free] ** 2 / (1.0 - leverage[free])).max(initial=0.0))

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
    """The ring by an iteration from `start`; None if that diverges, or is useless without weak priors."""
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


class Iterated(NamedTuple):
    """The last linearised problem of an iteration, with the ring after its step."""

    residuals: Residuals
    """Those that the last step predicts."""
    prior: Prior
    fixed: FixedColumns
    weights: Float64[Array, "row"]
    normal_matrix: Float64[Array, "7 7"]
    nuisance_step: Float64[Array, "error"]
    distance_sigmas: float
    """Estimated distance from the optimum, in standard deviations."""


def gauss_newton(
    start: LinearProblem,
    prior: Prior,
    tolerance_sigmas: float = PRECISE_SIGMAS,
    *,
    iterations: int | None = None,
    redescending: bool = False,
) -> Iterated:
    """Iteratively reweighted Gauss-Newton from the problem at a start; LinAlgError if it diverges.

    Derivatives by common errors are those of the start or, where it has none, those after the first step, and again
    those near the solution if it is farther away than `STEADY_SIGMAS`. With `redescending` weights, which follow from
    the residuals themselves, all iterations are made.

    Near the solution each step is the same multiple of the previous one, because second derivatives are neglected: the
    sum of a step and all following ones is step / (1 - ratio) (Aitken's method). The residuals are not evaluated after
    the last step, which predicts them: it neglects less than what is left of the distance from the optimum.
    """
    residuals, fixed, predicted = start
    observations = residuals.observations
    robust, many = np.flatnonzero(observations.robust), np.flatnonzero(observations.many)
    weights, near = np.ones(len(predicted)), False
    sigmas, last_step, last_ratio, since_fixed = inf, np.zeros(PARAMETERS), 0.0, 0.0
    for iteration in range(MAX_ITERATIONS if iterations is None else iterations):
        if iteration:
            residuals = ring_residuals(residuals.arcs, observations, prior, residuals.rates)
            if fixed is None or (near and since_fixed > STEADY_SIGMAS):
                fixed, since_fixed, last_step = common_errors(residuals, prior), 0.0, 0.0 * last_step
        if not near:
            weights[robust] = _robust_weights(residuals.residual[robust], predicted[robust], redescending)
        step, nuisance_step, normal_matrix, predicted = _step(residuals, fixed, weights)

        # lengths are those of Mahalanobis; after a long step, or one that was extrapolated, it shows too little
        last_sigmas, sigmas = sigmas, sqrt(max(float(step @ normal_matrix @ step), 0.0))
        shrinkage = sigmas / max(last_sigmas, TINY) if isfinite(last_sigmas) else 1.0
        distance_sigmas = sigmas * min(max(shrinkage, last_ratio, MIN_RATIO), 1.0)
        shorter = near and 0.0 < sigmas < MAX_EXTRAPOLATED * last_sigmas
        ratio = float(last_step @ normal_matrix @ step) / max(last_sigmas**2, TINY) if shorter else 0.0
        extrapolated = 0.0 < abs(ratio) < MAX_EXTRAPOLATED
        factor = 1.0 / (1.0 - ratio) if extrapolated else 1.0
        last_step, last_ratio = (0.0 * step, abs(ratio)) if extrapolated else (step, 0.0)
        since_fixed += factor * sigmas
        residuals = retract_ring(residuals, factor * step, factor * nuisance_step[: len(residuals.rate_sds)])
        if not (near or redescending or fixed is None) and sigmas < NEAR_SIGMAS:
            near, approached, weights = True, weights, np.ones(len(weights))
            weights[many] = np.abs(predicted[many]) < OUTLIER_SIGMAS
            if not np.array_equal(weights, approached):
                continue
        if near and distance_sigmas < tolerance_sigmas:
            break
    assert fixed is not None
    return Iterated(residuals, prior, fixed, weights, normal_matrix, nuisance_step, distance_sigmas)


def _robust_weights(
    residual: Float64[Array, "row"], predicted: Float64[Array, "row"], redescending: bool
) -> Float64[Array, "row"]:
    """Weights of rows that may be outliers, redescending ones of Geman and McClure or those of Huber.

    The latter follow from the residuals that the last step predicts: before it, outliers hide among large residuals.
    """
    if redescending:
        weights: Float64[Array, "row"] = (1.0 + (residual / HUBER_SIGMAS) ** 2) ** -2
        return weights
    return huber_weights(predicted, HUBER_SIGMAS)


def _step(
    residuals: Residuals, fixed: FixedColumns | None, weights: Float64[Array, "row"]
) -> tuple[Float64[Array, "7"], Float64[Array, "error"], Float64[Array, "7 7"], Float64[Array, "row"]]:
    """The step of ring and common errors, the normal matrix, and the residuals that the step predicts, Eq. (5.9).

    Common errors q of unit variance, with the derivatives B, are eliminated: the Schur complement of the normal
    equations [J B]^T W [J B] + diag(0, 1) is S = J^T W J - J^T W B (1 + B^T W B)^-1 B^T W J, and
    S step = -(J^T W r - J^T W B (1 + B^T W B)^-1 (B^T W r + q)). The residuals contain the common errors q that are
    estimated already, the rates, which come first; the others are 0 there.
    """
    own = 1 + PARAMETERS
    common = [residuals.wrt_rates * residuals.rate_sds, *([] if fixed is None else [fixed.columns])]
    columns = np.concatenate([residuals.residual[:, None], residuals.jacobian, *common], axis=1)  # [r J B]
    products = (columns.T * weights) @ columns
    products.ravel()[own * (len(products) + 1) :: len(products) + 1] += 1.0
    reduced, cross = products[1:own, :own], products[own:]
    cross[: len(residuals.rate_deviations), 0] += residuals.rate_deviations
    solution = np.linalg.solve(cross[:, own:], cross[:, :own])
    reduced = reduced - cross[:, 1:own].T @ solution
    normal_matrix = reduced[:, 1:]
    step = -np.linalg.solve(normal_matrix + RIDGE_MATRIX, reduced[:, 0])
    nuisance_step = -solution[:, 0] - solution[:, 1:] @ step
    predicted = columns[:, 0] + columns[:, 1:own] @ step + columns[:, own:] @ nuisance_step
    return step, nuisance_step, normal_matrix, predicted


def nuisance_columns(residuals: Residuals, fixed: FixedColumns) -> Float64[Array, "row error"]:
    """Matrix B: derivatives with respect to the rates, then the other common errors, in sigmas of their priors."""
    return np.concatenate([residuals.wrt_rates * residuals.rate_sds, fixed.columns], axis=1)


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


# Initial guess

MIN_LENGTH_M = 1e-9
"""A shorter vector has no direction."""


def initial_guess(measured: Measurements, prior: Prior) -> RingArcs | None:
    """The plane of the stripes, and a ring of typical size on it; None if the plane is not in front of the camera.

    The origin lies on the middle of the face, on the mean ray of the break points.
    """
    observations, points = measured.observations, measured.points
    view = observations.view
    if not len(points.x):
        return None
    try:
        plane = _plane_of_stripes(measured)
    except np.linalg.LinAlgError:
        return None
    # the stripes on that plane, and the break points on them
    image_line = view.light_normal - view.light_distance_m[:, None] * plane
    slope = image_line[:, 0] / -image_line[:, 1]
    rays = view.rays.copy()
    rays[:, 1] = slope * rays[:, 0] - image_line[:, 2] / image_line[:, 1]
    inverse_depth = rays @ plane
    if not bool((inverse_depth > 0).all()):
        return None
    ends = view.ends
    rays, slope, depth_m = rays[ends:], slope[ends:], 1.0 / inverse_depth[ends:]
    described = points.described
    points_m = depth_m[:, None] * rays
    # dP/dx of the break points along their stripes, for P = depth r
    points_wrt_x = depth_m[:, None] * np.column_stack([np.ones_like(slope), slope, np.zeros_like(slope)])
    points_wrt_x -= (depth_m * (plane[0] + slope * plane[1]))[:, None] * points_m

    normal = -plane / float(np.sqrt(plane @ plane))
    across = (normal @ GENERATORS).reshape(3, 3)  # across @ v is the cross product of the normal and v
    outward = _outward_direction(normal, across, points, points_m, points_wrt_x)
    mean_ray = rays[described].mean(axis=0)
    origin = mean_ray / float(mean_ray @ plane)
    curvature, half_band_m = _expected_size(points, points_m @ outward, prior)
    if not described.all():  # a circle through the origin, with its centre inward, and the mean point of the other arc
        chord_m = points_m[~described].mean(axis=0) - origin
        curvature = -2.0 * float(chord_m @ outward) / max(float(chord_m @ chord_m), MIN_LENGTH_M**2)
    return RingArcs(
        origin=origin,
        axes=np.array([-outward, across @ -outward, normal]),
        curvature=curvature,
        half_band_m=half_band_m,
    )


def _plane_of_stripes(measured: Measurements) -> Float64[Array, "3"]:
    """The plane q that fits the stripes: (m . r - d q . r) / (m - d q)_y = 0, linear in q for a fixed denominator."""
    observations, view = measured.observations, measured.observations.view
    ends, count = view.ends, len(view.rays)
    whitening = np.zeros((count, count))
    whitening[:ends, :ends] = observations.whitening
    isolated = ends + np.flatnonzero(measured.points.isolated)
    whitening[isolated, isolated] = 1.0 / np.sqrt(measured.points.covariance[isolated - ends, 1, 1])
    distance_m = view.light_distance_m
    cosine = (view.light_normal * view.rays).sum(axis=1)  # m . r
    plane = np.array([0.0, 0.0, float((cosine / distance_m).sum()) / count])
    for _ in range(2):
        denominator = view.light_normal[:, 1] - distance_m * plane[1]
        rows = whitening @ ((distance_m / denominator)[:, None] * view.rays)
        matrix = rows.T @ rows
        matrix[[0, 1], [0, 1]] += 1.0 / plane[2] ** 2  # with a single stripe: a plane that faces the camera
        plane = np.linalg.solve(matrix, rows.T @ (whitening @ (cosine / denominator)))
    return plane


def _outward_direction(
    normal: Float64[Array, "3"],
    across: Float64[Array, "3 3"],
    points: Points,
    points_m: Float64[Array, "point 3"],
    points_wrt_x: Float64[Array, "point 3"],
) -> Float64[Array, "3"]:
    """Mean direction from inner towards outer ends, seen from the middles of their stripes."""
    described = points.described
    first, last = np.flatnonzero(described)[[0, -1]].tolist()
    direction = ((2.0 * points.edge - 1.0) * (points.x - points.middle_x) * described) @ points_wrt_x
    if float(direction @ direction) < MIN_LENGTH_M**2:  # no stripe has a length: across the row of break points
        direction = across @ (points_m[last] - points_m[first])
    if float(direction @ direction) < MIN_LENGTH_M**2:  # a single point: along its stripe
        direction = points_wrt_x[first]
    direction = direction - (direction @ normal) * normal
    unit: Float64[Array, "3"] = direction / np.sqrt(direction @ direction)
    return unit


def _expected_size(points: Points, outward_m: Float64[Array, "point"], prior: Prior) -> tuple[float, float]:
    """Curvature (1/m) of the ring and half the width (m) of its face.

    Both follow from the prior of the radii where it gives them. Otherwise the curvature is that of a typical ring, and
    the width is the mean distance between the inner and the outer break points, at `outward_m` in radial direction.
    """
    edges, described = points.edge, points.described
    inner, outer = (outward_m[described & (edges == edge)].tolist() for edge in range(2))
    half_band_m = 0.5 * (sum(outer) / len(outer) - sum(inner) / len(inner)) if inner and outer else EXPECTED_HALF_BAND_M
    if prior.radii is None or not np.isfinite(prior.radii.radius_m).any():
        return EXPECTED_CURVATURE, half_band_m
    inner_m, outer_m = prior.radii.radius_m.tolist()
    both_known = np.isfinite(outer_m - inner_m)
    return 1.0 / float(np.nanmean(prior.radii.radius_m)), 0.5 * (outer_m - inner_m) if both_known else half_band_m
