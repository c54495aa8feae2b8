"""Maximum-likelihood ring by Gauss-Newton (ringpose-method(7), section 5).

The residuals are evaluated here, in the order of `ringpose.estimate.residuals`. Huber weights bring the iteration near
the solution; from there on visible edge points count fully or not at all, and break points fully: outliers among them
are judged by `ringpose.estimate.explanation`.
"""

from functools import partial
from math import inf, isfinite, sqrt

import numpy as np

from ringpose.estimate.measurements import Measurements, Observations
from ringpose.estimate.nuisance import FORM_ORDERS, FORM_PARAMETERS, FORM_SHARE, RigErrors, covariance_root, rig_errors
from ringpose.estimate.residuals import (
    CURVATURE_SD,
    DECISION_SIGMAS,
    EXPECTED_CURVATURE,
    EXPECTED_HALF_BAND_M,
    HALF_BAND_SD_M,
    NO_ORDINATES,
    PARAMETERS,
    RIDGE_MATRIX,
    STILL,
    TILT_SD_RAD,
    TURN_SD_RAD,
    Estimate,
    FixedColumns,
    Prior,
    Residuals,
    ordinate_scale,
)
from ringpose.geometry.ring import (
    CURVATURE,
    EDGE_SIGN,
    GENERATORS,
    HALF_BAND,
    LIFT,
    MIN_RATE,
    TILT_ALONG,
    TILT_INWARD,
    TINY,
    TURN,
    EdgeDistances,
    MovingRing,
    Rates,
    RingArcs,
    edge_distances,
    polar_angles,
    predicted_view,
)
from ringpose.types.arrays import Array, Float64
from ringpose.types.detection import JudgedRing
from ringpose.types.plausible import RING_RADIUS_M

HUBER_SIGMAS = 3.0
"""Residual of a break point or visible edge point from which it counts linearly while the iteration approaches."""

OUTLIER_SIGMAS = 3.5
"""Visible edge points with a larger residual near the solution are rejected: one in two thousand by chance."""

MAX_ITERATIONS = 20

MIN_RATIO, MAX_EXTRAPOLATED = 0.005, 0.5
"""Smallest ratio of successive steps that is relied on, and the largest one from which their sum is extrapolated."""

NEAR_SIGMAS = 0.1
"""Length of a step, in standard deviations, below which the robust phase ends."""

PRECISE_SIGMAS = 5e-9
"""Estimated distance from the optimum, in standard deviations, at which the iteration of a pose ends: the measurement
of a record and its priors give it to a nanometre."""

HOPELESS = 1e4
"""Factor on the limits of `poorly_determined` beyond which an iteration that starts without weak priors ends."""

STRIPES_OF_A_PLANE = 2
"""With fewer stripes the tilt about the stripe is determined by the edges only."""

MIN_DEPTH_M, MAX_DEPTH_M = 1e-3, 1e3
"""Bounds of the plane's distance; beyond them the iteration has diverged."""

MAX_CURVATURE = 1 / RING_RADIUS_M.lowest
"""Bound in 1/m, of the smallest ring that a file may state; beyond it the iteration has diverged."""

MAX_TILT_RAD = 0.7
"""Largest tilt in one iteration."""


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
            if estimate is not None and not poorly_determined(estimate.inverse):
                return estimate
            start = None
        if guess is None and start is None:
            guess = initial_guess(observations, prior)
        first: RingArcs | Estimate | None = guess if start is None else start
        edges_needed = start is None and len(measured.edges.edge) and len(measured.stripes) < STRIPES_OF_A_PLANE
        if guess is not None and edges_needed:
            regularized = solve(guess, prior._replace(regularize_about=guess), NEAR_SIGMAS)
            first = guess if regularized is None else regularized.arcs
        if first is None:
            return None
        estimate = solve(first, prior, tolerance_sigmas)
        if estimate is None or poorly_determined(estimate.inverse):
            guess = initial_guess(observations, prior) if guess is None else guess
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
    """The ring by an iteration from `start`; None if that diverges."""
    try:
        return _gauss_newton(_linearize(start, observations, prior), observations, prior, tolerance_sigmas)
    except np.linalg.LinAlgError:
        return None


