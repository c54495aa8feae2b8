"""Cameras in Kalibr's camchain files."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.files.cameras.ros import pinhole_camera
from ringpose.files.schema import Fields
from ringpose.types.rig import Camera

NAME = "cam0"

_IGNORED = ("rostopic", "cam_overlaps", "T_cn_cnm1", "T_cam_imu", "timeshift_cam_imu")
_KEYS = ("camera_model", "intrinsics", "distortion_model", "distortion_coeffs", "resolution", *_IGNORED)
_LENGTHS = {"radtan": 4, "none": 0}
"""Number of coefficients (k1, k2, p1, p2) of the Kalibr distortion models that OpenCV also has."""


def camera_of(values: Mapping[str, Any], file: str, name: str) -> Camera:
    """The camera in a chain of one camera."""
    if len(values) > 1:
        raise DataError(file, f"has {len(values)} cameras, must have one", "keep the required one, as cam0")
    fields = Fields(file, values).fields(NAME, _KEYS)
    fields.choice("camera_model", ("pinhole",))
    model = fields.choice("distortion_model", _LENGTHS)
    given = fields.vector("distortion_coeffs", _LENGTHS[model]) if _LENGTHS[model] else np.empty(0)
    width, height = fields.vector("resolution", 2).tolist()
    fx, fy, cx, cy = fields.vector("intrinsics", 4).tolist()
    size = Fields(file, {"image_width": int(width), "image_height": int(height)}, path=NAME)
    return pinhole_camera(size, NAME, np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]), given)


def camera_values(camera: Camera) -> dict[str, Any]:
    """The mapping that `camera_of` reads."""
    coefficients = camera.distortion_coefficients
    if np.any(coefficients[4:] != 0):
        found = "radtan has only k1, k2, p1, p2, and this camera has more coefficients"
        raise DataError("kalibr", found, "calibrate with --fix-k3")
    matrix = camera.camera_matrix
    return {
        NAME: {
            "cam_overlaps": [],
            "camera_model": "pinhole",
            "distortion_coeffs": coefficients[:4],
            "distortion_model": "radtan",
            "intrinsics": [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2]],
            "resolution": [camera.image_width, camera.image_height],
            "rostopic": f"/{camera.camera_name or NAME}/image_raw",
        }
    }
