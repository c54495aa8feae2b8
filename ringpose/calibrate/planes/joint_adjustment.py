"""Board poses and light planes together, the most likely of corners and stripes (ringpose-method(7), section 6).

Corners place the boards, stripes tie them to the light planes: stripes on many boards say more about each board than
its corners alone. Views share only planes and camera, so each view's pose is eliminated where it occurs.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.boards.corner_errors import MIN_SIGMA_PX, corner_residuals, whiten
from ringpose.calibrate.boards.pose import moved_pose, residuals
from ringpose.calibrate.camera.parameters import camera_with, parameter_names, parameters_of, projection_jacobians
from ringpose.calibrate.planes.stripe_errors import center_sigma_px, shared_length, stripe_bend, stripe_rows
from ringpose.errors import DataError
from ringpose.geometry.rays import rays, undistorted_pixels
from ringpose.geometry.robust import huber_weights, robust_std
from ringpose.geometry.rotations import tilted
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.board import BoardPose
from ringpose.types.calibration import StripeView
from ringpose.types.camera import Camera

ROBUST_SIGMAS = 3.0
"""Residuals beyond so many standard deviations pull no harder than these (Huber): 0.3 % of normal errors."""

_ITERATIONS = 50
_CONVERGED = 1e-4
"""Decrease of the sum of squares that is left: a hundredth of a standard deviation. Weights that follow the median keep
moving far below that."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointState:
    """What is estimated."""

    poses: tuple[BoardPose, ...]
    normal: Float64[Array, "laser xyz=3"]
    distance_m: Float64[Array, "laser"]
    camera: Camera


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointData:
    """What is measured, with its errors."""

    views: tuple[StripeView, ...]
    corner_px: Float64[Array, "view"]
    """Standard deviation of one coordinate of a corner."""
    center_px: tuple[Float64[Array, "laser"], ...]
    """By view: of a stripe centre, its likeness to its neighbours allowed for; NaN where there is none."""
    rays: tuple[tuple[Float64[Array, "_ xyz=3"], ...], ...]
    """By view and laser, of the stripe centres, as the given camera has them."""
    camera: Camera
    """As it was given, with its covariance."""
    free_camera: bool = False

    def without_view(self, left_out: int) -> "JointData":
        """The same without one view."""
        return replace(
            self,
            views=self.views[:left_out] + self.views[left_out + 1 :],
            corner_px=np.delete(self.corner_px, left_out),
            center_px=self.center_px[:left_out] + self.center_px[left_out + 1 :],
            rays=self.rays[:left_out] + self.rays[left_out + 1 :],
        )

    def without_laser(self, laser: int) -> "JointData":
        """The same without one laser's stripes; the camera stays as it was given."""
        nothing = (np.empty((0, 3)),)
        return replace(
            self, rays=tuple(own[:laser] + nothing + own[laser + 1 :] for own in self.rays), free_camera=False
        )

    def with_camera(self, camera: Camera) -> "JointData":
        """The same seen by another camera, which is held."""
        seen = tuple(tuple(rays(px, camera) for px in view.stripes_px) for view in self.views)
        return replace(self, rays=seen, camera=camera, free_camera=False)


class JointFit(NamedTuple):
    """The solution and what its neighbourhood says."""

    state: JointState
    information: Float64[Array, "shared shared"]
    """Of the planes' parameters (three a laser) and the camera's, the poses eliminated; without the camera's prior."""
    chi2: float
    """Corners and stripe lines, each by its standard deviation, squared and summed; robust."""


def joint_data(
    views: Sequence[StripeView], camera: Camera, corner_px: Float64[Array, "view"], free_camera: bool = False
) -> JointData:
    """The views with the errors that they show themselves.

    Stripes tell theirs made straight: no smooth line of few terms follows what a lens bends from side to side of the
    image, and what is left would pass for likeness of neighbours.
    """
    straight = [[undistorted_pixels(px, camera) for px in view.stripes_px] for view in views]
    shared = shared_length([px for view in straight for px in view])
    return JointData(
        views=tuple(views),
        corner_px=np.maximum(corner_px, MIN_SIGMA_PX),
        center_px=tuple(np.array([_center_px(px, shared) for px in view]) for view in straight),
        rays=tuple(tuple(rays(px, camera) for px in view.stripes_px) for view in views),
        camera=camera,
        free_camera=free_camera,
    )