def precise_ring(estimate: Estimate, measured: Measurements) -> Estimate | None:
    """The estimate, iterated further to the precision of a pose; None if the iteration diverges."""
    observations, residuals = measured.observations, estimate.residuals
    try:
        fixed = fixed_columns(residuals, observations, estimate.prior)
        return _gauss_newton((residuals, fixed, estimate.remaining), observations, estimate.prior, PRECISE_SIGMAS)
    except np.linalg.LinAlgError:
        return None


def _gauss_newton(
    linearized: tuple[Residuals, FixedColumns | None, Float64[Array, "row"]],
    observations: Observations,
    prior: Prior,
    tolerance_sigmas: float,
) -> Estimate:
    """Iteratively reweighted Gauss-Newton from `_linearize`; LinAlgError if it diverges.

    Derivatives with respect to common errors, if not given, are evaluated after the first step; they hardly change
    later.
    """
    residuals, fixed, predicted = linearized
    nuisance, count, robust, steps = nuisance_columns(residuals, fixed), len(residuals.rate_sds), None, _Steps()
    for iteration in range(MAX_ITERATIONS):
        if iteration == 1 and fixed is None:
            fixed = fixed_columns(residuals, observations, prior)
            nuisance = nuisance_columns(residuals, fixed)
        # weights from the residuals that the last step predicts: before it, outliers hide among large residuals
        if robust is None:
            weights = _robust_weights(predicted, residuals)
        normal_matrix, step, nuisance_step = solve_normal_equations(residuals, weights, nuisance)
        predicted = residuals.residual + residuals.jacobian @ step + nuisance @ nuisance_step
        factor = steps.factor(step, normal_matrix, extrapolate=robust is not None)
        arcs, rates = retract_ring(residuals, factor * step, factor * nuisance_step[:count])
        residuals = ring_residuals(arcs, observations, prior, rates)
        nuisance = nuisance_columns(residuals, fixed)
        if robust is None and fixed is not None and steps.sigmas < NEAR_SIGMAS:
            robust, weights = weights, _inlier_weights(predicted, residuals)
            if not np.array_equal(weights, robust):
                continue
        if robust is not None and steps.distance_sigmas < tolerance_sigmas:
            break
    assert fixed is not None
    nuisance_step[:count] = 0.0
    remaining = residuals.residual + nuisance @ nuisance_step
    squares = np.minimum(remaining**2, 1e6)
    squares[residuals.stripe_rows : residuals.data_rows] = 0.0
    numbers = observations.stripe_numbers + len(remaining) - residuals.data_rows
    common = np.concatenate([nuisance_step[: len(nuisance_step) - fixed.edge_errors], residuals.rate_deviations])
    return Estimate(
        residuals=residuals,
        arcs=residuals.arcs,
        rates=residuals.rates,
        weights=weights,
        fixed=fixed,
        nuisance=nuisance,
        nuisance_step=nuisance_step,
        normal_matrix=normal_matrix,
        inverse=_inverse(normal_matrix),
        prior=prior,
        remaining=remaining,
        chi2=float(squares.sum()) + float(common @ common),
        numbers=numbers,
        degrees_of_freedom=max(numbers - PARAMETERS, 0),
        distance_sigmas=steps.distance_sigmas,
        converged=steps.distance_sigmas < DECISION_SIGMAS,
        edge_residuals=remaining[residuals.stripe_rows : residuals.data_rows],
    )


def _linearize(
    start: RingArcs | MovingRing | Estimate, observations: Observations, prior: Prior
) -> tuple[Residuals, FixedColumns | None, Float64[Array, "row"]]:
    """The residuals at `start`, the fixed columns (None for a mere guess), and the residuals after common errors.

    If `start` is an estimate, the part of the residuals that its common errors explain is subtracted in the third
    result. LinAlgError if parameters are so far from being determined that the iteration is useless without weak
    priors.
    """
    fixed: FixedColumns | None = None
    if isinstance(start, RingArcs):
        residuals = ring_residuals(start, observations, prior)
    else:
        residuals = ring_residuals(start.arcs, observations, prior, start.rates)
        fixed = fixed_columns(residuals, observations, prior)
    predicted = residuals.residual
    if isinstance(start, Estimate) and fixed is not None:
        nuisance = nuisance_columns(residuals, fixed)
        if nuisance.shape[1] == len(start.nuisance_step):
            predicted = residuals.residual + nuisance @ start.nuisance_step
    if prior.regularize_about is None:
        inverse = np.linalg.inv(residuals.jacobian.T @ residuals.jacobian + RIDGE_MATRIX)
        if poorly_determined(inverse, HOPELESS):
            raise np.linalg.LinAlgError("parameters are not determined")
    return residuals, fixed, predicted


