"""Maximum-likelihood ring by Gauss-Newton (ringpose-method(7), section 5).

The residuals are those of `ringpose.estimate.residuals`. Huber weights bring the iteration near the solution; from
there on visible edge points count fully or not at all, and break points fully: outliers among them are judged by
`ringpose.estimate.hypotheses`.
"""

from dataclasses import replace
from math import isfinite, sqrt

import numpy as np

from ringpose.estimate.initial_guess import initial_guess
from ringpose.estimate.measurements import Measurements, Observations, Points
from ringpose.estimate.nuisance import fixed_columns
from ringpose.estimate.residuals import (
    CURVATURE_SD,
    EXPECTED_CURVATURE,
    EXPECTED_HALF_BAND_M,
    HALF_BAND_SD_M,
    PARAMETERS,
    RIDGE,
    STILL,
    TILT_SD_RAD,
    TURN_SD_RAD,
    Estimate,
    FixedColumns,
    OrdinateScale,
    Prior,
    Residuals,
)
from ringpose.geometry.ring import (
    CURVATURE,
    EDGE_SIGN,
    HALF_BAND,
    MIN_RATE,
    TILT_ALONG,
    TILT_INWARD,
    TURN,
    Rates,
    RingArcs,
    motion_derivatives,
    predicted_view,
)
from ringpose.geometry.robust import huber_weights
from ringpose.types.arrays import Array, Float64
from ringpose.types.rig import LaserPlanes, Rig

HUBER_SIGMAS = 3.0
"""Residual of a break point or visible edge point from which it counts linearly while the iteration approaches."""

OUTLIER_SIGMAS = 3.5
"""Visible edge points with a larger residual near the solution are rejected: one in two thousand by chance."""

MAX_ITERATIONS = 20

NEAR_SIGMAS = 0.1
"""Length of a step, in standard deviations, below which the robust phase ends."""

PRECISE_SIGMAS, DECISION_SIGMAS = 1e-7, 0.05
"""Length of the last step, which is made; the next one would be twenty to a thousand times shorter.

Of a pose: the measurement of a record and its priors give it to a nanometre. To decide between explanations: their
chi-squared is then known to 1e-4.
"""

HOPELESS = 1e4
"""Factor on the limits of `poorly_determined` beyond which an iteration that starts without weak priors ends."""

STRIPES_OF_A_PLANE = 2
"""With fewer stripes the tilt about the stripe is determined by the edges only."""

MIN_DEPTH_M, MAX_DEPTH_M = 1e-3, 1e3
"""Bounds of the plane's distance; beyond them the iteration has diverged."""

MAX_CURVATURE = 20.0
"""Bound in 1/m; beyond it the iteration has diverged."""

MAX_TILT_RAD = 0.7
"""Largest tilt in one iteration."""


def estimate_ring(
    measured: Measurements,
    rig: Rig,
    prior: Prior,
    start: RingArcs | None = None,
    *,
    guess: RingArcs | None = None,
    step_sigmas: float = PRECISE_SIGMAS,
) -> Estimate | None:
    """The maximum-likelihood ring; None if the iteration diverges. `start`: a ring near it, if one is known.

    Parameters that the shot leaves open (with one stripe the tilt about it, with two the curvature) are held by weak
    priors about the initial guess in a second run, so that they do not degrade the others. If visible edges close such
    a gap, the regularised solution is the start: far from the ring, edges lead to wrong minima. `guess`: the initial
    guess, if it was made already; `step_sigmas`: length of the step that ends the iteration.
    """
    edges_seen = {*measured.points.edge.tolist(), *measured.edges.edge.tolist()}
    prior = prior._replace(single_edge=prior.radii is None and len(edges_seen) == 1)
    observations = measured.observations(rig.lasers)

    def solve(start: RingArcs, prior: Prior, step_sigmas: float = step_sigmas) -> Estimate | None:
        try:
            return _gauss_newton(measured, observations, rig, start, prior, step_sigmas=step_sigmas)
        except np.linalg.LinAlgError:
            return None

    with np.errstate(all="ignore"):  # a diverging iteration ends in `moved_residuals`
        if guess is None and start is None:
            guess = initial_guess(measured, observations, prior)
        if (
            start is None
            and guess is not None
            and len(measured.edges.edge)
            and len(measured.stripes) < STRIPES_OF_A_PLANE
        ):
            regularized = solve(guess, prior._replace(regularize_about=guess), NEAR_SIGMAS)
            start = None if regularized is None else regularized.arcs
        start = guess if start is None else start
        if start is None:
            return None
        estimate = solve(start, prior)
        if estimate is None or poorly_determined(estimate.inverse):
            guess = initial_guess(measured, observations, prior) if guess is None else guess
            estimate = solve(start, prior._replace(regularize_about=start if guess is None else guess))
        # one edge without a line on the face beside it leaves open on which side the centre is: try the other one
        side_open = prior.single_edge and bool(measured.points.isolated.all())
        if estimate is not None and estimate.arcs.curvature < 0 and side_open:
            estimate = solve(estimate.arcs.with_center_opposite(), prior) or estimate
    return estimate


