"""Bundle adjustment of the intrinsic parameters and the board poses for given corners (ringpose-method(7), section 7).

Views share no pose, so that the poses can be eliminated view by view. With J_c and J_p a view's derivatives with
respect to camera and pose, its information about the camera is the Schur complement
J_c^T J_c - J_c^T J_p (J_p^T J_p)^-1 J_p^T J_c (`Eliminated`). Information and gradient of each view are kept, because
cross-validation needs them.

`scipy.optimize.least_squares` solves the dense system of camera and all poses instead, and gives neither. For 15 views
of 70 corners it finds the same camera (to 5e-6 standard deviations) in 62 ms (`lm`) or 76 ms (`trf`) instead of 29, and
a calibration with them solves this system 80 times.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from ringpose.calibrate.boards.corner_errors import (
    moderated_variances,
    view_equations,
    without_distortion_bias,
)
from ringpose.calibrate.boards.pose import board_pose, moved_pose
from ringpose.calibrate.camera.parameters import CameraModel, camera_with, parameters_of
from ringpose.errors import DataError
from ringpose.geometry.least_squares import Eliminated, covariance_of_free, damped_step, gauss_newton
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.rig import DISTORTION_COEFFICIENTS, Camera

MIN_VIEWS = 3
"""Two views of a plane give four equations for the four parameters of the pinhole, and none to check them."""

_OPENCV_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)

_REWEIGHTINGS = 2

_MAX_ITERATIONS = 10

_DAMPINGS = (0.0, 1e-6, 1e-4, 1e-2)
"""Levenberg-Marquardt dampings, tried in turn until chi-squared falls."""

_MIN_STEP = 1e-6
"""Squared Mahalanobis length of a step of camera and poses below which the iteration has converged."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraSolution:
    """Camera, board poses and accuracy of the corners."""

    camera: Camera
    poses: tuple[BoardPose, ...]
    view_sigma_px: Float64[Array, "view"]
    """Standard deviation of one coordinate of a corner, by view."""
    sigma_px: float
    """Standard deviation of one coordinate of a corner, from all views together."""
    information: Float64[Array, "view parameter parameter"]
    """Information (normal matrix) of each view about the camera's parameters, its pose marginalised out."""
    gradient: Float64[Array, "view parameter"]
    """Each view's part of the right-hand side of the normal equations; their sum over all views is zero."""


def blank_camera(camera_name: str, image_width: int, image_height: int, model: CameraModel) -> Camera:
    """A camera without start values, marked by a focal length of 1 px."""
    return Camera(
        camera_name=camera_name,
        image_width=image_width,
        image_height=image_height,
        camera_matrix=np.eye(3),
        distortion_model=model.distortion_model,
        distortion_coefficients=np.zeros(DISTORTION_COEFFICIENTS[model.distortion_model]),
    )


def camera_solution(
    views: Sequence[BoardView], start: Camera, model: CameraModel, poses: Sequence[BoardPose] = ()
) -> CameraSolution:
    """Maximum-likelihood camera and board poses.

    Each view is weighted by its own standard deviation, and corners of a marker by the covariance of their errors.
    Start values are the given camera, or, if it is blank, OpenCV's bundle adjustment with equal, independent corners;
    and the given board poses, or those with the minimum reprojection error.
    """
    if len(views) < MIN_VIEWS:
        finding = f"{len(views)} view{'s' * (len(views) != 1)} of the board, at least {MIN_VIEWS} are needed"
        raise undetermined(finding, "; ten or more are good")
    camera = start if start.camera_matrix[0, 0] > 1 else _opencv_camera(views, start, model)
    poses = poses or [board_pose(without_distortion_bias(view, camera), camera) for view in views]
    sigma_px = np.ones(len(views))
    for _ in range(2 + _REWEIGHTINGS):
        corrected = [without_distortion_bias(view, camera) for view in views]
        try:
            solution = _adjusted(corrected, camera, poses, model, sigma_px)
        except np.linalg.LinAlgError:  # as of views of which few corners, or wrong ones, are seen
            raise undetermined("the equations have no solution") from None
        camera, poses, sigma_px = solution.camera, solution.poses, solution.view_sigma_px
    return solution