class _Steps:
    """Convergence of an iteration; all lengths are Mahalanobis lengths."""

    def __init__(self) -> None:
        self.sigmas = self.distance_sigmas = inf
        """Length of the last step, and estimated distance from the optimum after it."""
        self._last: Float64[Array, "7"] | None = None
        self._ratio = 0.0

    def factor(self, step: Float64[Array, "7"], normal_matrix: Float64[Array, "7 7"], *, extrapolate: bool) -> float:
        """The factor by which a step is multiplied.

        Near the solution each step is the same multiple q of the previous one, because second derivatives are
        neglected: the sum of this step and all following ones is step / (1 - q) (Aitken's method).
        """
        sigmas, last_sigmas = sqrt(max(float(step @ normal_matrix @ step), 0.0)), self.sigmas
        # after a long step, or one that was extrapolated, a step is shorter than the next ones show
        shrinkage = sigmas / max(last_sigmas, TINY) if isfinite(last_sigmas) else 1.0
        self.sigmas, self.distance_sigmas = sigmas, sigmas * min(max(shrinkage, self._ratio, MIN_RATIO), 1.0)
        last, self._last, self._ratio = self._last, step, 0.0
        if last is None or not extrapolate or not 0.0 < sigmas < MAX_EXTRAPOLATED * last_sigmas:
            return 1.0
        ratio = float(last @ normal_matrix @ step) / max(last_sigmas**2, TINY)
        if not abs(ratio) < MAX_EXTRAPOLATED:
            return 1.0
        self._last, self._ratio = None, abs(ratio)
        return 1.0 / (1.0 - ratio)


def nuisance_columns(residuals: Residuals, fixed: FixedColumns | None) -> Float64[Array, "row error"]:
    """Matrix B: derivatives with respect to the rates, then the other common errors, in sigmas of their priors."""
    wrt_rates = residuals.wrt_rates * residuals.rate_sds
    return wrt_rates if fixed is None else np.concatenate([wrt_rates, fixed.columns], axis=1)


def refine_ring(
    measured: Measurements, prior: Prior, arcs: RingArcs, iterations: int
) -> tuple[RingArcs, Float64[Array, "step=7 step=7"]] | None:
    """A ring near `arcs` after some iterations, and the covariance of its step; None if it diverges.

    For the edge search: many visible edge points may be outliers, so that these have the redescending weights of Geman
    and McClure's loss (Statistical Methods for Tomographic Image Reconstruction, 1987), (1 + (r / s)^2)^-2.
    """
    observations = measured.observations
    rates, fixed, normal_matrix = STILL, None, np.zeros((PARAMETERS, PARAMETERS))
    try:
        for _ in range(iterations):
            residuals = ring_residuals(arcs, observations, prior, rates)
            fixed = fixed_columns(residuals, observations, prior) if fixed is None else fixed
            robust = slice(residuals.ends, residuals.data_rows)
            weights = np.ones(len(residuals.residual))
            weights[robust] = (1.0 + (residuals.residual[robust] / HUBER_SIGMAS) ** 2) ** -2
            normal_matrix, step, nuisance_step = solve_normal_equations(
                residuals, weights, nuisance_columns(residuals, fixed)
            )
            arcs, rates = retract_ring(residuals, step, nuisance_step[: len(residuals.rate_sds)])
        return arcs, _inverse(normal_matrix)
    except np.linalg.LinAlgError:
        return None


def _inverse(normal_matrix: Float64[Array, "7 7"]) -> Float64[Array, "7 7"]:
    """The covariance; LinAlgError if the matrix is singular: rounding may leave variances that are not positive."""
    inverse = np.linalg.inv(normal_matrix + RIDGE_MATRIX)
    if not bool((inverse.diagonal() > 0).all()):
        raise np.linalg.LinAlgError("the normal matrix is singular")
    return inverse