def joint_fit(data: JointData, start: JointState) -> JointFit:
    """Gauss and Newton's steps from a start near the solution, the weights renewed with each."""
    state, fixed = start, 3 * len(start.distance_m)
    for _ in range(_ITERATIONS):
        equations = _equations(data, state)
        step, gain = _shared_step(data, state, equations, fixed)
        state = _moved(data, state, step, equations)
        if gain < _CONVERGED:
            return JointFit(state, _equations(data, state).information, _chi2(data, state))
    raise DataError(
        "calibrate-planes", "board poses and light planes do not settle", "try --method total-least-squares"
    )


def free_parameters(camera: Camera) -> Bool[Array, "parameter"]:
    """The intrinsic parameters that were estimated: those of the camera's covariance that are not held."""
    names = parameter_names(camera.distortion_model)
    deviations = {} if camera.covariance is None else camera.covariance.standard_deviations
    return np.array([deviations.get(name, 0.0) > 0 for name in names])


def prior_information(camera: Camera) -> Float64[Array, "parameter parameter"]:
    """Inverse of the camera's covariance; zero for what is held."""
    names = parameter_names(camera.distortion_model)
    information = np.zeros((len(names), len(names)))
    if camera.covariance is not None:
        sigma = np.sqrt(np.diag(camera.covariance.data))
        known = np.flatnonzero(sigma > 0)
        scale = np.outer(sigma[known], sigma[known])
        inverse = np.linalg.inv(camera.covariance.data[np.ix_(known, known)] / scale) / scale
        places = [names.index(camera.covariance.parameters[index]) for index in known]
        information[np.ix_(places, places)] = inverse
    return information


class _Equations(NamedTuple):
    """Normal equations of the shared parameters, and what gives the poses their steps."""

    information: Float64[Array, "shared shared"]
    gradient: Float64[Array, "shared"]
    pose_step: tuple[Float64[Array, "pose=6"], ...]
    """Of each view if the shared parameters stay ..."""
    pose_by_shared: tuple[Float64[Array, "pose=6 shared"], ...]
    """... and how it follows them."""
    pose_gain: float
    """By how much the sum of squares would shrink if the poses alone moved."""


def _equations(data: JointData, state: JointState) -> _Equations:
    shared = 3 * len(state.distance_m) + 4 + len(state.camera.distortion_coefficients)
    information, gradient = np.zeros((shared, shared)), np.zeros(shared)
    steps, follow, gain = [], [], 0.0
    for index in range(len(data.views)):
        by_pose, by_shared, residual = _view_rows(data, state, index)
        inverse = np.linalg.inv(by_pose.T @ by_pose)
        mixed = by_pose.T @ by_shared
        pull = by_pose.T @ residual
        information += by_shared.T @ by_shared - mixed.T @ inverse @ mixed
        gradient += by_shared.T @ residual - mixed.T @ inverse @ pull
        gain += float(pull @ inverse @ pull)
        steps.append(-inverse @ pull)
        follow.append(-inverse @ mixed)
    return _Equations(information, gradient, tuple(steps), tuple(follow), gain)


def _view_rows(
    data: JointData, state: JointState, index: int
) -> tuple[Float64[Array, "row pose=6"], Float64[Array, "row shared"], Float64[Array, "row"]]:
    """Derivatives by the view's pose and by what is shared, and residuals, all by standard deviations and weighed."""
    view, pose, planes = data.views[index], state.poses[index], 3 * len(state.distance_m)
    by_pose, by_camera = projection_jacobians(view.board.points_board_m, pose, state.camera)
    error = residuals(view.board, pose, state.camera).reshape(-1, 1)
    every = np.hstack([-by_pose.reshape(-1, 6), error, -by_camera.reshape(len(error), -1)])
    every = whiten(every, view.board) / data.corner_px[index]
    corners = np.hstack([np.zeros((len(error), planes)), every[:, 7:]])
    rows = [(every[:, :6], corners, every[:, 6])]
    for laser, directions in enumerate(_rays(data, state, index)):
        if not len(directions):
            continue
        found = stripe_rows(directions, pose, state.normal[laser], float(state.distance_m[laser]), state.camera)
        sigma = data.center_px[index][laser]
        by_shared = np.zeros((len(directions), corners.shape[1]))
        by_shared[:, 3 * laser : 3 * laser + 3] = found.by_plane / sigma
        by_shared[:, planes:] = found.by_camera / sigma
        rows.append((found.by_pose / sigma, by_shared, found.residual_px / sigma))
    root = [np.sqrt(_huber(residual)) for _, _, residual in rows]
    return (
        np.concatenate([weight[:, None] * row[0] for weight, row in zip(root, rows, strict=True)]),
        np.concatenate([weight[:, None] * row[1] for weight, row in zip(root, rows, strict=True)]),
        np.concatenate([weight * row[2] for weight, row in zip(root, rows, strict=True)]),
    )


