"""How much a camera hangs on which views were taken (ringpose-method(7), section 7)."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringpose.calibrate.board_pose import board_pose
from ringpose.calibrate.camera_model import CameraModel
from ringpose.calibrate.camera_solution import MINIMUM_VIEWS, CameraSolution, camera_solution, corners_of
from ringpose.calibrate.intrinsics import (
    camera_with,
    covariance_of_free,
    parameter_names,
    parameters_of,
)
from ringpose.calibrate.projection_map import displacement_px, projection_sigma_px
from ringpose.errors import DataError
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardView
from ringpose.types.calibration import CameraCalibration, CrossValidation, ImageMap, LeftOutView
from ringpose.types.camera import Camera
from ringpose.types.covariance import ParameterCovariance

MOST_SOLVED = 20
"""With more views than this, leaving one out is computed by one step; solving anew takes a second for each of 60."""


_EXACT_PX = 1e-6


def used_views(calibration: CameraCalibration, boards: Sequence[BoardView]) -> list[BoardView]:
    """The corners that a calibration used; the boards are those of all views, in their order."""
    pairs = zip(calibration.views, boards, strict=True)
    return [corners_of(board, ~view.left_out) for view, board in pairs if not view.rejected]


def cross_validation(
    used: Sequence[BoardView], whole: CameraSolution, model: CameraModel, where: ImageMap
) -> CrossValidation:
    """Calibrations of half the views and of all but one, beside that of all."""
    without_one = cameras_without_one(used, whole, model)
    shifts = [_shift_px(whole.camera, other, where) for other in without_one]
    return CrossValidation(
        split_half_px=_split_half_px(used, whole.camera, model, where),
        left_out=tuple(_left_out(*one) for one in zip(used, without_one, shifts, strict=False)),
        jackknife_px=_jackknife_px(shifts, whole, model, where),
    )


def cameras_without_one(used: Sequence[BoardView], whole: CameraSolution, model: CameraModel) -> list[Camera | None]:
    """The camera of all views but one, for each view; empty if there are too few."""
    if len(used) <= MINIMUM_VIEWS:
        return []
    if len(used) > MOST_SOLVED:
        return list(cameras_one_step_away(whole, model))
    return [_camera([*used[:index], *used[index + 1 :]], whole.camera, model) for index in range(len(used))]


def cameras_one_step_away(whole: CameraSolution, model: CameraModel) -> list[Camera]:
    """The same by one Gauss-Newton step from the camera of all views: of many views, one changes little."""
    information, score = whole.parts.sum(axis=0), whole.scores.sum(axis=0)
    steps = [
        covariance_of_free(information - part, model.free) @ (score - own)
        for part, own in zip(whole.parts, whole.scores, strict=True)
    ]
    return [camera_with(parameters_of(whole.camera) + step, whole.camera) for step in steps]


def held_out_rms_px(view: BoardView, others: Camera | None) -> float:
    """Of a view's corners under the camera of the other views, its pose alone fitted."""
    return float("nan") if others is None else board_pose(view, others).residual_rms_px


def _left_out(view: BoardView, others: Camera | None, shift_px: Float64[Array, "map_row map_column"]) -> LeftOutView:
    return LeftOutView(name=view.name, shift_px=float(np.median(shift_px)), rms_px=held_out_rms_px(view, others))


def _shift_px(camera: Camera, other: Camera | None, where: ImageMap) -> Float64[Array, "map_row map_column"]:
    return _unknown(where) if other is None else displacement_px(camera, other, where)


def _unknown(where: ImageMap) -> Float64[Array, "map_row map_column"]:
    return np.full(where.points_px.shape[:2], np.nan)


def _jackknife_px(
    shifts: Sequence[Float64[Array, "map_row map_column"]], whole: CameraSolution, model: CameraModel, where: ImageMap
) -> Float64[Array, "map_row map_column"]:
    """The projection uncertainty times the shifts, over what noise would make them.

    Views are independent of each other even where their corners are not. A camera of fewer views is that of all and an
    independent error more, so that noise shifts it by the difference of the covariances.
    """
    if not shifts:
        return _unknown(where)
    information = whole.parts.sum(axis=0)
    covariance = covariance_of_free(information, model.free)
    others = [covariance_of_free(information - part, model.free) - covariance for part in whole.parts]
    expected = [projection_sigma_px(_known_to(whole.camera, other), where) for other in others]
    ratio = np.sum(np.square(shifts), axis=0) / np.maximum(np.sum(np.square(expected), axis=0), _EXACT_PX**2)
    jackknife: Float64[Array, "map_row map_column"] = np.sqrt(ratio) * projection_sigma_px(
        _known_to(whole.camera, covariance), where
    )
    return jackknife


def _known_to(camera: Camera, covariance: Float64[Array, "parameter parameter"]) -> Camera:
    names = parameter_names(camera.distortion_model)
    return replace(camera, covariance=ParameterCovariance(parameters=names, data=covariance))


def _split_half_px(
    used: Sequence[BoardView], camera: Camera, model: CameraModel, where: ImageMap
) -> Float64[Array, "map_row map_column"]:
    """Every other view against the rest: neighbours in a series are alike."""
    halves = [_camera(used[first::2], camera, model) for first in (0, 1)]
    one, other = halves
    if one is None or other is None:
        return _unknown(where)
    return displacement_px(one, other, where)


def _camera(views: Sequence[BoardView], start: Camera, model: CameraModel) -> Camera | None:
    try:
        return camera_solution(views, start, model).camera
    except DataError:
        return None
