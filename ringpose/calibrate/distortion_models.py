"""The same views under two distortion models."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringpose.calibrate.board_pose import board_pose
from ringpose.calibrate.camera_model import CameraModel
from ringpose.calibrate.camera_solution import CameraSolution, blank_camera, camera_solution
from ringpose.calibrate.cross_validation import cameras_without_one, held_out_rms_px
from ringpose.calibrate.projection_map import displacement_px
from ringpose.types.board import BoardView
from ringpose.types.calibration import ImageMap, ModelComparison, ModelFit
from ringpose.types.camera import DISTORTION_COEFFICIENTS


def model_comparison(
    used: Sequence[BoardView], whole: CameraSolution, model: CameraModel, where: ImageMap
) -> ModelComparison:
    """The camera found beside that of the other model.

    More coefficients always lower the rms. Whether they describe the lens or the noise, views tell that the camera was
    calibrated without: only if their rms falls too is the larger model the better one.
    """
    other_model = replace(model, distortion_model=_other(model.distortion_model))
    camera = whole.camera
    blank = blank_camera(camera.camera_name, camera.image_width, camera.image_height, other_model)
    other = camera_solution(used, blank, other_model)
    return ModelComparison(
        fits=(_fit(used, whole, model), _fit(used, other, other_model)),
        difference_px=displacement_px(camera, other.camera, where),
    )


def _other(distortion_model: str) -> str:
    return next(name for name in DISTORTION_COEFFICIENTS if name != distortion_model)


def _fit(used: Sequence[BoardView], whole: CameraSolution, model: CameraModel) -> ModelFit:
    without_one = cameras_without_one(used, whole, model) or [None] * len(used)
    held_out = [held_out_rms_px(view, others) for view, others in zip(used, without_one, strict=True)]
    return ModelFit(
        distortion_model=model.distortion_model,
        parameters=int(model.free.sum()),
        rms_px=_pooled_px([board_pose(view, whole.camera).residual_rms_px for view in used], used),
        held_out_rms_px=_pooled_px(held_out, used),
    )


def _pooled_px(rms_px: Sequence[float], views: Sequence[BoardView]) -> float:
    """Rms over all corners, from that of each view."""
    return float(np.sqrt(np.average(np.square(rms_px), weights=[len(view.ids) for view in views])))
