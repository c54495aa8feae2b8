"""Maximum-likelihood ring by Gauss-Newton with Huber weights (ringpose-method(7), section 5).

The paper's closed form is not needed as a start: on the plane the inverse depth is linear in the image, so the lines
give the plane at once, and in the state of `residuals` every ring is within a few steps of its estimate.
"""

from functools import partial
from math import hypot, isfinite
from typing import NamedTuple

import numpy as np

from ringpose.estimate.measurements import Measurements, Observations
from ringpose.estimate.nuisance import NuisanceJacobian, RigErrors, nuisance_jacobian
from ringpose.estimate.residuals import (
    CURVATURE,
    EXPECTED_BAND_M,
    EXPECTED_CURVATURE,
    PARAMETERS,
    TURN,
    Prior,
    Residuals,
    RingState,
    cross,
    predict_stripes,
    ring_residuals,
)
from ringpose.geometry.robust import huber_weights
from ringpose.types.arrays import Array, Float64
from ringpose.types.rig import Rig

HUBER_SIGMAS = 3.0
"""Beyond it the residuals of break points and visible edges count linearly; 0.3 % of Gaussian ones are beyond."""

MAX_ITERATIONS = 15

MIN_STEP_SIGMAS = 1e-4
"""The iteration has converged when a step is shorter than this, in standard deviations."""

STRIPES_OF_A_PLANE = 2
"""With fewer stripes the tilt about the stripe is determined by the edges only."""

RIDGE = 1e-7
"""Added to the diagonal of the normal matrix (m, rad, 1/m), so that undetermined parameters keep their values."""

_RIDGE = RIDGE * np.eye(PARAMETERS)

MIN_DEPTH_M, MAX_DEPTH_M = 1e-3, 1e3
"""Bounds of the plane's distance; beyond them the iteration has diverged."""

MAX_CURVATURE = 20.0
"""Bound in 1/m; beyond it the iteration has diverged."""

MIN_LENGTH_M = 1e-9
"""A shorter vector has no direction."""


class Estimate(NamedTuple):
    """A maximum-likelihood ring, and the linearised problem at the solution."""

    state: RingState
    residuals: Residuals
    weights: Float64[Array, "row"]
    """Of the robust loss: 1 for a residual within `HUBER_SIGMAS`."""
    nuisance: NuisanceJacobian | None
    """None without common errors."""
    nuisance_step: Float64[Array, "error"] | None
    """The estimated common errors, in their standard deviations; the rig's come first."""
    regularized: bool
    """Whether parameters that the shot leaves open were held by weak priors."""
    normal_matrix: Float64[Array, "7 7"]
    """Inverse covariance of the state if no residual exceeds the robust limit; common errors are marginalised."""
    inverse: Float64[Array, "7 7"]
    """Of the normal matrix with `RIDGE`."""

    @property
    def remaining(self) -> Float64[Array, "row"]:
        """Residuals at the estimated ring less those that the estimated rig and edge errors explain, in sigmas."""
        if self.nuisance is None or self.nuisance_step is None:
            return self.residuals.residual
        remaining: Float64[Array, "row"] = self.residuals.residual + self.nuisance.residual @ self.nuisance_step
        return remaining


def estimate_ring(measured: Measurements, rig: Rig, prior: Prior, errors: RigErrors | None) -> Estimate | None:
    """The maximum-likelihood ring; None if the iteration diverges.

    Parameters that the shot leaves open (with one stripe the tilt about it, with two the curvature) are held by weak
    priors in a second run, so that they do not degrade the others. If visible edges close such a gap, the regularised
    solution is the start: far from the ring, edges lead to wrong minima.
    """
    edges_seen = {*measured.points.edge.tolist(), *measured.edges.edge.tolist()}
    prior = prior._replace(single_edge=prior.radii is None and len(edges_seen) == 1)
    observations = measured.observations(rig.lasers)
    solve = partial(_gauss_newton, measured, observations, rig, errors)
    with np.errstate(all="ignore"):  # a diverging iteration ends in `_plausible`
        start = initial_guess(measured, observations, prior)
        if start is None:
            return None
        if len(measured.edges.edge) and len(measured.lines.laser) < STRIPES_OF_A_PLANE:
            regularized = solve(start, prior._replace(regularize_about=start))
            start = start if regularized is None else regularized.state
        estimate = solve(start, prior)
        if estimate is None or _is_poorly_determined(estimate):
            estimate = solve(start, prior._replace(regularize_about=start))
        # one edge without a line on the face beside it leaves open on which side the centre is: try the other one
        side_open = prior.single_edge and bool(measured.points.isolated.all())
        if estimate is not None and estimate.state.curvature < 0 and side_open:
            state = estimate.state
            turned = state._replace(outward=-state.outward, curvature=-state.curvature, shift_m=-state.shift_m)
            estimate = solve(turned, prior) or estimate
    return estimate


