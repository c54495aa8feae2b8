"""Intrinsic parameters by least squares over given corners, none of them doubted (ringpose-method(7), section 7).

The linear equations that one view gives for a camera, and what is left of them without its pose.

Views share no pose, so what they say of the camera is a sum over the views: with J_c and J_p the derivatives by camera
and pose, J_c^T J_c - J_c^T J_p (J_p^T J_p)^-1 J_p^T J_c of each.
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

MINIMUM_VIEWS = 3
"""Two views of a plane give four equations for the four parameters of the pinhole, and none to check them by."""

_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)

_REWEIGHTINGS = 2

_STEPS = 10

_DAMPINGS = (0.0, 1e-6, 1e-4, 1e-2)

_SETTLED = 1e-6
"""Squared, in standard deviations: a step of less changes nothing."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraSolution:
    """A camera, the board's poses, and how exact the corners are."""

    camera: Camera
    poses: tuple[BoardPose, ...]
    view_sigma_px: Float64[Array, "view"]
    """Standard deviation of one coordinate of a corner, by view."""
    sigma_px: float
    """The same of all views."""
    parts: Float64[Array, "view parameter parameter"]
    """Information of each view about the camera's parameters, its pose marginalised out."""
    scores: Float64[Array, "view parameter"]
    """Each view's part of the right side of the normal equations; those of all views cancel."""


def blank_camera(camera_name: str, image_width: int, image_height: int, model: CameraModel) -> Camera:
    """A camera of which nothing is known but its images' size: its focal length is 1 px."""
    return Camera(
        camera_name=camera_name,
        image_width=image_width,
        image_height=image_height,
        camera_matrix=np.eye(3),
        distortion_model=model.distortion_model,
        distortion_coefficients=np.zeros(DISTORTION_COEFFICIENTS[model.distortion_model]),
    )


def camera_solution(views: Sequence[BoardView], start: Camera, model: CameraModel) -> CameraSolution:
    """The camera and the board's poses that make the corners likeliest.

    Each view counts by its own standard deviation, and a marker's corners by what their errors have in common.
    It starts from the camera given, or, if that is blank, from OpenCV's bundle adjustment, which takes all corners for
    equally exact and independent.
    """
    require_views(len(views))
    camera = start if start.camera_matrix[0, 0] > 1 else _equal_corners(views, start, model)
    sigma_px = np.ones(len(views))
    for _ in range(1 + _REWEIGHTINGS):
        seen = [without_distortion_bias(view, camera) for view in views]
        solution = _settled(seen, camera, model, sigma_px)
        camera, sigma_px = solution.camera, solution.view_sigma_px
    return _settled([without_distortion_bias(view, camera) for view in views], camera, model, sigma_px)


def _equal_corners(views: Sequence[BoardView], start: Camera, model: CameraModel) -> Camera:
    """OpenCV's bundle adjustment, from the homographies of the views; it takes corners in single precision."""
    try:
        _, matrix, coefficients, _, _ = cv2.calibrateCamera(
            [view.points_board_m.astype(np.float32) for view in views],
            [view.points_px.astype(np.float32) for view in views],
            (start.image_width, start.image_height),
            start.camera_matrix.copy(),
            start.distortion_coefficients.copy(),
            flags=model.flags,
            criteria=_CRITERIA,
        )
    except cv2.error as error:
        raise undetermined("the equations have no solution") from error
    return replace(
        start,
        camera_matrix=np.asarray(matrix, dtype=np.float64),
        distortion_coefficients=np.asarray(coefficients, dtype=np.float64).ravel()[
            : len(start.distortion_coefficients)
        ],
        covariance=None,
    )


def _settled(
    views: Sequence[BoardView], camera: Camera, model: CameraModel, sigma_px: Float64[Array, "view"]
) -> CameraSolution:
    """Gauss-Newton's steps until they are small against what noise does."""
    state = _state(views, [board_pose(view, camera) for view in views], camera, sigma_px)
    for _ in range(_STEPS):
        information, score = state.parts.sum(axis=0), state.scores.sum(axis=0)
        expected = score @ damped_step(information, score, model.free, 0.0)
        lower = (_moved(state, views, model, sigma_px, damping) for damping in _DAMPINGS) if expected > _SETTLED else ()
        better = next((other for other in lower if other.cost < state.cost), None)
        if better is None:
            break
        state = better
    return _solution(state, model, sigma_px)