def _rays(data: JointData, state: JointState, index: int) -> tuple[Float64[Array, "_ xyz=3"], ...]:
    if not data.free_camera:
        return data.rays[index]
    return tuple(rays(px, state.camera) for px in data.views[index].stripes_px)


def _huber(residual: Float64[Array, "n"]) -> Float64[Array, "n"]:
    """Weights; a stripe that lies aside as a whole has a scatter as large, and loses no single centres."""
    return huber_weights(residual, ROBUST_SIGMAS * max(1.0, robust_std(residual)))


def _shared_step(
    data: JointData, state: JointState, equations: _Equations, planes: int
) -> tuple[Float64[Array, "shared"], float]:
    """The step of planes and camera, and by how much it makes the sum of squares smaller."""
    information, gradient = equations.information.copy(), equations.gradient.copy()
    free = np.diag(information) > 0
    free[planes:] = False
    if data.free_camera:
        free[planes:] = free_parameters(data.camera)
        prior = prior_information(data.camera)
        information[planes:, planes:] += prior
        gradient[planes:] += prior @ (parameters_of(state.camera) - parameters_of(data.camera))
    step = np.zeros(len(gradient))
    scale = np.sqrt(np.diag(information)[free])
    inner = information[np.ix_(free, free)] / np.outer(scale, scale)
    step[free] = -np.linalg.solve(inner, gradient[free] / scale) / scale
    return step, -float(step @ gradient) + equations.pose_gain


def _moved(data: JointData, state: JointState, step: Float64[Array, "shared"], equations: _Equations) -> JointState:
    lasers = len(state.distance_m)
    of_plane = step[: 3 * lasers].reshape(lasers, 3)
    poses = tuple(
        moved_pose(pose, own + follow @ step)
        for pose, own, follow in zip(state.poses, equations.pose_step, equations.pose_by_shared, strict=True)
    )
    camera = state.camera
    if data.free_camera:
        camera = camera_with(parameters_of(camera) + step[3 * lasers :], camera)
    return JointState(
        poses=poses,
        normal=np.stack([tilted(normal, tilt) for normal, tilt in zip(state.normal, of_plane[:, :2], strict=True)]),
        distance_m=state.distance_m + of_plane[:, 2],
        camera=camera,
    )


def _chi2(data: JointData, state: JointState) -> float:
    """Corners, and of each stripe its line's shift and turn."""
    total = 0.0
    for index, (view, pose) in enumerate(zip(data.views, state.poses, strict=True)):
        total += corner_chi2(view, pose, state.camera, float(data.corner_px[index]))
        for laser, directions in enumerate(_rays(data, state, index)):
            if len(directions):
                rows = stripe_rows(directions, pose, state.normal[laser], float(state.distance_m[laser]), state.camera)
                ways = np.linalg.norm(stripe_bend(view.stripes_px[laser]), axis=-1)
                run = np.sign(stripe_bend(view.stripes_px[laser])[1].sum(axis=-1)) * ways[1]
                line = np.array([rows.residual_px.mean(), rows.residual_px @ run / len(run)])
                total += len(run) * float(line @ line) / data.center_px[index][laser] ** 2
    return total


def corner_chi2(view: StripeView, pose: BoardPose, camera: Camera, corner_px: float) -> float:
    """Squared residuals of a view's corners by their standard deviation, robust."""
    residual = corner_residuals(view.board, pose, camera) / corner_px
    return float(_huber(residual) @ residual**2)


def _center_px(points_px: Float64[Array, "n xy=2"], shared: float) -> float:
    """By the correlation length of all stripes."""
    if not len(points_px):
        return float("nan")
    return max(center_sigma_px(points_px, shared), MIN_SIGMA_PX)
