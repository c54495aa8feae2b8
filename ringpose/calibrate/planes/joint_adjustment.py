"""Joint adjustment: board poses and light planes by maximum likelihood from corners and stripes (method(7), section 6).

Corners determine the board poses, and stripes tie the boards to the light planes: stripes on many boards determine
each board pose better than its corners alone. Let r be the whitened residuals of a view, P and S those changes of the
view's pose and of the shared parameters s (three for each light plane, then the intrinsic parameters) that explain
them: r = P dp + S ds. Views have only s in common, so that each pose is eliminated from the normal equations of its
view (`Eliminated`):

    (1) information   N = sum over views of S^T S - (P^T S)^T (P^T P)^-1 P^T S
    (2) gradient      g = sum over views of S^T r - (P^T S)^T (P^T P)^-1 P^T r
    (3) shared step   ds = (N + Q)^-1 (g + Q (s0 - s)),  Q and s0 the camera's prior
    (4) pose step     dp = (P^T P)^-1 P^T (r - S ds)

`scipy.optimize.least_squares` with Huber's loss solves the dense system of all poses instead: for eight boards and
18,000 residuals it finds the same planes (to 2e-8 um) in 1.0 s instead of 0.1 s, and a calibration solves this system
ten times. Nor can the limit of its loss follow the scatter of a displaced stripe (`robust_weights`).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.boards.corner_errors import MIN_SIGMA_PX, corner_residuals, view_equations
from ringpose.calibrate.boards.pose import moved_pose
from ringpose.calibrate.camera.parameters import camera_with, parameter_names, parameters_of
from ringpose.calibrate.planes.stripes.errors import (
    StripeRays,
    StripeResiduals,
    center_sigma_px,
    line_modes,
    shared_length,
    stripe_rays,
    stripe_residuals,
)
from ringpose.errors import DataError
from ringpose.geometry.least_squares import Eliminated, covariance_of_free, gauss_newton, huber_weights, robust_std
from ringpose.geometry.rays import undistorted_pixels
from ringpose.geometry.rotations import tilted
from ringpose.geometry.sheets import Bends, bends_in_planes
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.board import BoardPose
from ringpose.types.calibration import StripeView
from ringpose.types.rig import BOW_PARAMETERS, PLANE_PARAMETERS, Camera

ROBUST_SIGMAS = 3.0
"""Limit of the Huber loss in standard deviations: 0.3 % of normal errors exceed it."""

_POSE, _PLANE, _BOW = 6, len(PLANE_PARAMETERS), len(BOW_PARAMETERS)
"""Numbers of parameters of a board's pose, of a light plane and of its bend."""

PROJECTOR_SD_M = 0.1
"""Standard deviation, along each axis in the light plane, of the distance from the camera to the projector of a bent
plane, before its stripes show it: camera and lasers share a housing or a bracket of that size."""

_MAX_ITERATIONS = 50
_CONVERGED = 1e-4
"""Predicted decrease of chi-squared at which the iteration stops: a hundredth of a standard deviation. The robust
weights follow the median and keep changing far below that."""


