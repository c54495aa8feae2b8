"""Joint covariance of camera and light planes, propagated to first order from what was measured.

Points of one view share the error of that board's pose, and all views share the camera's: a covariance from the
scatter of the points about the plane would be far too small. Here three independent sources are propagated:
the corners of each view (through its board's pose), each stripe's line, and the camera. Where the views disagree by
more than corners and stripes explain (a bent board, an inexact print), these two are scaled up to what they show.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float64

from ringpose.calibrate.board_pose import board_pose, moved_pose, pose_covariance
from ringpose.calibrate.intrinsics import camera_with, parameter_names, parameters_of
from ringpose.calibrate.plane_points import on_board
from ringpose.calibrate.stripe_errors import line_variance_px2, stripe_bend
from ringpose.calibrate.view_excess import corner_sigma_px, view_excess
from ringpose.geometry.planes import nearest_plane
from ringpose.geometry.rays import rays
from ringpose.geometry.rotations import tilt_basis
from ringpose.types.arrays import Array
from ringpose.types.board import BoardPose
from ringpose.types.calibration import LaserCalibration, StripeView
from ringpose.types.camera import Camera
from ringpose.types.covariance import ParameterCovariance

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
    lasers: Sequence[LaserCalibration]
    rays: Sequence[Sequence[Float64[Array, "_ xyz=3"]]]
    """Of the stripe centres, by laser and view."""


def planes_covariance(
    views: Sequence[StripeView], poses: Sequence[BoardPose], camera: Camera, lasers: Sequence[LaserCalibration]
) -> ParameterCovariance:
    """Covariance of the camera's parameters (if the camera has one) and of each plane's two tilts and distance."""
    estimate = _estimate(views, poses, camera, lasers)
    sigma_px = corner_sigma_px(views, poses, camera)
    own = view_excess(views, poses, camera, lasers, sigma_px) * (
        _from_corners(estimate, sigma_px) + _from_stripes(estimate)
    )
    names = tuple(f"{laser.name}.{what}" for laser in lasers for what in ("tilt_1", "tilt_2", "distance"))
    if camera.covariance is None:
        return ParameterCovariance(parameters=names, data=own)
    by_camera = _by_camera(estimate)
    cross = camera.covariance.data @ by_camera.T
    joint = np.block([[camera.covariance.data, cross], [cross.T, own + by_camera @ cross]])
    return ParameterCovariance(parameters=camera.covariance.parameters + names, data=(joint + joint.T) / 2)


def _from_corners(estimate: _Estimate, sigma_px: float) -> Float64[Array, "parameter parameter"]:
    total = np.zeros((3 * len(estimate.lasers),) * 2)
    for index, (view, pose) in enumerate(zip(estimate.views, estimate.poses, strict=True)):
        covariance = pose_covariance(view.board, pose, estimate.camera, sigma_px)
        jacobian = _derivative(partial(_moved, estimate, index), _POSE_STEPS)
        total += jacobian @ covariance @ jacobian.T
    return total


def _from_stripes(estimate: _Estimate) -> Float64[Array, "parameter parameter"]:
    total = np.zeros((3 * len(estimate.lasers),) * 2)
    for index, view in enumerate(estimate.views):
        for laser, points_px in enumerate(view.stripes_px):
            if len(points_px):
                jacobian = _derivative(partial(_bent, estimate, index, laser), np.full(2, _LINE_STEP_PX))
                total += line_variance_px2(points_px) * jacobian @ jacobian.T
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
            columns.append(np.zeros(3 * len(estimate.lasers)))
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
    views: Sequence[StripeView], poses: Sequence[BoardPose], camera: Camera, lasers: Sequence[LaserCalibration]
) -> _Estimate:
    every = [[rays(view.stripes_px[laser], camera) for view in views] for laser in range(len(lasers))]
    return _Estimate(views=views, poses=poses, camera=camera, lasers=lasers, rays=every)


def _moved(estimate: _Estimate, index: int, step: Float64[Array, "pose=6"]) -> Float64[Array, "parameter"]:
    """The planes' parameters if one board stood elsewhere."""
    poses = [moved_pose(pose, step) if i == index else pose for i, pose in enumerate(estimate.poses)]
    return _parameters(replace(estimate, poses=poses))


def _bent(estimate: _Estimate, index: int, laser: int, step_px: Float64[Array, "2"]) -> Float64[Array, "parameter"]:
    """The planes' parameters if one stripe lay shifted and turned."""
    points_px = estimate.views[index].stripes_px[laser]
    bent = rays(points_px + np.tensordot(step_px, stripe_bend(points_px), 1), estimate.camera)
    changed = [
        [bent if (k, i) == (laser, index) else old for i, old in enumerate(by_view)]
        for k, by_view in enumerate(estimate.rays)
    ]
    return _parameters(replace(estimate, rays=changed))


def _seen_by(estimate: _Estimate, camera: Camera) -> Float64[Array, "parameter"]:
    """The planes' parameters if the camera were another."""
    poses = [board_pose(view.board, camera) for view in estimate.views]
    return _parameters(_estimate(estimate.views, poses, camera, estimate.lasers))


def _parameters(estimate: _Estimate) -> Float64[Array, "parameter"]:
    """Tilts (about the estimate's own normals) and distances of the planes through the triangulated centres."""
    parameters: list[float] = []
    for laser, by_view in zip(estimate.lasers, estimate.rays, strict=True):
        points = [on_board(seen, pose) for seen, pose in zip(by_view, estimate.poses, strict=True)]
        weights = np.concatenate([view.weights for view in laser.views])  # views that do not show it have no points
        moved, distance_m, _ = nearest_plane(np.concatenate(points), weights)
        along = float(moved @ laser.normal)
        parameters += [*(tilt_basis(laser.normal) @ moved / along), distance_m * np.sign(along)]
    return np.array(parameters)