def solve_normal_equations(
    residuals: Residuals, weights: Float64[Array, "row"], nuisance: Float64[Array, "row error"]
) -> tuple[Float64[Array, "7 7"], Float64[Array, "7"], Float64[Array, "error"]]:
    """The normal matrix with the common errors marginalised, the ring's step, and the step of the common errors.

    With residuals r, Jacobian J, weights W and the derivatives B with respect to the common errors (unit variance),
    the Schur complement of [J B]^T W [J B] + diag(0, 1): S = J^T W J - J^T W B (1 + B^T W B)^-1 B^T W J, and
    S step = -(J^T W r - J^T W B (1 + B^T W B)^-1 (B^T W r + q)), Eq. (5.9). The residuals contain the common errors q
    that are estimated already, the rates, which come first; the others are 0 there.
    """
    columns = np.concatenate([residuals.system, nuisance], axis=1)  # [r J B]
    products = (columns.T * weights) @ columns
    products.ravel()[(1 + PARAMETERS) * (len(products) + 1) :: len(products) + 1] += 1.0
    reduced, cross_information = products[1 : 1 + PARAMETERS, : 1 + PARAMETERS], products[1 + PARAMETERS :]
    cross_information[: len(residuals.rate_deviations), 0] += residuals.rate_deviations
    solution = cross_information[:, : 1 + PARAMETERS]
    if len(solution):
        solution = np.linalg.solve(cross_information[:, 1 + PARAMETERS :], solution)
        reduced = reduced - cross_information[:, 1 : 1 + PARAMETERS].T @ solution
    step = -np.linalg.solve(reduced[:, 1:] + RIDGE_MATRIX, reduced[:, 0])
    return reduced[:, 1:], step, -solution[:, 0] - solution[:, 1:] @ step


def _robust_weights(residual: Float64[Array, "row"], residuals: Residuals) -> Float64[Array, "row"]:
    """Huber weights of break points and visible edges; 1 for lines, which are robust fits, and for the prior."""
    robust = slice(residuals.ends, residuals.data_rows)
    weights = np.ones(len(residual))
    weights[robust] = HUBER_SIGMAS / np.maximum(np.abs(residual[robust]), HUBER_SIGMAS)
    return weights


def _inlier_weights(residual: Float64[Array, "row"], residuals: Residuals) -> Float64[Array, "row"]:
    """0 for the visible edge points that are outliers, 1 for everything else."""
    weights = np.ones(len(residual))
    edges = slice(residuals.stripe_rows, residuals.data_rows)
    weights[edges] = np.abs(residual[edges]) < OUTLIER_SIGMAS
    return weights


def poorly_determined(covariance: Float64[Array, "7 7"], factor: float = 1.0) -> bool:
    """Whether tilt or in-plane rotation are left to more than 0.5 rad, or curvature to more than 1/m (sigmas).

    The weak priors of `ring_residuals` have about these standard deviations. `factor` multiplies the variances.
    """
    variance = covariance.diagonal().tolist()
    return bool(max(variance[TILT_INWARD], variance[TILT_ALONG], variance[TURN]) > 0.25 * factor) or bool(
        variance[CURVATURE] > factor
    )


# Initial guess

MIN_LENGTH_M = 1e-9
"""A shorter vector has no direction."""


def initial_guess(observations: Observations, prior: Prior) -> RingArcs | None:
    """The plane of the stripes, and a ring of typical size on it; None if the plane is not in front of the camera.

    The origin lies on the middle of the face, on the mean ray of the break points.
    """
    measured, view = observations.measured, observations.view
    if not len(measured.points.x):
        return None
    try:
        plane = _plane_of_stripes(observations)
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
    described = observations.described
    points_m = depth_m[:, None] * rays
    # dP/dx of the break points along their stripes, for P = depth r
    points_wrt_x = depth_m[:, None] * np.column_stack([np.ones_like(slope), slope, np.zeros_like(slope)])
    points_wrt_x -= (depth_m * (plane[0] + slope * plane[1]))[:, None] * points_m

    normal = -plane / float(np.sqrt(plane @ plane))
    across = (normal @ GENERATORS).reshape(3, 3)  # across @ v is the cross product of the normal and v
    outward = _outward_direction(normal, across, observations, points_m, points_wrt_x)
    mean_ray = rays[described].mean(axis=0)
    origin = mean_ray / float(mean_ray @ plane)
    curvature, half_band_m = _expected_size(observations, points_m @ outward, prior)
    if not described.all():  # a circle through the origin, with its centre inward, and the mean point of the other arc
        chord_m = points_m[~described].mean(axis=0) - origin
        curvature = -2.0 * float(chord_m @ outward) / max(float(chord_m @ chord_m), MIN_LENGTH_M**2)
    return RingArcs(
        origin=origin,
        axes=np.array([-outward, across @ -outward, normal]),
        curvature=curvature,
        half_band_m=half_band_m,
    )


