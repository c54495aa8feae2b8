"""Cross-validation, projection uncertainty and model comparison of cameras (ringpose-method(7), section 7).

Cameras are compared by the displacement of their projections over the image. A rotation of the camera frame displaces
all pixels in common, as a shift of the principal point does, and has no effect on anything calibrated with the same
camera. The rotation that minimises the displacements in the middle of the image is therefore removed first. The
image's corners are excluded from that fit, because distortion not determined by any view would rotate the frame.
"""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from ringpose.calibrate.boards.pose import board_pose, projection
from ringpose.calibrate.camera.bundle_adjustment import (
    MIN_VIEWS,
    CameraSolution,
    blank_camera,
    camera_solution,
    corners_of,
)
from ringpose.calibrate.camera.parameters import CameraModel, camera_with, parameters_of
from ringpose.errors import DataError
from ringpose.geometry.least_squares import Rows, covariance_of_free, gauss_newton
from ringpose.geometry.rays import project, rays
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.calibration import (
    CameraCalibration,
    LeftOutView,
    ModelComparison,
    ModelFit,
)
from ringpose.types.options import DistortionModel
from ringpose.types.rig import DISTORTION_COEFFICIENTS, Camera

MAX_SOLVED = 20
"""Above this number of views, leave-one-out cameras are computed by one Gauss-Newton step; solving again takes 1 s for
each of 60 views."""

MAP_COLUMNS = 17
"""Points along a row of the map; distortion is smooth between them."""

MIDDLE_SHARE = 0.7
"""Share of the image's width and height in which the rotation between two cameras is fitted."""

_EXACT_PX = 1e-6
"""Lower limit of an expected displacement."""

_ROTATION_ITERATIONS = 3

_CAMERA_POSE = BoardPose(name="", rotation=np.eye(3), translation_m=np.zeros(3), residual_rms_px=0.0)
"""Pose of points that are given in the camera frame."""

MapValues = Float64[Array, "map_row map_column"]
"""One value for each point of the map (`map_points_px`), at which cameras are compared."""


def used_views(calibration: CameraCalibration) -> list[BoardView]:
    """The used views with the used corners of a calibration."""
    return [corners_of(view.board, ~view.left_out) for view in calibration.used]


def leave_one_out(
    used: Sequence[BoardView], whole: CameraSolution, model: CameraModel
) -> tuple[tuple[LeftOutView, ...], MapValues]:
    """Results of leaving out each view in turn, and the projection uncertainty that they show (jackknife).

    The uncertainty includes the errors that the corners of a view have in common. With too few views, there are no
    results and the uncertainty is NaN.
    """
    others = cameras_without_one(used, whole, model)
    unknown = np.full(map_points_px(whole.camera).shape[:2], np.nan)
    shifts = [unknown if other is None else displacement_px(whole.camera, other) for other in others]
    left_out = tuple(
        LeftOutView(name=view.name, shift_px=float(np.median(shift)), rms_px=held_out_rms_px(view, other))
        for view, other, shift in zip(used, others, shifts, strict=False)
    )
    return left_out, _jackknife_px(shifts, whole, model) if shifts else unknown


def split_halves(used: Sequence[BoardView], whole: CameraSolution, model: CameraModel) -> tuple[Camera, Camera] | None:
    """The cameras of the odd and the even views; None if a half does not determine a camera.

    Neighbours in a series are similar, so that every other one belongs to the same half.
    """
    odd, even = (_camera(used[first::2], whole.camera, model, whole.poses[first::2]) for first in (0, 1))
    return None if odd is None or even is None else (odd, even)


def cameras_without_one(used: Sequence[BoardView], whole: CameraSolution, model: CameraModel) -> list[Camera | None]:
    """Leave-one-out cameras, one for each view; empty if there are too few views, None where they are undetermined."""
    if len(used) <= MIN_VIEWS:
        return []
    if len(used) > MAX_SOLVED:
        return list(cameras_one_step_away(whole, model))
    others = [[other for other in range(len(used)) if other != index] for index in range(len(used))]
    return [_camera([used[i] for i in kept], whole.camera, model, [whole.poses[i] for i in kept]) for kept in others]