@dataclass(frozen=True, kw_only=True, eq=False)
class JointState:
    """The estimated quantities; light planes are `normal . point = distance_m` in the camera frame."""

    poses: tuple[BoardPose, ...]
    normal: Float64[Array, "laser xyz=3"]
    distance_m: Float64[Array, "laser"]
    camera: Camera
    bow: Float64[Array, "laser parameter=3"] | None = None
    """`BOW_PARAMETERS` of the light planes; None if all are flat."""

    @cached_property
    def bends(self) -> Bends | None:
        """The bends of the light planes; None if all are flat."""
        return None if self.bow is None else bends_in_planes(self.normal, self.bow)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointData:
    """The measurements with their standard deviations."""

    views: tuple[StripeView, ...]
    corner_px: Float64[Array, "view"]
    """Standard deviation of one coordinate of a corner."""
    center_px: tuple[Float64[Array, "laser"], ...]
    """By view: standard deviation of a stripe centre, inflated for correlated neighbours; NaN without a stripe."""
    rays: tuple[tuple[StripeRays, ...], ...]
    """By view and laser: rays of the stripe centres by the given camera."""
    camera: Camera
    """The given camera, with its covariance."""
    free_camera: bool = False
    """Whether the camera is estimated, with its covariance as prior."""
    bent: tuple[int, ...] = ()
    """Lasers of which the bend is estimated, with a prior of the projector's position."""

    @property
    def sheets(self) -> int:
        """Number of parameters of the light planes: three of each, then three of each bend."""
        return _PLANE * self.lasers + _BOW * len(self.bent)

    @property
    def prior(self) -> Float64[Array, "parameter"]:
        """Information about these parameters before the measurement: 1 / variance."""
        bow = [0.0, PROJECTOR_SD_M**-2, PROJECTOR_SD_M**-2]
        return np.array([0.0] * (_PLANE * self.lasers) + bow * len(self.bent))

    @property
    def lasers(self) -> int:
        """Number of lasers, seen or not."""
        return len(self.rays[0])

    def without_view(self, left_out: int) -> "JointData":
        """The data without one view."""
        return replace(
            self,
            views=self.views[:left_out] + self.views[left_out + 1 :],
            corner_px=np.delete(self.corner_px, left_out),
            center_px=self.center_px[:left_out] + self.center_px[left_out + 1 :],
            rays=self.rays[:left_out] + self.rays[left_out + 1 :],
        )

    def without_laser(self, laser: int) -> "JointData":
        """The data without one laser's stripes; the camera is held fixed."""
        nothing = (stripe_rays(np.empty((0, 2)), self.camera),)
        return replace(
            self, rays=tuple(own[:laser] + nothing + own[laser + 1 :] for own in self.rays), free_camera=False
        )

    def with_camera(self, camera: Camera) -> "JointData":
        """The data with the rays of another camera, which is held fixed."""
        own = tuple(tuple(stripe_rays(px, camera) for px in view.stripes_px) for view in self.views)
        return replace(self, rays=own, camera=camera, free_camera=False)


def joint_data(
    views: Sequence[StripeView], camera: Camera, corner_px: Float64[Array, "view"], free_camera: bool = False
) -> JointData:
    """The measurements, with the standard deviations of stripe centres estimated from the stripes themselves.

    The standard deviations are estimated in undistorted pixels: a polynomial of few terms does not follow the
    distortion across the whole image, and the remaining distortion would be taken for correlation of neighbours.
    """
    straight = [[undistorted_pixels(px, camera) for px in view.stripes_px] for view in views]
    length = shared_length([px for view in straight for px in view])
    return JointData(
        views=tuple(views),
        corner_px=np.maximum(corner_px, MIN_SIGMA_PX),
        center_px=tuple(
            np.array([max(center_sigma_px(px, length), MIN_SIGMA_PX) if len(px) else np.nan for px in view])
            for view in straight
        ),
        rays=tuple(tuple(stripe_rays(px, camera) for px in view.stripes_px) for view in views),
        camera=camera,
        free_camera=free_camera,
    )


def joint_fit(data: JointData, start: JointState) -> JointState:
    """Light planes, board poses and, if it is free, the camera, fitted jointly by re-weighted Gauss-Newton.

    The start has to be near the solution. Raises DataError if the iteration does not converge.
    """
    state, converged = gauss_newton(
        lambda state: _linearized(data, state), _retract, start, _MAX_ITERATIONS, _CONVERGED
    )
    if not converged:
        raise DataError(
            "calibrate-planes",
            "the joint adjustment of board poses and light planes does not converge",
            "try --method total-least-squares",
        )
    return state


def free_parameters(camera: Camera) -> Bool[Array, "parameter"]:
    """Which intrinsic parameters were estimated: those with a standard deviation above zero."""
    names = parameter_names(camera.distortion_model)
    deviations = {} if camera.covariance is None else camera.covariance.standard_deviations
    return np.array([deviations.get(name, 0.0) > 0 for name in names])


