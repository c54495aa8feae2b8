"""Error model of board corners: bias by distortion, correlation within a marker, variance by view (method(7), 6 and 7).

Corners of markers are intersections of parabolas fitted to the sides. The second term of the radial distortion bends a
side of 120 px near the image's corner by 0.004 px more than a parabola can follow, which at its ends is half of the
noise. The centroid of a circle of radius 10 px is displaced by as much from the projection of its centre, in addition
to the displacement by perspective. Both are systematic, and can be computed from an approximate camera.

A marker's corner is the intersection of two sides, and each side is one parabola fitted to its edge: an error of a
side moves the corners at both of its ends. If the corners were taken as independent, the standard deviations of the
pose of a board with four markers would be a third too small.

The variance of a view is estimated from its own few dozen residuals and from the variance that is typical of all
views. Both are weighted by how much the views differ: moderated variances (Smyth 2004), a scaled inverse chi-squared
prior on the variance.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq
from scipy.special import digamma, polygamma

from ringpose.calibrate.boards.patterns.circles import seen_offsets
from ringpose.calibrate.boards.pose import board_pose, moved_pose, projection, residuals
from ringpose.geometry.least_squares import Eliminated, robust_std
from ringpose.geometry.rays import project
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.calibration import StripeView
from ringpose.types.rig import Camera

MIN_SIGMA_PX = 0.002
"""Lower limit of a corner's standard deviation in one view, and of the systematic part common to all views."""

CLIP_SIGMAS = 3.0
"""Residuals are clipped to this many standard deviations."""

_MIN_VARIATION = 1e-9
"""Variance of the logarithms of the views' variances below which the views are taken as equally accurate."""

_POSE_PARAMETERS = 6

_SAMPLES = 33
"""Points along a marker's side or a circle at which distortion is evaluated."""


