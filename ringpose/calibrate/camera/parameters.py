"""Intrinsic parameters as a vector: which are estimated, Jacobians, steps and covariance."""

from dataclasses import dataclass

import cv2
import numpy as np

from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.rig import DISTORTION_COEFFICIENTS, Camera, camera_parameters


def parameter_names(distortion_model: str) -> tuple[str, ...]:
    """Names of the intrinsic parameters, in the order of their vector."""
    return camera_parameters(DISTORTION_COEFFICIENTS[distortion_model])


def parameters_of(camera: Camera) -> Float64[Array, "parameter"]:
    """Vector of a camera's intrinsic parameters: fx, fy, cx, cy, then the distortion coefficients."""
    matrix = camera.camera_matrix
    return np.array(
        [matrix[0, 0], matrix[1, 1], matrix[0, 2], matrix[1, 2], *camera.distortion_coefficients], dtype=np.float64
    )


def camera_with(parameters: Float64[Array, "parameter"], camera: Camera) -> Camera:
    """The camera with other intrinsic parameters, and without covariance."""
    fx, fy, cx, cy = parameters[:4]
    return Camera(
        camera_name=camera.camera_name,
        image_width=camera.image_width,
        image_height=camera.image_height,
        camera_matrix=np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]]),
        distortion_model=camera.distortion_model,
        distortion_coefficients=parameters[4:].copy(),
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraModel:
    """Distortion model and fixed parameters."""

    distortion_model: str = "plumb_bob"
    fix_k3: bool = False
    """Fix k3 at zero, for few views or little distortion."""
    zero_tangential: bool = False
    """Fix p1 and p2 at zero."""
    keep_all: bool = False
    """Reject no view and no corner, and weight all corners equally."""

    @property
    def flags(self) -> int:
        """Flags of `cv2.calibrateCamera`."""
        flags = cv2.CALIB_RATIONAL_MODEL if self.distortion_model == "rational_polynomial" else 0
        flags |= cv2.CALIB_FIX_K3 if self.fix_k3 else 0
        flags |= cv2.CALIB_ZERO_TANGENT_DIST if self.zero_tangential else 0
        return int(flags)

    @property
    def free(self) -> Bool[Array, "parameter"]:
        """Which parameters are estimated; the others are fixed at zero."""
        fixed = {"k3"} if self.fix_k3 else set()
        fixed |= {"p1", "p2"} if self.zero_tangential else set()
        return np.array([name not in fixed for name in parameter_names(self.distortion_model)])


PLUMB_BOB = CameraModel()
"""OpenCV's default model with all its parameters free."""