def _plane_of_stripes(observations: Observations) -> Float64[Array, "3"]:
    """The plane q that fits the stripes: (m . r - d q . r) / (m - d q)_y = 0, linear in q for a fixed denominator."""
    measured, view = observations.measured, observations.view
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
    observations: Observations,
    points_m: Float64[Array, "point 3"],
    points_wrt_x: Float64[Array, "point 3"],
) -> Float64[Array, "3"]:
    """Mean direction from inner towards outer ends, seen from the middles of their stripes."""
    points, described = observations.measured.points, observations.described
    first, last = np.flatnonzero(described)[[0, -1]].tolist()
    direction = ((2.0 * points.edge - 1.0) * (points.x - points.middle_x) * described) @ points_wrt_x
    if float(direction @ direction) < MIN_LENGTH_M**2:  # no stripe has a length: across the row of break points
        direction = across @ (points_m[last] - points_m[first])
    if float(direction @ direction) < MIN_LENGTH_M**2:  # a single point: along its stripe
        direction = points_wrt_x[first]
    direction = direction - (direction @ normal) * normal
    unit: Float64[Array, "3"] = direction / np.sqrt(direction @ direction)
    return unit


def _expected_size(observations: Observations, outward_m: Float64[Array, "point"], prior: Prior) -> tuple[float, float]:
    """Curvature (1/m) of the ring and half the width (m) of its face.

    Both follow from the prior of the radii where it gives them. Otherwise the curvature is that of a typical ring, and
    the width is the mean distance between the inner and the outer break points, at `outward_m` in radial direction.
    """
    edges, described = observations.measured.points.edge, observations.described
    inner, outer = (outward_m[described & (edges == edge)].tolist() for edge in range(2))
    half_band_m = 0.5 * (sum(outer) / len(outer) - sum(inner) / len(inner)) if inner and outer else EXPECTED_HALF_BAND_M
    if prior.radii is None or not np.isfinite(prior.radii.radius_m).any():
        return EXPECTED_CURVATURE, half_band_m
    inner_m, outer_m = prior.radii.radius_m.tolist()
    both_known = np.isfinite(outer_m - inner_m)
    return 1.0 / float(np.nanmean(prior.radii.radius_m)), 0.5 * (outer_m - inner_m) if both_known else half_band_m


# Residuals


