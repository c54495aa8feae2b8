"""Bundle adjustment of the intrinsic parameters and the board poses for given corners (ringpose-method(7), section 7).

Views share no pose, so that the poses can be eliminated view by view. With J_c and J_p a view's derivatives with
respect to camera and pose, its information about the camera is the Schur complement
J_c^T J_c - J_c^T J_p (J_p^T J_p)^-1 J_p^T J_c. Information and right-hand side of each view are kept, because
cross-validation needs them. `scipy.optimize.least_squares` would solve the dense system of camera and all poses
instead, and would give neither.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np

from ringpose.calibrate.boards.corner_errors import moderated_variances, whiten
from ringpose.calibrate.boards.pose import board_pose, moved_pose, residuals
from ringpose.calibrate.camera.distortion_bias import without_distortion_bias
from ringpose.calibrate.camera.parameters import (
    CameraModel,
    camera_with,
    covariance_of_free,
    damped_step,
    parameters_of,
    projection_jacobians,
)
from ringpose.errors import DataError
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.camera import DISTORTION_COEFFICIENTS, Camera

MIN_VIEWS = 3
"""Two views of a plane give four equations for the four parameters of the pinhole, and none to check them."""

_OPENCV_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)

_REWEIGHTINGS = 2

_MAX_ITERATIONS = 10

_DAMPINGS = (0.0, 1e-6, 1e-4, 1e-2)
"""Levenberg-Marquardt dampings, tried in turn until the penalty falls."""

_MIN_STEP = 1e-6
"""Squared Mahalanobis length of a step below which the iteration has converged."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraSolution:
    """Camera, board poses and accuracy of the corners."""

    camera: Camera
    poses: tuple[BoardPose, ...]
    view_sigma_px: Float64[Array, "view"]
    """Standard deviation of one coordinate of a corner, by view."""
    sigma_px: float
    """The same of all views."""
    parts: Float64[Array, "view parameter parameter"]
    """Information of each view about the camera's parameters, its pose marginalised out."""
    scores: Float64[Array, "view parameter"]
    """Each view's part of the right-hand side of the normal equations; their sum over all views is zero."""


class ViewEquations(NamedTuple):
    """Linearised equations of a view, one row per corner coordinate, with independent errors of unit variance."""

    by_pose: Float64[Array, "row pose=6"]
    by_camera: Float64[Array, "row parameter"]
    residual: Float64[Array, "row"]

    def without_pose(self) -> tuple[Float64[Array, "row parameter"], Float64[Array, "row"]]:
        """Camera Jacobian and residuals, projected onto the complement of the pose Jacobian's column space."""
        orthogonal, _ = np.linalg.qr(self.by_pose)
        by_camera = self.by_camera - orthogonal @ (orthogonal.T @ self.by_camera)
        return by_camera, self.residual - orthogonal @ (orthogonal.T @ self.residual)

    def pose_step(self, step: Float64[Array, "parameter"]) -> Float64[Array, "pose=6"]:
        """Step of the pose for a step of the camera's parameters (back-substitution)."""
        pose_step: Float64[Array, "pose=6"] = np.linalg.lstsq(self.by_pose, self.residual - self.by_camera @ step)[0]
        return pose_step


def blank_camera(camera_name: str, image_width: int, image_height: int, model: CameraModel) -> Camera:
    """A camera without start values: its focal length is 1 px."""
    return Camera(
        camera_name=camera_name,
        image_width=image_width,
        image_height=image_height,
        camera_matrix=np.eye(3),
        distortion_model=model.distortion_model,
        distortion_coefficients=np.zeros(DISTORTION_COEFFICIENTS[model.distortion_model]),
    )


def camera_solution(views: Sequence[BoardView], start: Camera, model: CameraModel) -> CameraSolution:
    """Maximum-likelihood camera and board poses.

    Each view is weighted by its own standard deviation, and corners of a marker by the covariance of their errors.
    Start values are the given camera, or, if it is blank, OpenCV's bundle adjustment with equal, independent corners.
    """
    require_views(len(views))
    camera = start if start.camera_matrix[0, 0] > 1 else _opencv_camera(views, start, model)
    sigma_px = np.ones(len(views))
    for _ in range(1 + _REWEIGHTINGS):
        corrected = [without_distortion_bias(view, camera) for view in views]
        solution = _adjusted(corrected, camera, model, sigma_px)
        camera, sigma_px = solution.camera, solution.view_sigma_px
    return _adjusted([without_distortion_bias(view, camera) for view in views], camera, model, sigma_px)


def require_views(views: int) -> None:
    """Reject fewer views than the parameters need."""
    if views < MIN_VIEWS:
        raise DataError(
            "calibrate-camera",
            f"{views} view{'s' * (views != 1)} of the board, at least {MIN_VIEWS} are needed",
            "add views with the board tilted by 20 to 40 degrees to different sides; ten or more are good",
        )


