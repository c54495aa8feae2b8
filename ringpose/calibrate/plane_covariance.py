"""Joint covariance of camera and light planes, propagated to first order from what was measured.

Points of one view share the error of that board's pose, and all views share the camera's: a covariance from the
scatter of the points about the plane would be far too small. Here three independent sources are propagated:
the corners of each view (through its board's pose), each stripe's line, and the camera.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float64

from ringpose.calibrate.board_pose import board_pose, moved_pose, pose_covariance, residuals
from ringpose.calibrate.intrinsics import camera_with, parameter_names, parameters_of
from ringpose.calibrate.plane_points import on_board
from ringpose.geometry.planes import nearest_plane
from ringpose.geometry.rays import rays
from ringpose.geometry.rotations import tilt_basis
from ringpose.types.arrays import Array
from ringpose.types.board import BoardPose
from ringpose.types.calibration import StripeView
from ringpose.types.camera import Camera
from ringpose.types.covariance import ParameterCovariance
from ringpose.types.laser_planes import LaserPlanes

_POSE_STEPS = np.full(6, 1e-5)
"""Steps of the differences, radians and metres: errors of second order are a millionth of the result."""

_LINE_STEP_PX = 0.01
_CAMERA_STEP = 0.1
"""In standard deviations of each intrinsic parameter."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Estimate:
    """The light planes with all that they were estimated from."""

    views: Sequence[StripeView]
    poses: Sequence[BoardPose]
    camera: Camera
    planes: LaserPlanes
    weights: Sequence[Sequence[Float64[Array, "_"]]]
    """By laser and view, as the next."""
    rays: Sequence[Sequence[Float64[Array, "_ xyz=3"]]]


def planes_covariance(
    views: Sequence[StripeView],
    poses: Sequence[BoardPose],
    camera: Camera,
    planes: LaserPlanes,
    weights: Sequence[Sequence[Float64[Array, "n"]]],
) -> ParameterCovariance:
    """Covariance of the camera's parameters (if the camera has one) and of each plane's two tilts and distance."""
    estimate = _estimate(views, poses, camera, planes, weights)
    own = _from_corners(estimate) + _from_stripes(estimate)
    names = tuple(f"{name}.{what}" for name in planes.names for what in ("tilt_1", "tilt_2", "distance"))
    if camera.covariance is None:
        return ParameterCovariance(parameters=names, data=own)
    by_camera = _by_camera(estimate)
    cross = camera.covariance.data @ by_camera.T
    joint = np.block([[camera.covariance.data, cross], [cross.T, own + by_camera @ cross]])
    return ParameterCovariance(parameters=camera.covariance.parameters + names, data=(joint + joint.T) / 2)


def corner_sigma_px(views: Sequence[StripeView], poses: Sequence[BoardPose], camera: Camera) -> float:
    """Standard deviation of one coordinate of a corner, from the residuals of all views."""
    errors = [residuals(view.board, pose, camera) for view, pose in zip(views, poses, strict=True)]
    squares = sum(float(np.sum(error**2)) for error in errors)
    return float(np.sqrt(squares / max(sum(error.size - 6 for error in errors), 1)))


def _from_corners(estimate: _Estimate) -> Float64[Array, "parameter parameter"]:
    sigma_px = corner_sigma_px(estimate.views, estimate.poses, estimate.camera)
    total = np.zeros((3 * len(estimate.planes.names),) * 2)
    for index, (view, pose) in enumerate(zip(estimate.views, estimate.poses, strict=True)):
        covariance = pose_covariance(view.board, pose, estimate.camera, sigma_px)
        jacobian = _derivative(partial(_moved, estimate, index), _POSE_STEPS)
        total += jacobian @ covariance @ jacobian.T
    return total


def _from_stripes(estimate: _Estimate) -> Float64[Array, "parameter parameter"]:
    total = np.zeros((3 * len(estimate.planes.names),) * 2)
    for index, view in enumerate(estimate.views):
        for laser, points_px in enumerate(view.stripes_px):
            if len(points_px):
                bend = _bend(points_px)
                jacobian = _derivative(partial(_bent, estimate, index, laser), np.full(2, _LINE_STEP_PX))
                total += _line_variance_px2(points_px, bend) * jacobian @ jacobian.T
    return total


def _by_camera(estimate: _Estimate) -> Float64[Array, "parameter camera"]:
    """Derivative by those intrinsic parameters that have a covariance; the boards' poses follow the camera."""
    covariance = estimate.camera.covariance
    assert covariance is not None
    base = parameters_of(estimate.camera)
    names = parameter_names(estimate.camera.distortion_model)
    columns = []
    for name, variance in zip(covariance.parameters, np.diag(covariance.data), strict=True):
        step = _CAMERA_STEP * float(np.sqrt(variance))
        direction = np.zeros(len(base))
        direction[names.index(name)] = 1.0
        if step == 0:
            columns.append(np.zeros(3 * len(estimate.planes.names)))
            continue
        ends = [_seen_by(estimate, camera_with(base + sign * step * direction, estimate.camera)) for sign in (1, -1)]
        columns.append((ends[0] - ends[1]) / (2 * step))
    return np.stack(columns, axis=1)