def ring_residuals(arcs: RingArcs, observations: Observations, prior: Prior, rates: Rates = STILL) -> Residuals:
    """The residuals of a ring at the reference time.

    With a prior of the motion, every residual is evaluated for the ring at the time of its own frame.
    """
    measured, view = observations.measured, observations.view
    motion = prior.assumptions.motion if measured.moving else None
    sds = np.zeros(0) if motion is None else np.array([motion.speed_sd_m_s] * 3 + [motion.rate_sd_rad_s] * 2)
    rates = rates if len(sds) else STILL
    stripes, every_edge = predicted_view(arcs, view, rates if len(sds) else None)
    ends, samples, visible = view.ends, len(view.rays), len(view.visible_rays)
    points = EdgeDistances(*(each[: samples - ends] for each in every_edge))
    edges = EdgeDistances(*(each[samples - ends :] for each in every_edge))
    stripe_rows = samples + observations.isolated
    data_rows = stripe_rows + visible
    of_prior = _prior_rows(arcs, prior)
    rows = np.zeros((data_rows + len(of_prior), 1 + stripes.y_wrt_step.shape[1]))

    # a: whitened distances of the lines' ends from the predicted lines
    above = view.rays[:, 1] - stripes.rays[:, 1]
    lines = np.concatenate([above[:, None], -stripes.y_wrt_step], axis=1)
    rows[:ends] = observations.whitening @ lines[:ends]

    # b: distances of the break points from their edges, along the predicted lines
    lines, slope = lines[ends:], stripes.slope[ends:]
    along = np.concatenate([points.distance_m[:, None], points.wrt_step], axis=1)
    along[:, 1:] -= points.wrt_ray[:, 1:] * lines[:, 1:]  # the point moves with its line
    distance_wrt_x = points.wrt_ray[:, 0] + slope * points.wrt_ray[:, 1]
    distance_wrt_x = np.where(np.abs(distance_wrt_x) < MIN_RATE, MIN_RATE, distance_wrt_x)
    scale = 1.0 / (np.abs(distance_wrt_x) * measured.points.sigma_x)
    rows[ends:samples] = scale[:, None] * along

    ordinates = NO_ORDINATES
    if observations.isolated:
        ordinates = which, share, scale_y = ordinate_scale(measured.points, slope, distance_wrt_x)
        rows[samples:stripe_rows] = scale_y[:, None] * (lines[which] - share[:, None] * along[which])

    # c: distances of the visible edge points from their edges, along the edges' normals in the image
    edge_scale = 1.0 / np.maximum(np.abs((edges.wrt_ray * measured.edges.step).sum(axis=1)), TINY)
    if visible:
        rows[stripe_rows:data_rows, 0] = edge_scale * edges.distance_m
        rows[stripe_rows:data_rows, 1:] = edge_scale[:, None] * edges.wrt_step

    rows[data_rows:, : 1 + PARAMETERS] = of_prior  # d
    return Residuals(
        arcs=arcs,
        rates=rates,
        rate_sds=sds,
        rate_deviations=np.divide(rates_along(arcs, rates), sds, out=np.zeros(5), where=sds > 0) if len(sds) else sds,
        system=rows[:, : 1 + PARAMETERS],
        residual=rows[:, 0],
        jacobian=rows[:, 1 : 1 + PARAMETERS],
        wrt_rates=rows[:, 1 + PARAMETERS : 1 + PARAMETERS + len(sds)],
        wrt_camera=rows[:, 1 + PARAMETERS + len(sds) :],
        ends=ends,
        stripe_rows=stripe_rows,
        data_rows=data_rows,
        stripes=stripes,
        points=points,
        edges=edges,
        edge_scale=edge_scale,
        distance_wrt_x=distance_wrt_x,
        distance_scale=scale,
        ordinates=ordinates,
        described=observations.described,
    )


def rates_along(arcs: RingArcs, rates: Rates) -> Float64[Array, "rate=5"]:
    """The velocity, and the angular velocities about the inward axis and about the axis along the face."""
    return np.concatenate([rates.velocity_m_s, arcs.axes[:2] @ rates.rate_rad_s])


def _prior_rows(arcs: RingArcs, prior: Prior) -> Float64[Array, "row 8"]:
    """Residuals d and their derivatives by the step; `rows` holds each value with its nonzero derivatives."""
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
    found = np.zeros((len(rows), 1 + PARAMETERS))
    for row, (value, derivatives) in zip(found, rows, strict=True):
        row[0], row[1:][list(derivatives)] = value, list(derivatives.values())
    return found


def retract_ring(
    residuals: Residuals, step: Float64[Array, "step=7"], rate_step: Float64[Array, "rate"]
) -> tuple[RingArcs, Rates]:
    """The ring and its rates after one step; `rate_step` is in standard deviations of the rates' prior.

    A step longer than `MAX_TILT_RAD` is shortened as a whole. LinAlgError if the ring is then not in front of the
    camera, or has an impossible size. The angular velocity stays across the normal.
    """
    arcs, rates = residuals.arcs, residuals.rates
    largest = max(map(abs, step[[TILT_INWARD, TILT_ALONG, TURN]].tolist()))
    moved = arcs.retract(step * (MAX_TILT_RAD / largest) if largest > MAX_TILT_RAD else step)
    depth_m = -float(arcs.axes[2] @ moved.origin)
    possible = MIN_DEPTH_M < depth_m < MAX_DEPTH_M and abs(moved.curvature) < MAX_CURVATURE
    if not (possible and all(map(isfinite, step.tolist()))):
        raise np.linalg.LinAlgError("the iteration diverges")
    if len(rate_step):
        along = rates_along(arcs, rates) + rate_step * residuals.rate_sds
        rates = Rates(along[:3], along[3:] @ moved.axes[:2])
    return moved, rates


# Common errors, whose derivatives are evaluated once, near the solution

ROUNDED_M, ROUNDED_TOLERANCES = 5e-4, 5.0
"""Standard deviation of the displacement of a visible edge by a chamfer or rounding, and its limit as a multiple of the
ring's tolerance: machined edges are broken by up to half a millimetre, those of a perfect ring are sharp."""