def _opencv_camera(views: Sequence[BoardView], start: Camera, model: CameraModel) -> Camera:
    """OpenCV's bundle adjustment, started from the views' homographies; its corners have single precision."""
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


def undetermined(found: str) -> DataError:
    """The error for views that do not determine the camera."""
    return DataError(
        "calibrate-camera", found, "add views with the board tilted by 20 to 40 degrees to different sides"
    )


class _State(NamedTuple):
    """Camera and poses of one iteration, and the equations linearised there."""

    camera: Camera
    poses: list[BoardPose]
    equations: list[ViewEquations]
    parts: Float64[Array, "view parameter parameter"]
    scores: Float64[Array, "view parameter"]
    chi2: float


def _adjusted(
    views: Sequence[BoardView], camera: Camera, model: CameraModel, sigma_px: Float64[Array, "view"]
) -> CameraSolution:
    """Gauss-Newton, damped where a full step would increase chi-squared, until steps are small against the noise."""
    state = _linearised(views, [board_pose(view, camera) for view in views], camera, sigma_px)
    for _ in range(_MAX_ITERATIONS):
        information, score = state.parts.sum(axis=0), state.scores.sum(axis=0)
        if score @ damped_step(information, score, model.free, 0.0) <= _MIN_STEP:
            break
        steps = (_stepped(state, views, model, sigma_px, damping) for damping in _DAMPINGS)
        better = next((other for other in steps if other.chi2 < state.chi2), None)
        if better is None:
            break
        state = better
    return _solution(state, model, sigma_px)


def _linearised(
    views: Sequence[BoardView], poses: list[BoardPose], camera: Camera, sigma_px: Float64[Array, "view"]
) -> _State:
    several = zip(views, poses, sigma_px.tolist(), strict=True)
    equations = [view_equations(view, pose, camera, sigma) for view, pose, sigma in several]
    reduced = [one.without_pose() for one in equations]
    return _State(
        camera=camera,
        poses=poses,
        equations=equations,
        parts=np.array([by_camera.T @ by_camera for by_camera, _ in reduced]),
        scores=np.array([by_camera.T @ residual for by_camera, residual in reduced]),
        chi2=sum(float(one.residual @ one.residual) for one in equations),
    )


def view_equations(view: BoardView, pose: BoardPose, camera: Camera, sigma_px: float) -> ViewEquations:
    """The equations of a view whose corner coordinates have this standard deviation, decorrelated."""
    by_pose, by_camera = projection_jacobians(view.points_board_m, pose, camera)
    residual_px = residuals(view, pose, camera)[..., None]
    rows = np.concatenate([by_pose, by_camera, residual_px], axis=-1).reshape(2 * len(by_pose), -1)
    rows = whiten(rows, view) / sigma_px
    return ViewEquations(by_pose=rows[:, :6], by_camera=rows[:, 6:-1], residual=rows[:, -1])


def _stepped(
    state: _State, views: Sequence[BoardView], model: CameraModel, sigma_px: Float64[Array, "view"], damping: float
) -> _State:
    step = damped_step(state.parts.sum(axis=0), state.scores.sum(axis=0), model.free, damping)
    poses = [moved_pose(pose, one.pose_step(step)) for pose, one in zip(state.poses, state.equations, strict=True)]
    return _linearised(views, poses, camera_with(parameters_of(state.camera) + step, state.camera), sigma_px)


def _solution(state: _State, model: CameraModel, sigma_px: Float64[Array, "view"]) -> CameraSolution:
    """The solution with the views' standard deviations re-estimated (variance components)."""
    covariance = covariance_of_free(state.parts.sum(axis=0), model.free)
    camera_parameters = np.einsum("ij,vji->v", covariance, state.parts)  # each view's part; they add up to all
    squares = np.array([one.residual @ one.residual for one in state.equations]) * sigma_px**2
    rows = np.array([float(len(one.residual)) for one in state.equations])
    degrees_of_freedom = np.maximum(rows - 6 - camera_parameters, 1.0)
    common = squares.sum() / degrees_of_freedom.sum()
    variances = np.full(len(rows), common) if model.keep_all else moderated_variances(squares, degrees_of_freedom)
    return CameraSolution(
        camera=state.camera,
        poses=tuple(state.poses),
        view_sigma_px=np.sqrt(variances),
        sigma_px=float(np.sqrt(common)),
        parts=state.parts,
        scores=state.scores,
    )


def corners_of(view: BoardView, used: Bool[Array, "corner"]) -> BoardView:
    """The view reduced to the corners of a mask."""
    return replace(view, ids=view.ids[used], points_board_m=view.points_board_m[used], points_px=view.points_px[used])
