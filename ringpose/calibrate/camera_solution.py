"""Intrinsic parameters by least squares over given corners, none of them doubted (ringpose-method(7), section 7)."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np

from ringpose.calibrate.board_pose import board_pose
from ringpose.calibrate.camera_model import CameraModel
from ringpose.errors import DataError
from ringpose.types.arrays import Array, Bool
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.camera import DISTORTION_COEFFICIENTS, Camera

MINIMUM_VIEWS = 3
"""Two views of a plane give four equations for the four parameters of the pinhole, and none to check them by."""

_CRITERIA = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)


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


def camera_solution(views: Sequence[BoardView], start: Camera, model: CameraModel) -> tuple[Camera, list[BoardPose]]:
    """OpenCV's bundle adjustment, then the poses once more at full precision (it takes corners in single precision).

    It starts from the camera given, or, if that is blank, from the homographies of the views.
    """
    require_views(len(views))
    known = start.camera_matrix[0, 0] > 1
    try:
        _, matrix, coefficients, _, _ = cv2.calibrateCamera(
            [view.points_board_m.astype(np.float32) for view in views],
            [view.points_px.astype(np.float32) for view in views],
            (start.image_width, start.image_height),
            start.camera_matrix.copy(),
            start.distortion_coefficients.copy(),
            flags=model.flags | (cv2.CALIB_USE_INTRINSIC_GUESS if known else 0),
            criteria=_CRITERIA,
        )
    except cv2.error as error:
        raise undetermined("the equations have no solution") from error
    camera = replace(
        start,
        camera_matrix=np.asarray(matrix, dtype=np.float64),
        distortion_coefficients=np.asarray(coefficients, dtype=np.float64).ravel()[
            : len(start.distortion_coefficients)
        ],
        covariance=None,
    )
    return camera, [board_pose(view, camera) for view in views]


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