WALL_SD_M = 0.03
"""Standard deviation of the depth of a wall's foot below the face: interface rings are 10 to 60 mm high."""


def fixed_columns(residuals: Residuals, observations: Observations, prior: Prior) -> FixedColumns:
    """Derivatives of the residuals with respect to the errors of rig, form, mount and visible edges."""
    measured = observations.measured
    wrt_rig, form, slope, columns = None, None, None, [np.zeros((len(residuals.residual), 0))]
    mean_ray = np.zeros((2, 0))
    errors = rig_errors(measured.rig, prior.assumptions.stability)
    if errors is not None:
        wrt_rig, mean_ray = rig_jacobian(residuals, observations, errors)
        mean_ray = mean_ray @ errors.root
        columns.append(wrt_rig @ errors.root)
    if prior.assumptions.ring_tolerance_m > 0.0:
        form = form_jacobian(residuals, observations)
        columns.append(FORM_SHARE * prior.assumptions.ring_tolerance_m * form)
    if prior.assumptions.face_slope_rad > 0.0:
        slope = slope_jacobian(residuals, observations)
        columns.append(prior.assumptions.face_slope_rad * slope[:, None])
    if residuals.wrt_camera.shape[1] and measured.camera is not None:
        variance = measured.camera.mount.covariance
        uncertain = np.diag(variance) > 0
        columns.append(residuals.wrt_camera @ covariance_root(variance[np.ix_(uncertain, uncertain)]))
    columns.append(edge_jacobian(residuals, observations, prior))
    return FixedColumns(
        wrt_rig, form, slope, residuals.wrt_camera, mean_ray, np.concatenate(columns, axis=1), columns[-1].shape[1]
    )


def rig_jacobian(
    residuals: Residuals, observations: Observations, errors: RigErrors
) -> tuple[Float64[Array, "row parameter"], Float64[Array, "xy=2 parameter"]]:
    """Derivatives of the residuals, and of the mean of the predicted break points for a fixed ring.

    Errors of the camera move the rays of fixed pixels, errors of a light plane move the predicted stripe. The abscissae
    of predicted points are those of the measured pixels, their ordinates those of the predicted stripes.
    """
    ends, stripes, laser, wrt_camera = residuals.ends, residuals.stripes, observations.laser, observations.wrt_camera
    rays = (wrt_camera.reshape(-1, len(errors.camera)) @ errors.camera).reshape(
        len(wrt_camera), 2, len(errors.parameters)
    )
    ray, edge_ray = rays[: len(laser)], rays[len(laser) :]
    # m . r = d / depth: the cosine by the tilts is e1 . r and e2 . r, and the distance acts like a cosine of -1 / depth
    cosine_wrt_tilts = (errors.basis[laser] @ stripes.rays[:, :, None])[:, :, 0]
    y_wrt_plane = stripes.y_wrt_cosine[:, None] * np.column_stack([cosine_wrt_tilts, -1.0 / stripes.depth])
    predicted_y = (y_wrt_plane[:, None] @ errors.lasers[laser])[:, 0]
    sloped = stripes.slope[:, None] * ray[:, 0]
    above = ray[:, 1] - sloped - predicted_y
    distance = residuals.points.wrt_ray[:, 1:] * predicted_y[ends:] + residuals.distance_wrt_x[:, None] * ray[ends:, 0]
    blocks = [observations.whitening @ above[:ends], residuals.distance_scale[:, None] * distance]
    which, share, scale = residuals.ordinates
    if len(which):
        blocks.append(scale[:, None] * (above[ends:][which] - share[:, None] * distance[which]))
    if len(edge_ray):
        wrt_ray = residuals.edge_scale[:, None] * residuals.edges.wrt_ray
        blocks.append((wrt_ray[:, :, None] * edge_ray).sum(axis=1))
    blocks.append(np.zeros((len(residuals.residual) - residuals.data_rows, len(errors.parameters))))
    described = observations.described
    mean_ray = np.array([of[ends:][described].mean(axis=0) for of in (ray[:, 0], predicted_y + sloped)])
    return np.concatenate(blocks), mean_ray


