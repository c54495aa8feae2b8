"""The camera's intrinsic parameters from views of a board, with their covariance, robust against bad views."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from jaxtyping import Float64

from ringpose.calibrate.board_pose import board_pose, residuals
from ringpose.calibrate.intrinsics import covariance_of_free, intrinsic_information, parameter_names
from ringpose.errors import DataError
from ringpose.types.arrays import Array
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.calibration import CameraCalibration, CameraView
from ringpose.types.camera import DISTORTION_COEFFICIENTS, Camera
from ringpose.types.covariance import ParameterCovariance

MINIMUM_VIEWS = 3
"""Two views of a plane give four equations for the four parameters of the pinhole, and none to check them by."""

OUTLIER_FACTOR = 2.5
"""A view is rejected if its rms is this many times the median of the views'. Good sets stay below 1.5."""

OUTLIER_FLOOR_PX = 0.05
"""And no view below this rms is rejected: that is the corner finders' own accuracy."""

LARGEST_REJECTED_SHARE = 1 / 3
"""If more views than this disagree, nobody knows which are the bad ones."""

LARGEST_FOCAL_SHARE = 0.1
"""A standard deviation of the focal length above this share of it means that the views do not determine it."""

_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraModel:
    """Which parameters are estimated."""

    distortion_model: str = "plumb_bob"
    fix_k3: bool = False
    """Hold k3 at zero: few views, or little distortion, do not determine it."""
    zero_tangential: bool = False
    """Hold p1 and p2 at zero."""
    keep_all: bool = False
    """Reject no view, however bad."""


def calibrate_camera(
    views: Sequence[BoardView],
    image_width: int,
    image_height: int,
    model: CameraModel = CameraModel(),
    camera_name: str = "camera",
) -> CameraCalibration:
    """Intrinsic parameters by least squares over all corners; the worst view is rejected until none stands out."""
    used = list(range(len(views)))
    rejected: dict[int, str] = {}
    blank = _blank(camera_name, image_width, image_height, model)
    while True:
        _require_views(len(used))
        camera, poses = _least_squares([views[index] for index in used], blank, model)
        worst = None if model.keep_all else _outlier(poses)
        if worst is None or len(rejected) + 1 > LARGEST_REJECTED_SHARE * len(views):
            break
        rejected[used.pop(worst)] = _reason(poses, worst)
    return _judged(views, rejected, camera, model)


def _require_views(views: int) -> None:
    if views < MINIMUM_VIEWS:
        raise DataError(
            "calibrate-camera",
            f"{views} view{'s' * (views != 1)} of the board, at least {MINIMUM_VIEWS} are needed",
            "add views with the board tilted by 20 to 40 degrees to different sides; ten or more are good",
        )


def _blank(camera_name: str, image_width: int, image_height: int, model: CameraModel) -> Camera:
    return Camera(
        camera_name=camera_name,
        image_width=image_width,
        image_height=image_height,
        camera_matrix=np.eye(3),
        distortion_model=model.distortion_model,
        distortion_coefficients=np.zeros(DISTORTION_COEFFICIENTS[model.distortion_model]),
    )


def _least_squares(views: Sequence[BoardView], blank: Camera, model: CameraModel) -> tuple[Camera, list[BoardPose]]:
    """OpenCV's bundle adjustment, then the poses once more at full precision (it takes corners in single precision)."""
    flags = cv2.CALIB_RATIONAL_MODEL if model.distortion_model == "rational_polynomial" else 0
    flags |= cv2.CALIB_FIX_K3 if model.fix_k3 else 0
    flags |= cv2.CALIB_ZERO_TANGENT_DIST if model.zero_tangential else 0
    try:
        _, matrix, coefficients, _, _ = cv2.calibrateCamera(
            [view.points_board_m.astype(np.float32) for view in views],
            [view.points_px.astype(np.float32) for view in views],
            (blank.image_width, blank.image_height),
            np.eye(3),
            np.zeros(len(blank.distortion_coefficients)),
            flags=flags,
            criteria=_CRITERIA,
        )
    except cv2.error as error:
        raise _undetermined("the equations have no solution") from error
    camera = replace(
        blank,
        camera_matrix=np.asarray(matrix, dtype=np.float64),
        distortion_coefficients=np.asarray(coefficients, dtype=np.float64).ravel()[
            : len(blank.distortion_coefficients)
        ],
    )
    return camera, [board_pose(view, camera) for view in views]


def _outlier(poses: Sequence[BoardPose]) -> int | None:
    """Index of the view that stands out most, if one does."""
    rms = np.array([pose.residual_rms_px for pose in poses])
    worst = int(np.argmax(rms))
    limit = max(OUTLIER_FACTOR * float(np.median(rms)), OUTLIER_FLOOR_PX)
    return worst if rms[worst] > limit else None


def _reason(poses: Sequence[BoardPose], worst: int) -> str:
    rms = [pose.residual_rms_px for pose in poses]
    return f"rms {rms[worst]:.2f} px, {rms[worst] / float(np.median(rms)):.1f} times the median of the views"


def _judged(
    views: Sequence[BoardView], rejected: Mapping[int, str], camera: Camera, model: CameraModel
) -> CameraCalibration:
    """The calibration with its covariance and what each view says."""
    poses = [board_pose(view, camera) for view in views]
    errors = [residuals(view, pose, camera) for view, pose in zip(views, poses, strict=True)]
    used = [index for index in range(len(views)) if index not in rejected]
    squares = sum(float(np.sum(errors[index] ** 2)) for index in used)
    corners = sum(len(errors[index]) for index in used)
    free = _free(model)
    sigma_px = float(np.sqrt(squares / max(2 * corners - 6 * len(used) - int(free.sum()), 1)))
    covariance = _covariance([views[i] for i in used], [poses[i] for i in used], camera, free, sigma_px)
    return CameraCalibration(
        camera=replace(camera, covariance=covariance),
        rms_px=float(np.sqrt(squares / corners)),
        sigma_px=sigma_px,
        views=tuple(
            CameraView(name=view.name, pose=poses[index], residual_px=errors[index], rejected=rejected.get(index, ""))
            for index, view in enumerate(views)
        ),
    )


def _free(model: CameraModel) -> Float64[Array, "parameter"]:
    """1 for each parameter that is estimated, 0 for each that is held."""
    held = {"k3"} if model.fix_k3 else set()
    held |= {"p1", "p2"} if model.zero_tangential else set()
    return np.array([float(name not in held) for name in parameter_names(model.distortion_model)])


def _covariance(
    views: list[BoardView], poses: list[BoardPose], camera: Camera, free: Float64[Array, "parameter"], sigma_px: float
) -> ParameterCovariance:
    try:
        data = covariance_of_free(intrinsic_information(views, poses, camera), free, sigma_px)
    except np.linalg.LinAlgError as error:
        raise _undetermined("the views determine the parameters in more than one way") from error
    focal, sd = camera.camera_matrix[0, 0], float(np.sqrt(max(data[0, 0], 0.0)))
    if not np.isfinite(sd) or sd > LARGEST_FOCAL_SHARE * focal:
        raise _undetermined(
            f"the views leave the focal length open: {focal:.0f} px with standard deviation {sd:.0f} px"
        )
    return ParameterCovariance(parameters=parameter_names(camera.distortion_model), data=data)


def _undetermined(found: str) -> DataError:
    return DataError(
        "calibrate-camera", found, "add views with the board tilted by 20 to 40 degrees to different sides"
    )