def whiten(rows: Float64[Array, "coordinate *column"], view: BoardView) -> Float64[Array, "coordinate *column"]:
    """Rows of a view's corner coordinates (x and y of each corner in turn), decorrelated within each marker.

    The mean variance of a coordinate is unchanged. Corners with correlated errors come as whole markers.
    """
    if view.end_correlation == 0:
        return rows
    by_marker = rows.reshape(-1, 8, rows.size // len(rows))
    return np.linalg.solve(_correlation_root(view), by_marker).reshape(rows.shape)


def corner_residuals(view: BoardView, pose: BoardPose, camera: Camera) -> Float64[Array, "coordinate"]:
    """Decorrelated residuals of a view's corners in pixels, x and y of each corner in turn."""
    return whiten(residuals(view, pose, camera).ravel(), view)


class ViewEquations(NamedTuple):
    """Linearised equations of a view's corners, one row per coordinate, with independent errors of unit variance.

    The residuals (measured minus projected) are those explained by steps of pose and camera:
    `residual = wrt_pose @ pose_step + wrt_camera @ camera_step`.
    """

    wrt_pose: Float64[Array, "row pose=6"]
    wrt_camera: Float64[Array, "row parameter"]
    residual: Float64[Array, "row"]

    def without_pose(self) -> Eliminated:
        """The equations of the camera that are left when the pose is eliminated."""
        return Eliminated.of(self.wrt_pose, self.wrt_camera, self.residual)


def view_equations(view: BoardView, pose: BoardPose, camera: Camera, sigma_px: float) -> ViewEquations:
    """The equations of a view whose corner coordinates have this standard deviation, decorrelated."""
    pixels, wrt_pose, wrt_camera = projection(view.points_board_m, pose, camera)
    residual_px = (view.points_px - pixels)[..., None]
    rows = np.concatenate([wrt_pose, wrt_camera, residual_px], axis=-1).reshape(2 * len(wrt_pose), -1)
    rows = whiten(rows, view) / sigma_px
    return ViewEquations(wrt_pose=rows[:, :6], wrt_camera=rows[:, 6:-1], residual=rows[:, -1])


def maximum_likelihood_pose(view: BoardView, camera: Camera) -> tuple[BoardPose, Float64[Array, "pose=6 pose=6"]]:
    """The board's pose with correlated corner errors, and its covariance for a standard deviation of one pixel."""
    pose = board_pose(view, camera)
    jacobian, _, residual = view_equations(view, pose, camera, 1.0)
    covariance: Float64[Array, "pose=6 pose=6"] = np.linalg.inv(jacobian.T @ jacobian)
    if view.end_correlation:  # one Gauss-Newton step: the unweighted pose differs from this one by less than its noise
        pose = moved_pose(pose, covariance @ jacobian.T @ residual)
    return pose, covariance


def endpoint_correlation(left_out: float) -> float:
    """Correlation of the errors of a fitted parabola at the two ends of a side.

    `left_out` is the share of the side at each end that was not used by the fit. On the interval -1 to 1 of the fit,
    level, slope and curvature have independent errors in the normalised Legendre polynomials 1, 3^1/2 x and
    5^1/2 (3 x^2 - 1) / 2; the ends of the side are at x = +-1 / (1 - 2 left_out).
    """
    end = 1.0 / (1.0 - 2.0 * left_out)
    even = 1.0 + 5.0 * ((3.0 * end**2 - 1.0) / 2.0) ** 2
    odd = 3.0 * end**2
    return (even - odd) / (even + odd)


def endpoint_for_correlation(correlation: float) -> float:
    """The inverse of `endpoint_correlation`: position x of a side's end, with the parabola fitted from -1 to 1.

    With u = x^2, the even and odd parts of the variance are 1 + 5/4 (3 u - 1)^2 and 3 u.
    """
    ratio = 3.0 * (1.0 + correlation) / (1.0 - correlation)
    squared = np.roots([11.25, -7.5 - ratio, 2.25])
    return float(np.sqrt(max(squared.real.max(), 1.0)))


def side_normals(corners: Float64[Array, "marker corner=4 xy=2"]) -> Float64[Array, "marker side=4 xy=2"]:
    """Outward unit normals of the markers' sides; corners are in clockwise order."""
    along = np.roll(corners, -1, axis=1) - corners
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    return np.stack([along[..., 1], -along[..., 0]], axis=-1)


def _correlation_root(view: BoardView) -> Float64[Array, "marker coordinate=8 coordinate=8"]:
    """Cholesky factor of the covariance of a marker's eight coordinates, for unit variance at the sides' ends."""
    corners = view.points_px.reshape(-1, 4, 2)
    normals = side_normals(corners)
    # A corner moves by the inverse of the matrix of its two sides' normals times the sides' normal displacements.
    intersection = np.linalg.inv(np.stack([normals, np.roll(normals, 1, axis=1)], axis=-2))
    corner_wrt_ends = np.zeros((len(corners), 8, 8))
    for corner in range(4):  # columns: start and end of side 0, of side 1, ...
        ends = [2 * corner, 2 * ((corner - 1) % 4) + 1]
        corner_wrt_ends[:, 2 * corner : 2 * corner + 2, ends] = intersection[:, corner]
    end_covariance = np.kron(np.eye(4), np.array([[1.0, view.end_correlation], [view.end_correlation, 1.0]]))
    return np.linalg.cholesky(corner_wrt_ends @ end_covariance @ corner_wrt_ends.mT)


def moderated_variances(
    squares: Float64[Array, "view"], degrees_of_freedom: Float64[Array, "view"]
) -> Float64[Array, "view"]:
    """Moderated variance of each view, from its sum of squared residuals and their degrees of freedom.

    It is the weighted mean of the view's own variance and the variance of a prior, which is estimated from all views.
    """
    common = max(float(squares.sum() / degrees_of_freedom.sum()), np.finfo(float).tiny)
    own = np.maximum(squares / degrees_of_freedom, 1e-12 * common)
    prior_dof, prior_variance = _variance_prior(np.log(own), degrees_of_freedom)
    if not np.isfinite(prior_dof):
        return np.full(len(own), common)
    return (prior_dof * prior_variance + degrees_of_freedom * own) / (prior_dof + degrees_of_freedom)


def _variance_prior(
    log_variance: Float64[Array, "view"], degrees_of_freedom: Float64[Array, "view"]
) -> tuple[float, float]:
    """Degrees of freedom and variance of the prior; infinite degrees of freedom if the views do not differ."""
    if len(log_variance) < 3:
        return float("inf"), float("nan")
    unbiased = log_variance - digamma(degrees_of_freedom / 2) + np.log(degrees_of_freedom / 2)
    variation = float(np.var(unbiased, ddof=1) - np.mean(polygamma(1, degrees_of_freedom / 2)))
    if variation < _MIN_VARIATION:
        return float("inf"), float("nan")
    bracket = (1 / variation, 1 / variation + 1)  # 1/x < trigamma(x) < 1/x + 1/x^2
    prior_dof = 2 * float(brentq(lambda x: polygamma(1, x) - variation, *bracket))
    return prior_dof, float(np.exp(unbiased.mean() + digamma(prior_dof / 2) - np.log(prior_dof / 2)))


def corner_sigmas_px(views: Sequence[StripeView], poses: Sequence[BoardPose], camera: Camera) -> Float64[Array, "view"]:
    """Standard deviation of one corner coordinate by view, from clipped residuals, as a moderated variance."""
    errors = _residuals(views, poses, camera)
    common = robust_std(np.concatenate(errors))
    limits = [CLIP_SIGMAS * max(common, robust_std(own)) for own in errors]
    squares = [float(np.sum(np.minimum(np.abs(own), limit) ** 2)) for own, limit in zip(errors, limits, strict=True)]
    degrees_of_freedom = np.array([max(own.size - _POSE_PARAMETERS, 1) for own in errors], dtype=np.float64)
    sigmas: Float64[Array, "view"] = np.sqrt(moderated_variances(np.array(squares), degrees_of_freedom))
    return np.maximum(sigmas, MIN_SIGMA_PX)


def with_shared_errors(
    sigmas_px: Float64[Array, "view"],
    views: Sequence[StripeView],
    poses: Sequence[BoardPose],
    camera: Camera,
    shared_parameters: int,
) -> Float64[Array, "view"]:
    """The standard deviations of corner coordinates by view, inflated for errors that a corner has in all views.

    An inaccurate print, a bent board and an edge displaced by the illumination move the same corner in all views:
    such errors are not averaged out by more views. `shared_parameters` is the number of parameters that were estimated
    from all views together.
    The factor is computed from residuals at the given poses (raised also by inconsistent stripes) and at poses from
    corners alone (raised also by outlying corners); the smaller one is used.
    """
    alone = [maximum_likelihood_pose(view.board, camera)[0] for view in views]
    errors = [_residuals(views, each, camera) for each in (poses, alone)]
    factor = min(_shared_factor(sigmas_px, views, own, shared_parameters) for own in errors)
    return np.sqrt(factor * sigmas_px**2 + len(views) * MIN_SIGMA_PX**2)


def _shared_factor(
    sigmas_px: Float64[Array, "view"],
    views: Sequence[StripeView],
    errors: Sequence[Float64[Array, "_"]],
    shared_parameters: int,
) -> float:
    """Variance of each corner's mean residual over the views, over that of independent views; at least one."""
    corners = 1 + max(int(view.board.ids.max()) for view in views)
    sums, counts = np.zeros((corners, 2)), np.zeros(corners)
    for view, own, sigma in zip(views, errors, sigmas_px.tolist(), strict=True):
        standard = np.clip(own / sigma, -CLIP_SIGMAS, CLIP_SIGMAS)
        sums[view.board.ids] += standard.reshape(-1, 2)
        counts[view.board.ids] += 1
    repeated = counts > 1
    degrees_of_freedom = 2 * int(repeated.sum()) - _POSE_PARAMETERS - shared_parameters
    if degrees_of_freedom <= 0:
        return 1.0
    return max(1.0, float(np.sum(sums[repeated] ** 2 / counts[repeated, None])) / degrees_of_freedom)


def _residuals(views: Sequence[StripeView], poses: Sequence[BoardPose], camera: Camera) -> list[Float64[Array, "_"]]:
    """Decorrelated corner residuals by view."""
    return [corner_residuals(view.board, pose, camera) for view, pose in zip(views, poses, strict=True)]


def without_distortion_bias(view: BoardView, camera: Camera) -> BoardView:
    """The view without the systematic errors that distortion causes in marker corners and circle centres.

    Chessboard corners have none: their views are returned unchanged.
    """
    if not view.circle_radius_m and not view.end_correlation:
        return view
    pose = board_pose(view, camera)
    points_m = view.points_board_m @ pose.rotation.T + pose.translation_m
    if view.circle_radius_m:
        # Undo the correction for perspective alone, and apply the one for perspective and distortion.
        centroids_px = view.points_px + seen_offsets(view.points_board_m, view.points_px, view.circle_radius_m)
        corrected = centroids_px - _circle_offsets(points_m, view.circle_radius_m * pose.rotation[:, :2], camera)
    else:
        corrected = _corrected_corners(points_m, view, camera)
    return replace(view, points_px=corrected)


def _circle_offsets(
    points_m: Float64[Array, "corner xyz=3"], axes_m: Float64[Array, "xyz=3 axis=2"], camera: Camera
) -> Float64[Array, "corner xy=2"]:
    """Centroid of each projected circle (of a polygon, by the shoelace formula) minus the projection of its centre."""
    angle = 2 * np.pi * np.arange(_SAMPLES) / _SAMPLES
    rims_m = points_m[:, None] + np.stack([np.cos(angle), np.sin(angle)], axis=-1) @ axes_m.T
    centers_px = project(points_m, camera)
    here = project(rims_m, camera) - centers_px[:, None]
    after = np.roll(here, -1, axis=1)
    twice = here[..., 0] * after[..., 1] - here[..., 1] * after[..., 0]
    return np.einsum("cp,cpk->ck", twice, here + after) / (3 * twice.sum(axis=1, keepdims=True))


def _corrected_corners(
    points_m: Float64[Array, "corner xyz=3"], view: BoardView, camera: Camera
) -> Float64[Array, "corner xy=2"]:
    """Corners of markers, corrected for the distances between the fitted parabolas and the true sides at their ends."""
    at_start, at_end = _parabola_errors(
        points_m.reshape(-1, 4, 3), camera, endpoint_for_correlation(view.end_correlation)
    )
    corners = view.points_px.reshape(-1, 4, 2)
    normals = side_normals(corners)
    sides = np.stack([normals, np.roll(normals, 1, axis=1)], axis=-2)
    errors = np.stack([at_start, np.roll(at_end, 1, axis=1)], axis=-1)
    corrected: Float64[Array, "corner xy=2"] = corners - np.linalg.solve(sides, errors[..., None])[..., 0]
    return corrected.reshape(-1, 2)


def _parabola_errors(
    points_m: Float64[Array, "marker corner=4 xyz=3"], camera: Camera, end: float
) -> tuple[Float64[Array, "marker side=4"], Float64[Array, "marker side=4"]]:
    """Distance of a side's parabola outside the true side at its start and at its end, in pixels.

    The parabola is fitted to equally spaced pixels along the side, from -1 to 1; the side ends at -`end` and `end`. In
    a tilted board these are not equally spaced on the board, and a parabola in one is none in the other.
    """
    share = np.linspace(0.0, 1.0, _SAMPLES)[:, None]
    start, stop = points_m[..., None, :], np.roll(points_m, -1, axis=1)[..., None, :]
    pixels = project(((1.0 - share) * start + share * stop).reshape(-1, 3), camera)
    side = pixels.reshape(*points_m.shape[:2], -1, 2)
    curve, chord = side - side[:, :, :1], side[:, :, -1] - side[:, :, 0]
    across = np.einsum("msnk,msk->msn", curve, side_normals(side[:, :, 0]))
    along = np.einsum("msnk,msk->msn", curve, chord) / np.einsum("msk,msk->ms", chord, chord)[..., None]
    place = end * (2.0 * along - 1.0)
    powers = place[..., None] ** np.arange(3)
    weights = (np.gradient(place, axis=-1) * (np.abs(place) <= 1.0))[..., None]
    weighted = np.swapaxes(weights * powers, -1, -2)
    parabola = np.linalg.solve(weighted @ powers, weighted @ across[..., None])
    errors = (powers[:, :, [0, -1]] @ parabola)[..., 0] - across[..., [0, -1]]
    return errors[..., 0], errors[..., 1]