def precise_ring(estimate: Estimate, measured: Measurements, rig: Rig) -> Estimate | None:
    """An estimate that may have ended after a longer step, to the precision of a pose; None if it diverges."""
    if estimate.step_sigmas < PRECISE_SIGMAS:
        return estimate
    observations = measured.observations(rig.lasers)
    try:
        return _gauss_newton(measured, observations, rig, estimate.arcs, estimate.prior, estimate.rates)
    except np.linalg.LinAlgError:
        return None


def _gauss_newton(
    measured: Measurements,
    observations: Observations,
    rig: Rig,
    arcs: RingArcs,
    prior: Prior,
    rates: Rates = STILL,
    step_sigmas: float = PRECISE_SIGMAS,
) -> Estimate | None:
    """Iteratively reweighted Gauss-Newton from a ring; None if it diverges, or is far from being determined."""
    residuals = ring_residuals(arcs, measured, observations, prior, rates)  # r and J, whitened
    if prior.regularize_about is None and _is_hopeless(residuals):
        return None
    count = len(residuals.rate_sds)
    nuisance = residuals.wrt_rates * residuals.rate_sds
    fixed, predicted, weights, near = None, residuals.residual, np.ones(len(residuals.residual)), False
    for iteration in range(MAX_ITERATIONS):
        if iteration == 1:  # these derivatives hardly change from here
            fixed = fixed_columns(residuals, measured, observations, prior, rig)
            nuisance = _nuisance(residuals, fixed)
        # weights from the residuals that the last step predicts: before it, outliers hide among large residuals
        weights = weights if near else _robust_weights(predicted, residuals)
        normal_matrix, step, nuisance_step = solve_normal_equations(residuals, weights, nuisance)
        sigmas = sqrt(max(float(step @ normal_matrix @ step), 0.0))  # Mahalanobis length
        predicted = residuals.residual + residuals.jacobian @ step + nuisance @ nuisance_step
        moved = moved_residuals(residuals, step, nuisance_step[:count], measured, observations, prior)
        if moved is None:
            return None
        residuals, nuisance = moved, _nuisance(moved, fixed)
        converged = near and sigmas < step_sigmas
        if iteration and not near and sigmas < NEAR_SIGMAS:
            robust, near, weights = weights, True, _inlier_weights(predicted, residuals)
            converged = sigmas < step_sigmas and np.array_equal(weights, robust)
        if converged:
            break
    inverse = _inverse(normal_matrix)
    if inverse is None or fixed is None:
        return None
    nuisance_step[:count] = 0.0
    remaining = residuals.residual + nuisance @ nuisance_step
    squares = np.minimum(remaining**2, 1e6)
    squares[residuals.stripe_rows : residuals.data_rows] = 0.0
    common = np.concatenate([nuisance_step[: len(nuisance_step) - fixed.edge_errors], residuals.rate_deviations])
    y_wrt_rates = residuals.y_wrt_rates[residuals.ends :].mean(axis=0) * residuals.rate_sds
    mean_ray_wrt_rates = np.array([np.zeros_like(y_wrt_rates), y_wrt_rates])
    return Estimate(
        residuals=residuals,
        arcs=residuals.arcs,
        rates=residuals.rates,
        weights=weights,
        fixed=fixed,
        nuisance=nuisance,
        mean_ray_wrt_nuisance=np.concatenate([mean_ray_wrt_rates, fixed.mean_ray_wrt_rig], axis=1),
        nuisance_step=nuisance_step,
        normal_matrix=normal_matrix,
        inverse=inverse,
        prior=prior,
        remaining=remaining,
        chi2=float(squares.sum()) + float(common @ common),
        step_sigmas=sigmas,
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

    For the edge search: many visible edge points may be outliers, so that these have the redescending weights of Geman
    and McClure's loss (Statistical Methods for Tomographic Image Reconstruction, 1987), (1 + (r / s)^2)^-2.
    """
    observations = measured.observations(rig.lasers)
    residuals = ring_residuals(arcs, measured, observations, prior)
    fixed = fixed_columns(residuals, measured, observations, prior, rig)
    normal_matrix = np.zeros((PARAMETERS, PARAMETERS))
    robust = slice(residuals.ends, residuals.data_rows)
    try:
        for _ in range(iterations):
            weights = np.ones(len(residuals.residual))
            weights[robust] = (1.0 + (residuals.residual[robust] / HUBER_SIGMAS) ** 2) ** -2
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
    robust = slice(residuals.ends, residuals.data_rows)
    weights = np.ones(len(residual))
    if np.abs(residual[robust]).max(initial=0.0) > HUBER_SIGMAS:
        weights[robust] = huber_weights(residual[robust], HUBER_SIGMAS)
    return weights


def _inlier_weights(residual: Float64[Array, "row"], residuals: Residuals) -> Float64[Array, "row"]:
    """0 for the visible edge points that are outliers, 1 for everything else."""
    weights = np.ones(len(residual))
    edges = slice(residuals.stripe_rows, residuals.data_rows)
    weights[edges] = np.abs(residual[edges]) < OUTLIER_SIGMAS
    return weights


def poorly_determined(covariance: Float64[Array, "7 7"], factor: float = 1.0) -> bool:
    """Whether tilt or in-plane rotation are left to more than 0.5 rad, or curvature to more than 1/m (sigmas).

    The weak priors of `ring_residuals` have about these standard deviations. `factor`: on the variances.
    """
    variance = covariance.diagonal().tolist()
    return bool(max(variance[TILT_INWARD], variance[TILT_ALONG], variance[TURN]) > 0.25 * factor) or bool(
        variance[CURVATURE] > factor
    )


def _is_hopeless(residuals: Residuals) -> bool:
    """Whether parameters are so far from being determined that the iteration is useless without weak priors."""
    inverse = _inverse(residuals.jacobian.T @ residuals.jacobian)
    return inverse is not None and poorly_determined(inverse, HOPELESS)


def ring_residuals(
    arcs: RingArcs, measured: Measurements, observations: Observations, prior: Prior, rates: Rates = STILL
) -> Residuals:
    """The residuals of a ring at the reference time; `observations` are the measurements with their light planes.

    With a prior of the motion, every residual is evaluated for the ring at the time of its own frame.
    """
    motion = prior.assumptions.motion if observations.moving else None
    sds = np.zeros(0) if motion is None else np.array([motion.speed_sd_m_s] * 3 + [motion.rate_sd_rad_s] * 2)
    stripes, points, edges = predicted_view(arcs, observations.view, rates if len(sds) else None)
    ends = observations.view.ends
    # a: whitened distances of the lines' ends from the predicted lines
    above = observations.view.rays[:, 1] - stripes.rays[:, 1]
    blocks = [(observations.whitening @ above[:ends], -observations.whitening @ stripes.y_wrt_step[:ends])]

    # b: distances of the break points from their edges, along the predicted lines
    wrt_step = points.wrt_step + points.wrt_ray[:, 1:] * stripes.y_wrt_step[ends:]  # the point moves with its line
    distance_wrt_x = points.wrt_ray[:, 0] + stripes.slope[ends:] * points.wrt_ray[:, 1]
    distance_wrt_x = np.where(np.abs(distance_wrt_x) < MIN_RATE, MIN_RATE, distance_wrt_x)
    scale = 1.0 / (np.abs(distance_wrt_x) * observations.sigma_x)
    blocks.append((scale * points.distance_m, scale[:, None] * wrt_step))

    ordinates = _ordinate_scale(measured.points, stripes.slope[ends:], distance_wrt_x)
    which, share, ordinate_scale = ordinates
    if len(which):
        remainder = above[ends:][which] - share * points.distance_m[which]
        jacobian = -stripes.y_wrt_step[ends:][which] - share[:, None] * wrt_step[which]
        blocks.append((ordinate_scale * remainder, ordinate_scale[:, None] * jacobian))

    # c: distances of the visible edge points from their edges, along the edges' normals in the image
    sigma_m = np.abs((edges.wrt_ray * measured.edges.step).sum(axis=1))
    edge_scale = 1.0 / np.maximum(sigma_m, np.finfo(float).tiny)
    blocks.append((edge_scale * edges.distance_m, edge_scale[:, None] * edges.wrt_step))

    residual, wrt_all = (np.concatenate(each) for each in zip(*blocks, strict=True))
    prior_residual, prior_jacobian = _prior_residuals(arcs, prior)  # d
    rate_columns = slice(PARAMETERS, PARAMETERS + len(sds))
    return Residuals(
        arcs=arcs,
        rates=rates,
        rate_sds=sds,
        rate_deviations=_rates_along(arcs, rates)[: len(sds)] / np.maximum(sds, np.finfo(float).tiny),
        residual=np.concatenate([residual, prior_residual]),
        jacobian=np.concatenate([wrt_all[:, :PARAMETERS], prior_jacobian]),
        ends=ends,
        stripe_rows=len(residual) - len(edge_scale),
        data_rows=len(residual),
        stripe_numbers=observations.stripe_numbers,
        stripes=stripes._replace(y_wrt_step=stripes.y_wrt_step[:, :PARAMETERS]),
        points=points,
        edges=edges,
        edge_scale=edge_scale,
        distance_wrt_x=distance_wrt_x,
        distance_scale=scale,
        ordinates=ordinates,
        wrt_rates=_with_zero_rows(wrt_all[:, rate_columns], len(prior_residual)),
        wrt_camera=_with_zero_rows(wrt_all[:, rate_columns.stop :], len(prior_residual)),
        y_wrt_rates=stripes.y_wrt_step[:, rate_columns],
    )


def moved_residuals(
    residuals: Residuals,
    step: Float64[Array, "step=7"],
    rate_step: Float64[Array, "rate"],
    measured: Measurements,
    observations: Observations,
    prior: Prior,
) -> Residuals | None:
    """The residuals after a step of the ring, and of its rates in their standard deviations.

    A step longer than `MAX_TILT_RAD` is shortened as a whole. None if the ring is then not in front of the camera, or
    has an impossible size. The angular velocity stays across the normal.
    """
    arcs, rates = residuals.arcs, residuals.rates
    largest = max(map(abs, step[[TILT_INWARD, TILT_ALONG, TURN]].tolist()))
    moved = arcs.moved(step * (MAX_TILT_RAD / largest) if largest > MAX_TILT_RAD else step)
    depth_m = -float(arcs.axes[2] @ moved.origin)
    possible = MIN_DEPTH_M < depth_m < MAX_DEPTH_M and abs(moved.curvature) < MAX_CURVATURE
    if not (possible and all(map(isfinite, step.tolist()))):
        return None
    if len(rate_step):
        along = _rates_along(arcs, rates) + rate_step * residuals.rate_sds
        rates = Rates(along[:3], along[3:] @ moved.axes[:2])
    return ring_residuals(moved, measured, observations, prior, rates)


def _rates_along(arcs: RingArcs, rates: Rates) -> Float64[Array, "rate=5"]:
    """The velocity, and the angular velocities about the inward axis and about the axis along the face."""
    return np.concatenate([rates.velocity_m_s, arcs.axes[:2] @ rates.rate_rad_s])


def _with_zero_rows(rows: Float64[Array, "data column"], count: int) -> Float64[Array, "row column"]:
    """The rows, and zeros for those of the prior."""
    return np.concatenate([rows, np.zeros((count, rows.shape[1]))])


def at_reference_time(
    measured: Measurements, planes: LaserPlanes, prior: Prior
) -> tuple[Measurements, RingArcs | None]:
    """The measurements with t_0 the mean of their stamps, weighted by the information on the ring's position.

    At this time pose and rates are least correlated (ringpose-method(7), section 8). Also the initial guess of the
    ring, None if there is none.
    """
    stamp_s, observations = measured.stamp_s, measured.observations(planes)
    arcs = initial_guess(measured, observations, prior)
    first = float(stamp_s.min(initial=np.inf))
    if arcs is None or not 0.0 < float(stamp_s.max()) - first < np.inf:  # of a single instant, or unknown
        return measured, arcs
    residuals = ring_residuals(arcs, measured, observations, Prior())
    rows = residuals.jacobian[: len(stamp_s)] @ motion_derivatives(arcs, arcs, 1.0)[:, PARAMETERS : PARAMETERS + 3]
    weight = (rows * rows).sum(axis=1)
    if not 0.0 < float(weight.sum()) < np.inf:
        return measured, arcs
    moved = replace(measured, reference_s=first + float(weight @ (stamp_s - first) / weight.sum()))
    covered = measured.camera is None or moved.observations(planes).view.camera is not None  # by the robot's poses
    return (moved if covered else measured), arcs


def _ordinate_scale(
    points: Points, slope: Float64[Array, "point"], distance_wrt_x: Float64[Array, "point"]
) -> OrdinateScale:
    """Weights of the ordinates of points without a line.

    The height above the predicted line is correlated with the error of the abscissa, which residual b uses; the
    remainder after regression on the abscissa (`share`) is independent of it and has the standard deviation 1 / scale.
    """
    which = np.flatnonzero(points.isolated)
    if not len(which):
        return OrdinateScale(which, np.empty(0), np.empty(0))
    covariance, slope = points.covariance[which], slope[which]
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    cross_covariance = xy - slope * xx
    remainder = yy - 2.0 * slope * xy + slope**2 * xx - cross_covariance**2 / xx
    scale = 1.0 / np.sqrt(np.maximum(remainder, 1e-12 * xx))
    return OrdinateScale(which, cross_covariance / xx / distance_wrt_x[which], scale)


def _prior_residuals(arcs: RingArcs, prior: Prior) -> tuple[Float64[Array, "row"], Float64[Array, "row step=7"]]:
    """Residuals d: each row is a value and its nonzero derivatives by component of the step."""
    rows: list[tuple[float, dict[int, float]]] = []
    if prior.radii is not None:
        for sign, radius_m, assumed_m, sd_m in zip(
            EDGE_SIGN, arcs.radius_m.tolist(), prior.radii.radius_m.tolist(), prior.radii.sd_m.tolist(), strict=True
        ):
            if assumed_m == assumed_m:
                derivatives = {CURVATURE: -(arcs.mean_radius_m**2) / sd_m, HALF_BAND: sign / sd_m}
                rows.append(((radius_m - assumed_m) / sd_m, derivatives))
    if prior.regularize_about is not None:
        inward, along, normal = arcs.axes
        rows += [
            ((arcs.curvature - EXPECTED_CURVATURE) / CURVATURE_SD, {CURVATURE: 1.0 / CURVATURE_SD}),
            (float(inward @ prior.regularize_about.axes[1]) / TURN_SD_RAD, {TURN: 1.0 / TURN_SD_RAD}),
        ]
        for axis in range(2):
            derivatives = {TILT_INWARD: inward[axis] / TILT_SD_RAD, TILT_ALONG: along[axis] / TILT_SD_RAD}
            rows.append((float(normal[axis]) / TILT_SD_RAD, derivatives))
    if prior.single_edge:
        rows.append(((arcs.half_band_m - EXPECTED_HALF_BAND_M) / HALF_BAND_SD_M, {HALF_BAND: 1.0 / HALF_BAND_SD_M}))
    jacobian = np.zeros((len(rows), PARAMETERS))
    for row, (_, derivatives) in zip(jacobian, rows, strict=True):
        row[list(derivatives)] = list(derivatives.values())
    return np.array([value for value, _ in rows], dtype=np.float64), jacobian