def form_jacobian(residuals: Residuals, observations: Observations) -> Float64[Array, "row amplitude=18"]:
    """Derivatives of the residuals with respect to the amplitudes of the ring's form (`FORM_PARAMETERS`), Eq. (12.1).

    An axial deviation acts like an offset of the plane, a radial one like a change of its edge's radius, both at the
    angle of the row.
    """
    points, edges = observations.measured.points, observations.measured.edges
    ends, data_rows, rays = residuals.ends, residuals.data_rows, residuals.stripes.rays
    angle = polar_angles(residuals.arcs, np.concatenate([rays, rays[ends:][points.isolated], edges.ray]))
    of_edge = np.concatenate([np.full(ends, -1), points.edge, points.edge[points.isolated], edges.edge])
    phase = angle[:, None] * FORM_ORDERS
    shape = np.stack([np.cos(phase), np.sin(phase)], axis=-1).reshape(len(angle), -1)
    # the increment HALF_BAND moves the outer edge outward, the inner one inward
    outward = residuals.jacobian[:data_rows, HALF_BAND, None] * EDGE_SIGN * (of_edge[:, None] == range(len(EDGE_SIGN)))
    axial = np.concatenate([-residuals.stripes.y_wrt_step[:ends, LIFT], residuals.jacobian[ends:data_rows, LIFT]])
    deviation = np.concatenate([outward, axial[:, None]], axis=1)  # inner, outer, axial
    jacobian = np.zeros((len(residuals.residual), len(FORM_PARAMETERS)))
    jacobian[:data_rows] = (deviation[:, :, None] * shape[:, None]).reshape(data_rows, -1)
    jacobian[:ends] = observations.whitening @ jacobian[:ends]  # the two ends of a line are at different angles
    return jacobian


def slope_jacobian(residuals: Residuals, observations: Observations) -> Float64[Array, "row"]:
    """Derivatives of the residuals with respect to the slope of the face, Eq. (12.3).

    The face rises outwards by the slope times the distance from its middle, and acts there like an offset of the plane.
    """
    arcs, stripes, ends, data_rows = residuals.arcs, residuals.stripes, residuals.ends, residuals.data_rows
    points, edges = observations.measured.points, observations.measured.edges
    of_lines_m = edge_distances(arcs, stripes.rays[:ends], np.zeros(ends)).distance_m
    of_edges = np.concatenate([points.edge, points.edge[points.isolated], edges.edge])
    jacobian = np.zeros(len(residuals.residual))
    jacobian[:ends] = -observations.whitening @ (of_lines_m * stripes.y_wrt_step[:ends, LIFT])
    jacobian[ends:data_rows] = arcs.half_band_m * (2.0 * of_edges - 1.0) * residuals.jacobian[ends:data_rows, LIFT]
    return jacobian


def edge_jacobian(residuals: Residuals, observations: Observations, prior: Prior) -> Float64[Array, "row error"]:
    """Derivatives of the residuals with respect to the common errors of visible edges, in their standard deviations.

    A chamfer or a rounding reflects laser light and ambient light in different directions, so that the edge in ambient
    light lies beside the ends of the stripes by up to its width.

    What looks like an edge may be the foot of the ring's wall where the camera sees the wall and it is as bright as the
    face: the depth of the foot below the face is an error of each edge. Beside several stripes it mainly changes the
    curvature, as the wall's width in the image changes along the edge; a single one leaves the tilt about it to the
    edges, and a tilt has the same effect.
    """
    edges = observations.measured.edges
    rows = slice(residuals.data_rows - len(edges.edge), residuals.data_rows)
    columns = [edges.common] if len(edges.edge) else []
    rounded_m = min(ROUNDED_M, ROUNDED_TOLERANCES * prior.assumptions.ring_tolerance_m)
    if columns and rounded_m > 0.0:
        rounded = rounded_m * np.abs(residuals.jacobian[rows, HALF_BAND])
        columns.append(rounded[:, None] * (edges.edge[:, None] == range(len(EDGE_SIGN))))
    if columns and edges.walls:
        outward = residuals.edge_scale * residuals.edges.wrt_step[:, LIFT]
        of_edge = edges.edge[:, None] == range(len(EDGE_SIGN))
        wall_seen = of_edge & (outward[:, None] * EDGE_SIGN > 0.0)
        columns.append(WALL_SD_M * wall_seen * outward[:, None])
    jacobian = np.zeros((len(residuals.residual), sum(each.shape[1] for each in columns)))
    if columns:
        jacobian[rows] = np.concatenate(columns, axis=1)
    return jacobian