def _opencv_camera(views: Sequence[BoardView], start: Camera, model: CameraModel) -> Camera:
    """The camera by OpenCV's bundle adjustment from the views' homographies, with corners in single precision."""
    try:
        _, matrix, coefficients, _, _ = cv2.calibrateCamera(
            [view.points_board_m.astype(np.float32) for view in views],
            [view.points_px.astype(np.float32) for view in views],
            (start.image_width, start.image_height),
            start.camera_matrix.copy(),
            start.distortion_coefficients.copy(),
            flags=model.flags,
            criteria=_OPENCV_CRITERIA,
        )
    except cv2.error as error:
        raise undetermined("the equations have no solution") from error
    count = len(start.distortion_coefficients)
    return replace(
        start,
        camera_matrix=np.asarray(matrix, dtype=np.float64),
        distortion_coefficients=np.asarray(coefficients, dtype=np.float64).ravel()[:count],
        covariance=None,
    )


def undetermined(finding: str, remark: str = "") -> DataError:
    """The error to raise if views do not determine the camera; the remark is added to the remedy."""
    remedy = f"add views with the board tilted by 20 to 40 degrees to different sides{remark}"
    return DataError("calibrate-camera", finding, remedy)


class _State(NamedTuple):
    """Camera and poses of one iteration, and the equations linearised there."""

    camera: Camera
    poses: Sequence[BoardPose]
    reduced: list[Eliminated]
    information: Float64[Array, "view parameter parameter"]
    gradient: Float64[Array, "view parameter"]
    squares: Float64[Array, "view"]
    """Each view's part of chi-squared."""
    decrease: float
    """By how much an undamped step is predicted to reduce chi-squared."""


def _adjusted(
    views: Sequence[BoardView],
    camera: Camera,
    poses: Sequence[BoardPose],
    model: CameraModel,
    sigma_px: Float64[Array, "view"],
) -> CameraSolution:
    """Solution for given standard deviations by Gauss-Newton, damped where a full step would increase chi-squared."""

    def linearised(poses: Sequence[BoardPose], camera: Camera) -> _State:
        several = zip(views, poses, sigma_px.tolist(), strict=True)
        equations = [view_equations(view, pose, camera, sigma) for view, pose, sigma in several]
        reduced = [one.without_pose() for one in equations]
        information = np.array([one.information for one in reduced])
        gradient = np.array([one.gradient for one in reduced])
        step = damped_step(information.sum(axis=0), gradient.sum(axis=0), model.free, 0.0)
        return _State(
            camera=camera,
            poses=poses,
            reduced=reduced,
            information=information,
            gradient=gradient,
            squares=np.array([one.residual @ one.residual for one in equations]),
            decrease=float(gradient.sum(axis=0) @ step) + sum(one.own_decrease for one in reduced),
        )

    def moved(state: _State, damping: float) -> _State:
        step = damped_step(state.information.sum(axis=0), state.gradient.sum(axis=0), model.free, damping)
        poses = [moved_pose(pose, one.own(step)) for pose, one in zip(state.poses, state.reduced, strict=True)]
        return linearised(poses, camera_with(parameters_of(state.camera) + step, state.camera))

    def retract(state: _State, _: _State) -> _State:
        others = (moved(state, damping) for damping in _DAMPINGS)
        return next((other for other in others if other.squares.sum() < state.squares.sum()), state)

    state, _ = gauss_newton(lambda state: state, retract, linearised(poses, camera), _MAX_ITERATIONS, _MIN_STEP)
    return _solution(state, model, sigma_px)


def _solution(state: _State, model: CameraModel, sigma_px: Float64[Array, "view"]) -> CameraSolution:
    """The final state, with the views' standard deviations estimated from its residuals (variance components)."""
    covariance = covariance_of_free(state.information.sum(axis=0), model.free)
    camera_parameters = np.einsum("ij,vji->v", covariance, state.information)  # each view's share; they add up to all
    squares = state.squares * sigma_px**2
    rows = np.array([float(len(one.residual)) for one in state.reduced])
    degrees_of_freedom = np.maximum(rows - 6 - camera_parameters, 1.0)
    common = squares.sum() / degrees_of_freedom.sum()
    variances = np.full(len(rows), common) if model.keep_all else moderated_variances(squares, degrees_of_freedom)
    return CameraSolution(
        camera=state.camera,
        poses=tuple(state.poses),
        view_sigma_px=np.sqrt(variances),
        sigma_px=float(np.sqrt(common)),
        information=state.information,
        gradient=state.gradient,
    )


def corners_of(view: BoardView, used: Bool[Array, "corner"]) -> BoardView:
    """The view reduced to the corners of a mask."""
    return replace(view, ids=view.ids[used], points_board_m=view.points_board_m[used], points_px=view.points_px[used])