def _gauss_newton(
    measured: Measurements,
    observations: Observations,
    rig: Rig,
    errors: RigErrors | None,
    state: RingState,
    prior: Prior,
) -> Estimate | None:
    """Iteratively reweighted Gauss-Newton from a state; None if it diverges."""
    nuisance: NuisanceJacobian | None = None
    predicted = None
    for iteration in range(MAX_ITERATIONS):
        residuals = ring_residuals(state, measured, observations, prior)  # r and J, whitened
        if iteration == 1:  # near the solution; B hardly changes from here
            nuisance = nuisance_jacobian(state, residuals, measured, observations, errors, rig)
        # weights from the residuals that the last step predicts: before it, outliers hide among large residuals
        weights = _robust_weights(residuals.residual if predicted is None else predicted, measured)
        try:
            normal_matrix, step, nuisance_step = solve_normal_equations(residuals, weights, nuisance)
        except np.linalg.LinAlgError:
            return None
        if not _plausible(state, step):
            return None
        if iteration and step @ normal_matrix @ step < MIN_STEP_SIGMAS**2:  # squared Mahalanobis length
            break
        predicted = residuals.residual + residuals.jacobian @ step
        if nuisance is not None and nuisance_step is not None:
            predicted = predicted + nuisance.residual @ nuisance_step
        state = state.retract(step)
    inverse = _inverse(normal_matrix)
    if inverse is None:
        return None
    regularized = prior.regularize_about is not None
    return Estimate(state, residuals, weights, nuisance, nuisance_step, regularized, normal_matrix, inverse)


def _inverse(normal_matrix: Float64[Array, "7 7"]) -> Float64[Array, "7 7"] | None:
    """The covariance; None if the matrix is singular, where rounding may leave variances that are not positive."""
    try:
        inverse = np.linalg.inv(normal_matrix + _RIDGE)
    except np.linalg.LinAlgError:
        return None
    return inverse if bool((inverse.diagonal() > 0).all()) else None


def solve_normal_equations(
    residuals: Residuals, weights: Float64[Array, "row"], nuisance: NuisanceJacobian | None
) -> tuple[Float64[Array, "7 7"], Float64[Array, "7"], Float64[Array, "error"] | None]:
    """The normal matrix with the common errors marginalised, the ring's step, and the common errors after it.

    With residuals r, Jacobian J, weights W and the derivatives B with respect to the common errors (unit variance),
    the Schur complement of [J B]^T W [J B] + diag(0, 1): S = J^T W J - J^T W B (1 + B^T W B)^-1 B^T W J, and
    S step = -(J^T W r - J^T W B (1 + B^T W B)^-1 B^T W r).
    """
    weighted = residuals.jacobian.T * weights  # J^T W
    normal_matrix, gradient = weighted @ residuals.jacobian, weighted @ residuals.residual
    if nuisance is None:
        return normal_matrix, -np.linalg.solve(normal_matrix + _RIDGE, gradient), None
    weighted_nuisance = nuisance.residual.T * weights  # B^T W
    cross_information = np.empty((len(weighted_nuisance), PARAMETERS + 1))  # B^T W [J r]
    cross_information[:, :-1] = weighted_nuisance @ residuals.jacobian
    cross_information[:, -1] = weighted_nuisance @ residuals.residual
    solution = np.linalg.solve(nuisance.information(weights), cross_information)
    eliminated = cross_information[:, :-1].T @ solution
    normal_matrix = normal_matrix - eliminated[:, :-1]
    step = -np.linalg.solve(normal_matrix + _RIDGE, gradient - eliminated[:, -1])
    return normal_matrix, step, -solution[:, -1] - solution[:, :-1] @ step


def _robust_weights(residual: Float64[Array, "row"], measured: Measurements) -> Float64[Array, "row"]:
    """Huber weights of break points and visible edges; 1 for lines, which are robust fits, and for the prior."""
    first = 2 * len(measured.lines.laser)
    count = len(measured.points.laser) + int(measured.points.isolated.sum()) + len(measured.edges.edge)
    weights = np.ones(len(residual))
    weights[first : first + count] = huber_weights(residual[first : first + count], HUBER_SIGMAS)
    return weights


def _plausible(state: RingState, step: Float64[Array, "7"]) -> bool:
    depth = hypot(*(state.plane + step[:3]).tolist())
    curvature = abs(state.curvature + float(step[CURVATURE]))
    return all(map(isfinite, step.tolist())) and 1 / MAX_DEPTH_M < depth < 1 / MIN_DEPTH_M and curvature < MAX_CURVATURE