class ViewEquations(NamedTuple):
    """A view's linear equations, one row for each coordinate of a corner, of independent errors of unit variance."""

    by_pose: Float64[Array, "row pose=6"]
    by_camera: Float64[Array, "row parameter"]
    residual: Float64[Array, "row"]

    def without_pose(self) -> tuple[Float64[Array, "row parameter"], Float64[Array, "row"]]:
        """Derivatives by the camera and residuals, less what the pose can take up."""
        orthogonal, _ = np.linalg.qr(self.by_pose)
        by_camera = self.by_camera - orthogonal @ (orthogonal.T @ self.by_camera)
        return by_camera, self.residual - orthogonal @ (orthogonal.T @ self.residual)

    def pose_step(self, step: Float64[Array, "parameter"]) -> Float64[Array, "pose=6"]:
        """What the pose does when the camera's parameters take a step."""
        moved: Float64[Array, "pose=6"] = np.linalg.lstsq(self.by_pose, self.residual - self.by_camera @ step)[0]
        return moved


class _State(NamedTuple):
    """Camera and poses, and the equations there."""

    camera: Camera
    poses: list[BoardPose]
    equations: list[ViewEquations]
    parts: Float64[Array, "view parameter parameter"]
    scores: Float64[Array, "view parameter"]
    cost: float


def _state(
    views: Sequence[BoardView], poses: list[BoardPose], camera: Camera, sigma_px: Float64[Array, "view"]
) -> _State:
    several = zip(views, poses, sigma_px.tolist(), strict=True)
    equations = [view_equations(view, pose, camera, sigma) for view, pose, sigma in several]
    alone = [one.without_pose() for one in equations]
    return _State(
        camera=camera,
        poses=poses,
        equations=equations,
        parts=np.array([by_camera.T @ by_camera for by_camera, _ in alone]),
        scores=np.array([by_camera.T @ residual for by_camera, residual in alone]),
        cost=sum(float(one.residual @ one.residual) for one in equations),
    )


def _moved(
    state: _State, views: Sequence[BoardView], model: CameraModel, sigma_px: Float64[Array, "view"], damping: float
) -> _State:
    step = damped_step(state.parts.sum(axis=0), state.scores.sum(axis=0), model.free, damping)
    poses = [moved_pose(pose, one.pose_step(step)) for pose, one in zip(state.poses, state.equations, strict=True)]
    return _state(views, poses, camera_with(parameters_of(state.camera) + step, state.camera), sigma_px)


def _solution(state: _State, model: CameraModel, sigma_px: Float64[Array, "view"]) -> CameraSolution:
    """With the standard deviations that the residuals ask for."""
    covariance = covariance_of_free(state.parts.sum(axis=0), model.free)
    taken = np.einsum("ij,vji->v", covariance, state.parts)
    squares = np.array([one.residual @ one.residual for one in state.equations]) * sigma_px**2
    freedom = np.array([float(len(one.residual)) for one in state.equations]) - 6 - taken
    freedom = np.maximum(freedom, 1.0)
    common = squares.sum() / freedom.sum()
    variances = np.full(len(freedom), common) if model.keep_all else moderated_variances(squares, freedom)
    return CameraSolution(
        camera=state.camera,
        poses=tuple(state.poses),
        view_sigma_px=np.sqrt(variances),
        sigma_px=float(np.sqrt(common)),
        parts=state.parts,
        scores=state.scores,
    )


def corners_of(view: BoardView, used: Bool[Array, "corner"]) -> BoardView:
    """The view with these of its corners alone."""
    return replace(view, ids=view.ids[used], points_board_m=view.points_board_m[used], points_px=view.points_px[used])


def require_views(views: int) -> None:
    """Refuse fewer views than determine anything."""
    if views < MINIMUM_VIEWS:
        raise DataError(
            "calibrate-camera",
            f"{views} view{'s' * (views != 1)} of the board, at least {MINIMUM_VIEWS} are needed",
            "add views with the board tilted by 20 to 40 degrees to different sides; ten or more are good",
        )


def undetermined(found: str) -> DataError:
    """The error of views that leave the camera open."""
    return DataError(
        "calibrate-camera", found, "add views with the board tilted by 20 to 40 degrees to different sides"
    )


def view_equations(view: BoardView, pose: BoardPose, camera: Camera, sigma_px: float) -> ViewEquations:
    """Of a view whose corners have this standard deviation in each coordinate."""
    by_pose, by_camera = projection_jacobians(view.points_board_m, pose, camera)
    residual_px = residuals(view, pose, camera)[..., None]
    rows = np.concatenate([by_pose, by_camera, residual_px], axis=-1).reshape(2 * len(by_pose), -1)
    rows = whiten(rows, view) / sigma_px
    return ViewEquations(by_pose=rows[:, :6], by_camera=rows[:, 6:-1], residual=rows[:, -1])
