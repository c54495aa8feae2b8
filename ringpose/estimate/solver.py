"""Gauss-Newton for a ring, with common errors eliminated (ringpose-method(7), section 5).

The iteration needs no more of the measurements than their rows (`ringpose.estimate.linearization`). Huber weights bring
it near the solution; from there on rows of which there are many count fully or not at all, and the others fully:
outliers among them are judged by `ringpose.estimate.explanation`.
"""

from math import inf, isfinite, sqrt
from typing import NamedTuple

import numpy as np

from ringpose.estimate.factors.points import Points
from ringpose.estimate.factors.prior import EXPECTED_CURVATURE, EXPECTED_HALF_BAND_M, Prior
from ringpose.estimate.linearization import (
    PARAMETERS,
    FixedColumns,
    LinearProblem,
    Observations,
    Residuals,
    retract_ring,
    ring_residuals,
)
from ringpose.estimate.measurements import Measurements
from ringpose.estimate.nuisance import common_errors
from ringpose.geometry.least_squares import huber_weights
from ringpose.geometry.ring import (
    CURVATURE,
    GENERATORS,
    STILL,
    TILT_ALONG,
    TILT_INWARD,
    TINY,
    TURN,
    MovingRing,
    RingArcs,
)
from ringpose.types.arrays import Array, Float64

ALARM_SIGMAS = 3.0
"""Limit of a test as a normal quantile: one right shot in seven hundred exceeds it by chance. From such a residual a
break point or visible edge point counts linearly while the iteration approaches."""

OUTLIER_SIGMAS = 3.5
"""Visible edge points with a larger residual near the solution are rejected: one in two thousand by chance."""

CERTAIN_SIGMAS = 4.5
"""Limit, as a normal quantile, for what each shot is asked and a wrong answer costs much, three in a million by chance:
the side of the centre, radii that contradict the assumed ones, one number that contradicts all others, a ghost that a
frame does not show by itself."""

UNKNOWN_FROM = 0.5
"""Relative standard deviation of the curvature from which the centre is not determined at all: the inverse of a
curvature that may be zero within two standard deviations has no finite error. The same for the normal, in radians: the
points then lie on a line within their errors. Long before, the lever of the radius makes the centre weak."""

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

RIDGE = 1e-7
"""Added to the diagonal of the normal matrix (m, rad, 1/m), so that undetermined parameters keep their values."""

RIDGE_MATRIX = RIDGE * np.eye(PARAMETERS)


def linearize(
    start: RingArcs | MovingRing,
    observations: Observations,
    prior: Prior,
    errors: Float64[Array, "error"] | None = None,
    hopeless: float = inf,
) -> LinearProblem:
    """The problem at a start; its derivatives by common errors are None for a ring that is a mere guess.

    `errors` are common errors that are known from an estimate nearby. LinAlgError if parameters are so far from being
    determined that an iteration is useless: `hopeless` times more than the limits of `poorly_determined`.
    """
    arcs, rates = (start, STILL) if isinstance(start, RingArcs) else start
    residuals = ring_residuals(arcs, observations, prior, rates)
    if poorly_determined(np.linalg.inv(residuals.jacobian.T @ residuals.jacobian + RIDGE_MATRIX), hopeless):
        raise np.linalg.LinAlgError("parameters are not determined")
    if isinstance(start, RingArcs):
        return LinearProblem(residuals, None, residuals.residual)
    return linearized_at(residuals, prior, errors)


def linearized_at(residuals: Residuals, prior: Prior, errors: Float64[Array, "error"] | None) -> LinearProblem:
    """The problem at a ring near the solution, with the derivatives there by common errors."""
    fixed, count = common_errors(residuals, prior), len(residuals.rate_sds)
    if errors is None or len(errors) != count + fixed.columns.shape[1]:
        return LinearProblem(residuals, fixed, residuals.residual)
    return LinearProblem(residuals, fixed, residuals.residual + fixed.columns @ errors[count:])


def poorly_determined(covariance: Float64[Array, "7 7"], factor: float = 1.0) -> bool:
    """Whether tilt or in-plane rotation are left to more than `UNKNOWN_FROM`, or curvature to more than 1/m (sigmas).

    The weak priors of `Prior.rows` have about these standard deviations. `factor` multiplies the variances.
    """
    variance = covariance.diagonal().tolist()
    return bool(max(variance[TILT_INWARD], variance[TILT_ALONG], variance[TURN]) > factor * UNKNOWN_FROM**2) or bool(
        variance[CURVATURE] > factor
    )


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
        weights: Float64[Array, "row"] = (1.0 + (residual / ALARM_SIGMAS) ** 2) ** -2
        return weights
    return huber_weights(predicted, ALARM_SIGMAS)


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


# The ring from which an iteration starts where no other is known


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
        curvature = -2.0 * float(chord_m @ outward) / max(float(chord_m @ chord_m), TINY)
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
    if float(direction @ direction) < TINY:  # no stripe has a length: across the row of break points
        direction = across @ (points_m[last] - points_m[first])
    if float(direction @ direction) < TINY:  # a single point: along its stripe
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
