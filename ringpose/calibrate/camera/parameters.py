"""Intrinsic parameters as a vector: which are estimated, Jacobians, steps and covariance."""

from dataclasses import dataclass

import cv2
import numpy as np

from ringpose.geometry.rotations import rotation_vector
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.board import BoardPose
from ringpose.types.rig import DISTORTION_COEFFICIENTS, Camera, camera_parameters

MIN_SHARE = 1e-14
"""Lower limit of eigenvalues, over the largest one: rounding of smaller ones would make variances negative."""


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


def projection_jacobians(
    points: Float64[Array, "corner xyz=3"], pose: BoardPose, camera: Camera
) -> tuple[Float64[Array, "corner xy=2 pose=6"], Float64[Array, "corner xy=2 parameter"]]:
    """Jacobians of the pixels with respect to the pose (rotation vector, translation) and the intrinsic parameters."""
    _, jacobian = cv2.projectPoints(
        points, rotation_vector(pose.rotation), pose.translation_m, camera.camera_matrix, camera.distortion_coefficients
    )
    both = np.asarray(jacobian, dtype=np.float64)
    parameters = 4 + len(camera.distortion_coefficients)
    both = both.reshape(len(points), 2, -1)
    return both[..., :6], both[..., 6 : 6 + parameters]


def damped_step(
    information: Float64[Array, "parameter parameter"],
    gradient: Float64[Array, "parameter"],
    free: Bool[Array, "parameter"],
    damping: float,
) -> Float64[Array, "parameter"]:
    """Levenberg-Marquardt step of the free parameters; `gradient` is the right-hand side of the normal equations."""
    return covariance_of_free(information * (1 + damping * np.eye(len(free))), free) @ gradient


def covariance_of_free(
    information: Float64[Array, "parameter parameter"], free: Bool[Array, "parameter"] | None = None
) -> Float64[Array, "parameter parameter"]:
    """Inverse of the normal matrix `information` over the free parameters; zero for those held fixed.

    The parameters may have different units. By default those are free for which there is any information.
    """
    index = np.flatnonzero(np.diag(information) > 0 if free is None else free)
    scale = np.sqrt(np.diag(information)[index])
    inner = information[np.ix_(index, index)] / np.outer(scale, scale)
    covariance = np.zeros_like(information)
    size, axes = np.linalg.eigh(inner)
    size = np.maximum(size, MIN_SHARE * size.max(initial=0.0))
    covariance[np.ix_(index, index)] = (axes / size @ axes.T) / np.outer(scale, scale)
    return covariance


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