def prior_information(camera: Camera) -> Float64[Array, "parameter parameter"]:
    """Inverse of the camera's covariance; zero for parameters that are held fixed."""
    names = parameter_names(camera.distortion_model)
    information = np.zeros((len(names), len(names)))
    if camera.covariance is not None:
        columns = [names.index(name) for name in camera.covariance.parameters]
        information[np.ix_(columns, columns)] = covariance_of_free(camera.covariance.data)
    return information


def corner_chi2(view: StripeView, pose: BoardPose, camera: Camera, corner_px: float) -> float:
    """Robust sum of squares of a view's whitened corner residuals."""
    residual = corner_residuals(view.board, pose, camera) / corner_px
    return float(robust_weights(residual) @ residual**2)


class _Linearized(NamedTuple):
    """The steps from a state by the equations linearised there."""

    bent: tuple[int, ...]
    """Lasers whose bends are among the shared parameters."""
    shared_step: Float64[Array, "shared"]
    pose_steps: tuple[Float64[Array, "pose=6"], ...]
    decrease: float
    """By how much they are predicted to reduce the sum of squares."""


def _linearized(data: JointData, state: JointState) -> _Linearized:
    """The steps of shared parameters and poses at a state, Eqs. (3) and (4)."""
    reduced = _without_poses(data, state)
    information, gradient = _sum_of_information(reduced), np.sum([one.gradient for one in reduced], axis=0)
    planes = data.sheets
    free = np.diag(information) > 0  # a laser without stripes keeps its plane
    free[planes:] = False
    if data.bent and state.bow is not None:
        information[:planes, :planes] += np.diag(data.prior)
        gradient[:planes] -= data.prior * np.append(np.zeros(_PLANE * data.lasers), state.bow[list(data.bent)])
    if data.free_camera:
        free[planes:] = free_parameters(data.camera)
        prior = prior_information(data.camera)
        information[planes:, planes:] += prior
        gradient[planes:] += prior @ (parameters_of(data.camera) - parameters_of(state.camera))
    step = covariance_of_free(information, free) @ gradient
    return _Linearized(
        bent=data.bent,
        shared_step=step,
        pose_steps=tuple(one.own(step) for one in reduced),
        decrease=float(step @ gradient) + sum(one.own_decrease for one in reduced),
    )


def _retract(state: JointState, problem: _Linearized) -> JointState:
    """The state after the steps."""
    poses = [moved_pose(pose, step) for pose, step in zip(state.poses, problem.pose_steps, strict=True)]
    planes = _PLANE * len(state.distance_m)
    plane, bow = problem.shared_step[:planes].reshape(-1, _PLANE), state.bow  # two tilts and a distance each
    bends = planes + _BOW * len(problem.bent)
    if problem.bent and bow is not None:
        bow = bow.copy()
        bow[list(problem.bent)] += problem.shared_step[planes:bends].reshape(-1, _BOW)
    normal = np.stack([tilted(own, tilt) for own, tilt in zip(state.normal, plane[:, :2], strict=True)])
    camera_step = problem.shared_step[bends:]
    camera = camera_with(parameters_of(state.camera) + camera_step, state.camera) if camera_step.any() else state.camera
    return JointState(
        poses=tuple(poses), normal=normal, distance_m=state.distance_m + plane[:, 2], camera=camera, bow=bow
    )


def joint_information(data: JointData, state: JointState) -> Float64[Array, "shared shared"]:
    """Matrix N of Eq. (1): on the planes' parameters (three for each laser), those of bends, then the camera's.

    Priors are not included.
    """
    return _sum_of_information(_without_poses(data, state))