def _is_poorly_determined(estimate: Estimate) -> bool:
    """Whether the shot leaves tilt or in-plane rotation to more than 0.5 rad, or curvature to more than 1/m (sigmas).

    The weak priors of `ring_residuals` have about these standard deviations.
    """
    variance = estimate.inverse.diagonal().tolist()
    tilt_variance = max(variance[:2]) / float(estimate.state.plane @ estimate.state.plane)
    return bool(max(tilt_variance, variance[TURN]) > 0.25 or variance[CURVATURE] > 1.0)


def initial_guess(measured: Measurements, observations: Observations, prior: Prior) -> RingState | None:
    """The plane of the stripes, and a ring of typical size on it; None if the plane is not in front of the camera."""
    if not len(measured.points.x):
        return None
    try:
        plane = _plane_of_stripes(measured, observations)
    except np.linalg.LinAlgError:
        return None
    state = RingState(plane, np.array([1.0, 0.0, 0.0]), 0.0, EXPECTED_CURVATURE, 0.0)
    stripes = predict_stripes(state, observations)
    inverse_depth = stripes.rays @ plane
    if not bool((inverse_depth > 0).all()):
        return None
    ends = len(observations.whitening)
    rays, slope, depth_m = stripes.rays[ends:], stripes.slope[ends:], 1.0 / inverse_depth[ends:]
    # dP/dx of the break points along their stripes, for P = depth r
    rate = depth_m * (plane[0] + slope * plane[1])
    ray_wrt_x = -rate[:, None] * rays
    ray_wrt_x[:, 0] += 1.0
    ray_wrt_x[:, 1] += slope
    outward = _outward_direction(state, measured, observations, depth_m[:, None] * ray_wrt_x, depth_m)
    curvature, band_m = _expected_size(measured, depth_m * (rays @ outward), prior)
    return RingState(plane, outward, 0.0, curvature, band_m)


def _plane_of_stripes(measured: Measurements, observations: Observations) -> Float64[Array, "3"]:
    """The plane q that fits the stripes: (m . r - d q . r) / (m - d q)_y = 0, linear in q for a fixed denominator."""
    ends, count = len(observations.whitening), len(observations.rays)
    whitening = np.zeros((count, count))
    whitening[:ends, :ends] = observations.whitening
    isolated = ends + np.flatnonzero(measured.points.isolated)
    whitening[isolated, isolated] = 1.0 / np.sqrt(measured.points.covariance[isolated - ends, 1, 1])
    distance_m = observations.light_distance_m
    cosine = (observations.light_normal * observations.rays).sum(axis=1)  # m . r
    plane = np.array([0.0, 0.0, float((cosine / distance_m).sum()) / count])
    for _ in range(2):
        denominator = observations.light_normal[:, 1] - distance_m * plane[1]
        rows = whitening @ ((distance_m / denominator)[:, None] * observations.rays)
        matrix = rows.T @ rows
        matrix[[0, 1], [0, 1]] += 1.0 / plane[2] ** 2  # with a single stripe: a plane that faces the camera
        plane = np.linalg.solve(matrix, rows.T @ (whitening @ (cosine / denominator)))
    return plane


def _outward_direction(
    state: RingState,
    measured: Measurements,
    observations: Observations,
    point_wrt_x: Float64[Array, "point 3"],
    depth_m: Float64[Array, "point"],
) -> Float64[Array, "3"]:
    """Mean direction from inner towards outer ends, seen from the middles of their stripes."""
    points = measured.points
    direction = (observations.edge_sign * (points.x - points.middle_x)) @ point_wrt_x
    if float(direction @ direction) < MIN_LENGTH_M**2:  # no stripe has a length: across the row of break points
        ends = observations.rays[[-1, -len(points.x)]] * depth_m[[-1, 0], None]
        direction = cross(state.normal, ends[0] - ends[1])
    if float(direction @ direction) < MIN_LENGTH_M**2:  # a single point: along its stripe
        direction = point_wrt_x[0]
    direction = direction - (direction @ state.normal) * state.normal
    unit: Float64[Array, "3"] = direction / np.sqrt(direction @ direction)
    return unit


def _expected_size(measured: Measurements, outward_m: Float64[Array, "point"], prior: Prior) -> tuple[float, float]:
    """Curvature (1/m) and radial width (m) of the ring's band, for the initial guess.

    Both follow from the prior of the radii where it gives them. Otherwise the curvature is that of a typical ring, and
    the width is the mean distance between the inner and the outer break points, at `outward_m` in radial direction.
    """
    inner, outer = (outward_m[measured.points.edge == edge].tolist() for edge in range(2))
    band_m = sum(outer) / len(outer) - sum(inner) / len(inner) if inner and outer else EXPECTED_BAND_M
    if prior.radii is None or not np.isfinite(prior.radii.radius_m).any():
        return EXPECTED_CURVATURE, band_m
    inner_m, outer_m = prior.radii.radius_m.tolist()
    both_known = np.isfinite(outer_m - inner_m)
    return 1.0 / float(np.nanmean(prior.radii.radius_m)), outer_m - inner_m if both_known else band_m