def cameras_one_step_away(whole: CameraSolution, model: CameraModel) -> list[Camera]:
    """Leave-one-out cameras, each by one Gauss-Newton step from the camera of all views.

    One step is sufficient where there are many views, each of which has little weight.
    """
    information, gradient = whole.information.sum(axis=0), whole.gradient.sum(axis=0)
    steps = [
        covariance_of_free(information - own_information, model.free) @ (gradient - own_gradient)
        for own_information, own_gradient in zip(whole.information, whole.gradient, strict=True)
    ]
    return [camera_with(parameters_of(whole.camera) + step, whole.camera) for step in steps]


def held_out_rms_px(view: BoardView, others: Camera | None) -> float:
    """Rms residual of a view's corners with the camera of the other views, only its pose fitted; NaN without camera."""
    return float("nan") if others is None else board_pose(view, others).residual_rms_px


def _camera(views: Sequence[BoardView], start: Camera, model: CameraModel, poses: Sequence[BoardPose]) -> Camera | None:
    """The camera of some of the views, started from this camera and these poses; None if they do not determine it."""
    try:
        return camera_solution(views, start, model, poses).camera
    except DataError:
        return None


def _jackknife_px(shifts: Sequence[MapValues], whole: CameraSolution, model: CameraModel) -> MapValues:
    """The projection uncertainty, scaled by the ratio of the leave-one-out shifts to those expected from noise.

    Views are independent even where their corners are not. A leave-one-out camera is that of all views plus an
    independent error, so that its expected shift has the difference of the two covariances.
    """
    information = whole.information.sum(axis=0)
    covariance = covariance_of_free(information, model.free)
    changes = [covariance_of_free(information - own, model.free) - covariance for own in whole.information]
    expected = [projection_sigma_px(whole.camera, change) for change in changes]
    ratio = np.sum(np.square(shifts), axis=0) / np.maximum(np.sum(np.square(expected), axis=0), _EXACT_PX**2)
    return np.sqrt(ratio) * projection_sigma_px(whole.camera, covariance)


def model_comparison(used: Sequence[BoardView], whole: CameraSolution, model: CameraModel) -> ModelComparison:
    """Rms of both distortion models on the same views, and the displacement between their cameras where both are known.

    More coefficients always reduce the rms. Whether they describe the lens or the noise is decided by held-out views:
    the larger model is better only if their rms falls as well.
    """
    other_name = next(name for name in DISTORTION_COEFFICIENTS if name != model.distortion_model)
    other_model = replace(model, distortion_model=other_name)
    camera = whole.camera
    blank = blank_camera(camera.camera_name, camera.image_width, camera.image_height, other_model)
    other = camera_solution(used, blank, other_model)
    corners_px = np.concatenate([view.points_px for view in used])
    known = known_lens(camera, corners_px) & known_lens(other.camera, corners_px)
    return ModelComparison(
        fits=(_fit(used, whole, model), _fit(used, other, other_model)),
        difference_px=np.where(known, displacement_px(camera, other.camera), np.nan),
    )


def _fit(used: Sequence[BoardView], whole: CameraSolution, model: CameraModel) -> ModelFit:
    """A distortion model's rms over all corners, by the camera of all views and by leave-one-out cameras."""
    without_one = cameras_without_one(used, whole, model) or [None] * len(used)
    own_px = [board_pose(view, whole.camera).residual_rms_px for view in used]
    held_out_px = [held_out_rms_px(view, others) for view, others in zip(used, without_one, strict=True)]
    corners = [len(view.ids) for view in used]
    return ModelFit(
        distortion_model=model.distortion_model,
        parameters=int(model.free.sum()),
        rms_px=float(np.sqrt(np.average(np.square(own_px), weights=corners))),
        held_out_rms_px=float(np.sqrt(np.average(np.square(held_out_px), weights=corners))),
    )


def map_points_px(camera: Camera) -> Float64[Array, "map_row map_column xy=2"]:
    """Grid of pixels over the whole image, with about the same spacing in both directions."""
    width, height = camera.image_width - 1.0, camera.image_height - 1.0
    rows = max(round((MAP_COLUMNS - 1) * height / max(width, 1.0)) + 1, 2)
    row, column = np.meshgrid(np.linspace(0, height, rows), np.linspace(0, width, MAP_COLUMNS), indexing="ij")
    return np.stack([column, row], axis=-1)