def _without_poses(data: JointData, state: JointState) -> list[Eliminated]:
    """The equations of each view with its pose eliminated."""
    rows = [_robust_rows(data, state, view) for view in range(len(data.views))]
    return [Eliminated.of(own[:, :_POSE], own[:, _POSE:-1], own[:, -1]) for own in rows]


def _sum_of_information(reduced: Sequence[Eliminated]) -> Float64[Array, "shared shared"]:
    """Eq. (1)."""
    return np.sum([one.information for one in reduced], axis=0)


def _robust_rows(data: JointData, state: JointState, index: int) -> Float64[Array, "row column"]:
    """The rows [P, S, r] of a view's corners and stripes, with robust weights."""
    blocks = [corner_rows(data, state, index)]
    blocks += [stripe_rows(data, index, laser, stripe) for laser, stripe in stripes_of(data, state, index)]
    return np.concatenate([np.sqrt(robust_weights(rows[:, -1]))[:, None] * rows for rows in blocks])


def corner_rows(data: JointData, state: JointState, index: int) -> Float64[Array, "row column"]:
    """Whitened rows [P, S, r] of a view's corners."""
    corners = view_equations(data.views[index].board, state.poses[index], state.camera, float(data.corner_px[index]))
    no_planes = np.zeros((len(corners.residual), data.sheets))
    return np.column_stack([corners.wrt_pose, no_planes, corners.wrt_camera, corners.residual])


def stripe_rows(data: JointData, index: int, laser: int, stripe: StripeResiduals) -> Float64[Array, "row column"]:
    """Whitened rows [P, S, r] of one laser's stripe centres."""
    wrt_planes = np.zeros((len(stripe.residual_px), data.lasers, _PLANE))
    wrt_planes[:, laser] = stripe.wrt_plane[:, :_PLANE]
    wrt_bows = np.zeros((len(stripe.residual_px), len(data.bent), _BOW))
    if laser in data.bent:
        wrt_bows[:, data.bent.index(laser)] = stripe.wrt_plane[:, _PLANE:]
    wrt_sheets = [each.reshape(len(each), -1) for each in (wrt_planes, wrt_bows) if each.size]
    columns = [-stripe.wrt_pose, *(-each for each in wrt_sheets), -stripe.wrt_camera, stripe.residual_px]
    return np.column_stack(columns) / data.center_px[index][laser]


def stripes_of(data: JointData, state: JointState, index: int) -> list[tuple[int, StripeResiduals]]:
    """Lasers that a view shows, with the residuals of their stripes.

    Residuals are computed with the estimated camera if it is free.
    """
    every = data.rays[index]
    if data.free_camera:
        every = tuple(stripe_rays(px, state.camera) for px in data.views[index].stripes_px)
    return [
        (
            laser,
            stripe_residuals(
                own,
                state.poses[index],
                state.normal[laser],
                distance_m,
                None if state.bends is None else state.bends.of(laser),
            ),
        )
        for laser, (own, distance_m) in enumerate(zip(every, state.distance_m.tolist(), strict=True))
        if len(own.ray)
    ]


def robust_weights(residual: Float64[Array, "n"]) -> Float64[Array, "n"]:
    """Huber weights; the limit grows with the scatter, so that a stripe displaced as a whole keeps all its centres."""
    return huber_weights(residual, ROBUST_SIGMAS * max(1.0, robust_std(residual)))


def joint_chi2(data: JointData, state: JointState) -> float:
    """Robust sum of squares of the corner residuals and, for each stripe, of the shift and rotation of its line.

    The scatter of single centres about the line is left out: it does not depend on boards and planes.
    """
    total = 0.0
    for index, (view, pose) in enumerate(zip(data.views, state.poses, strict=True)):
        total += corner_chi2(view, pose, state.camera, float(data.corner_px[index]))
        for laser, stripe in stripes_of(data, state, index):
            line_px = line_modes(view.stripes_px[laser]) @ stripe.residual_px / len(stripe.residual_px)
            total += len(stripe.residual_px) * float(line_px @ line_px) / data.center_px[index][laser] ** 2
    return total