def _derivative(
    parameters: Callable[[Float64[Array, "step"]], Float64[Array, "parameter"]], steps: Float64[Array, "step"]
) -> Float64[Array, "parameter step"]:
    """Central differences."""
    columns = [
        (parameters(step * unit) - parameters(-step * unit)) / (2 * step)
        for step, unit in zip(steps, np.eye(len(steps)), strict=True)
    ]
    return np.stack(columns, axis=1)


def _estimate(
    views: Sequence[StripeView],
    poses: Sequence[BoardPose],
    camera: Camera,
    planes: LaserPlanes,
    weights: Sequence[Sequence[Float64[Array, "_"]]],
) -> _Estimate:
    every = [[rays(view.stripes_px[laser], camera) for view in views] for laser in range(len(planes.names))]
    return _Estimate(views=views, poses=poses, camera=camera, planes=planes, weights=weights, rays=every)


def _moved(estimate: _Estimate, index: int, step: Float64[Array, "pose=6"]) -> Float64[Array, "parameter"]:
    """The planes' parameters if one board stood elsewhere."""
    poses = [moved_pose(pose, step) if i == index else pose for i, pose in enumerate(estimate.poses)]
    return _parameters(replace(estimate, poses=poses))


def _bent(estimate: _Estimate, index: int, laser: int, step_px: Float64[Array, "2"]) -> Float64[Array, "parameter"]:
    """The planes' parameters if one stripe lay shifted and turned."""
    points_px = estimate.views[index].stripes_px[laser]
    bent = rays(points_px + np.tensordot(step_px, _bend(points_px), 1), estimate.camera)
    changed = [
        [bent if (k, i) == (laser, index) else old for i, old in enumerate(by_view)]
        for k, by_view in enumerate(estimate.rays)
    ]
    return _parameters(replace(estimate, rays=changed))


def _seen_by(estimate: _Estimate, camera: Camera) -> Float64[Array, "parameter"]:
    """The planes' parameters if the camera were another."""
    poses = [board_pose(view.board, camera) for view in estimate.views]
    return _parameters(_estimate(estimate.views, poses, camera, estimate.planes, estimate.weights))


def _parameters(estimate: _Estimate) -> Float64[Array, "parameter"]:
    """Tilts (about the estimate's own normals) and distances of the planes through the triangulated centres."""
    parameters: list[float] = []
    for normal, by_view, weights in zip(estimate.planes.normal, estimate.rays, estimate.weights, strict=True):
        points = [on_board(seen, pose) for seen, pose in zip(by_view, estimate.poses, strict=True)]
        moved, distance_m, _ = nearest_plane(np.concatenate(points), np.concatenate(weights))
        along = float(moved @ normal)
        parameters += [*(tilt_basis(normal) @ moved / along), distance_m * np.sign(along)]
    return np.array(parameters)


def _bend(points_px: Float64[Array, "n xy=2"]) -> Float64[Array, "2 n xy=2"]:
    """Two independent ways in which a stripe's line may err: shifted, and turned about its middle, by one pixel rms."""
    middle = points_px - points_px.mean(axis=0)
    along = np.linalg.svd(middle, full_matrices=False)[2][0]
    across = np.array([-along[1], along[0]])
    run = middle @ along
    ways = np.stack([np.ones(len(run)), run / np.sqrt(np.mean(run**2))])
    bend: Float64[Array, "2 n xy=2"] = ways[..., None] * across
    return bend


def _line_variance_px2(points_px: Float64[Array, "n xy=2"], bend: Float64[Array, "2 n xy=2"]) -> float:
    """Variance of a line's shift and turn: the centres' scatter over the number of independent centres.

    Speckle makes neighbours alike; their number is divided by the correlation length of the residuals.
    """
    middle = points_px - points_px.mean(axis=0)
    across = bend[0, 0]
    along = np.array([across[1], -across[0]])
    run, offset = middle @ along, middle @ across
    order = np.argsort(run)
    residual = offset - np.polynomial.polynomial.polyval(run, np.polynomial.polynomial.polyfit(run, offset, 3))
    return float(residual.var() * correlation_length(residual[order]) / len(residual))


def correlation_length(residual: Float64[Array, "n"]) -> float:
    """Number of neighbours that count as one: 1 + 2 times the sum of the autocorrelation up to its first zero."""
    power = float(residual @ residual)
    if power == 0:
        return 1.0
    length = 1.0
    for lag in range(1, len(residual) // 4):
        correlation = float(residual[lag:] @ residual[:-lag]) / power
        if correlation <= 0:
            break
        length += 2 * correlation
    return length