def displacement_px(one: Camera, other: Camera) -> MapValues:
    """Displacement between the projections of a ray in two cameras, at each pixel of the first; NaN if not visible."""
    map_px, middle = map_points_px(one), _middle_points(one)[:, None]

    def offset_px(directions: Float64[Array, "n xyz=3"]) -> Float64[Array, "n xy=2"]:
        return project(directions, other) - map_px.reshape(-1, 2)

    def linearize(directions: Float64[Array, "n xyz=3"]) -> Rows:
        wrt_rotation = projection(directions, _CAMERA_POSE, other)[1][..., :3]
        return Rows.of((middle * offset_px(directions)).ravel(), (middle[..., None] * wrt_rotation).reshape(-1, 3))

    def retract(directions: Float64[Array, "n xyz=3"], problem: Rows) -> Float64[Array, "n xyz=3"]:
        return directions @ np.asarray(cv2.Rodrigues(problem.step)[0], dtype=np.float64).T

    directions, _ = gauss_newton(linearize, retract, rays(map_px, one).reshape(-1, 3), _ROTATION_ITERATIONS)
    return np.linalg.norm(offset_px(directions), axis=-1).reshape(map_px.shape[:2])


def projection_sigma_px(camera: Camera, covariance: Float64[Array, "parameter parameter"]) -> MapValues:
    """Rms displacement of the projection by errors of the intrinsic parameters with this covariance.

    The rotation of the camera frame that compensates each parameter's error best in the middle of the image is removed.
    """
    map_px, middle = map_points_px(camera), _middle_points(camera)
    directions = rays(map_px, camera).reshape(-1, 3)
    _, wrt_pose, wrt_parameter = projection(directions, _CAMERA_POSE, camera)
    wrt_rotation = wrt_pose[..., :3]
    rotation = np.linalg.lstsq(
        wrt_rotation[middle].reshape(-1, 3), wrt_parameter[middle].reshape(-1, wrt_parameter.shape[-1])
    )[0]
    remaining = wrt_parameter - wrt_rotation @ rotation
    variance = np.einsum("pci,ij,pcj->p", remaining, covariance, remaining)
    return np.sqrt(np.maximum(variance, 0.0)).reshape(map_px.shape[:2])


def _middle_points(camera: Camera) -> Bool[Array, "n"]:
    """Which points of the map, row by row, are in the middle of the image."""
    rows, columns = map_points_px(camera).shape[:2]
    row, column = (np.abs(np.linspace(-1, 1, count)) <= MIDDLE_SHARE for count in (rows, columns))
    return np.outer(row, column).ravel()


def known_lens(camera: Camera, corners_px: Float64[Array, "corner xy=2"]) -> Bool[Array, "map_row map_column"]:
    """True at the map's points where the camera's covariance is a valid measure of the projection error.

    For the polynomial models it is valid everywhere. For the rational model it is valid only up to the largest distance
    of a corner from the principal point: a quotient of polynomials can have a pole beyond.
    """
    map_px = map_points_px(camera)
    if camera.distortion_model != DistortionModel.RATIONAL_POLYNOMIAL:
        return np.ones(map_px.shape[:2], dtype=bool)
    middle, focal = camera.camera_matrix[:2, 2], np.diag(camera.camera_matrix)[:2]
    radius, reached = (np.linalg.norm((points - middle) / focal, axis=-1) for points in (map_px, corners_px))
    return radius <= max(float(reached.max()), float(radius.min()))


def radial_stretch_sd(camera: Camera) -> float:
    """Standard deviation of the radial stretch in the corner of the image farthest from the principal point.

    The stretch is the derivative of the distorted by the undistorted radius, 1 + 3 k1 r^2 + 5 k2 r^4 + 7 k3 r^6: it is
    1 without distortion, and an image is folded where it is 0. Zero for the rational model (`known_lens`).
    """
    if camera.covariance is None or camera.distortion_model == DistortionModel.RATIONAL_POLYNOMIAL:
        return 0.0
    middle, focal = camera.camera_matrix[:2, 2], np.diag(camera.camera_matrix)[:2]
    last_px = np.array([camera.image_width - 1.0, camera.image_height - 1.0])
    squared = float(np.sum((np.maximum(middle, last_px - middle) / focal) ** 2))
    gradient = np.array([3 * squared, 5 * squared**2, 7 * squared**3])
    radial = [camera.covariance.parameters.index(name) for name in ("k1", "k2", "k3")]
    return float(np.sqrt(gradient @ camera.covariance.data[np.ix_(radial, radial)] @ gradient))
