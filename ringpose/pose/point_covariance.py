"""Joint covariance of the triangulated points: of the break points in the image, and of the rig.

All derivatives are of P = t r, t = d / (m . r) (ringpose-method(7), section 1), and of the distortion at r.
"""

from dataclasses import dataclass

import cv2
import numpy as np

from ringpose.errors import DataError
from ringpose.geometry.rotations import tilt_basis
from ringpose.kernels.misfit import spread_m2
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.camera import Camera
from ringpose.types.rig import Rig

CAMERA_PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""In the order of the columns that OpenCV differentiates by."""

_OPENCV_TRANSLATION, _OPENCV_INTRINSICS = 3, 6
"""Columns of cv2.projectPoints' Jacobian: rotation 3, translation 3, then focal lengths and the rest."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointJacobians:
    """Derivatives of points in space, each seen by one laser, by their pixels and by the camera's parameters."""

    by_pixel: Float64[Array, "n xyz=3 xy=2"]
    by_camera: Float64[Array, "n xyz=3 parameter"]
    """In the order of `CAMERA_PARAMETERS`, as many as the camera has."""


def point_covariance(
    points: Float64[Array, "n xyz=3"],
    covariance_px2: Float64[Array, "n xy=2 xy=2"],
    laser: Int64[Array, "n"],
    rig: Rig,
) -> Float64[Array, "coordinate coordinate"]:
    """Covariance of the 3 n coordinates x1 y1 z1 x2 ..., to first order; NaN if a break point's is.

    The errors of break points are independent of each other; the rig's, where the rig tells them, are common to all.
    """
    light_normal = rig.lasers.normal[laser]
    own = spread_m2(points, light_normal, covariance_px2, rig.camera)
    if rig.covariance is None:
        return own
    jacobians = point_jacobians(points, light_normal, rig.camera)
    by_rig = np.stack(
        [_by_parameter(name, points, laser, rig, jacobians).ravel() for name in rig.covariance.parameters], axis=-1
    )
    total: Float64[Array, "coordinate coordinate"] = own + by_rig @ rig.covariance.data @ by_rig.T
    return total


def point_jacobians(
    points: Float64[Array, "n xyz=3"], light_normal: Float64[Array, "n xyz=3"], camera: Camera
) -> PointJacobians:
    """dP/dr = t (1 - r m^T / (m . r)), chained with dr/dpixel and dr/dparameter of the distortion."""
    ray = points / points[:, 2:]
    cosine = np.sum(light_normal * ray, axis=-1)[:, None, None]
    by_ray = points[:, 2, None, None] * (np.eye(3) - ray[:, :, None] * light_normal[:, None, :] / cosine)[:, :, :2]
    zero = np.zeros(3)
    _, jacobian = cv2.projectPoints(ray, zero, zero, camera.camera_matrix, camera.distortion_coefficients)
    pixel_by = np.asarray(jacobian, dtype=np.float64).reshape(len(points), 2, -1)
    ray_by_pixel = np.linalg.inv(pixel_by[:, :, _OPENCV_TRANSLATION : _OPENCV_TRANSLATION + 2])
    by_pixel = by_ray @ ray_by_pixel
    return PointJacobians(by_pixel=by_pixel, by_camera=-by_pixel @ pixel_by[:, :, _OPENCV_INTRINSICS:])


def _by_parameter(
    name: str,
    points: Float64[Array, "n xyz=3"],
    laser: Int64[Array, "n"],
    rig: Rig,
    jacobians: PointJacobians,
) -> Float64[Array, "n xyz=3"]:
    if name in CAMERA_PARAMETERS[: jacobians.by_camera.shape[-1]]:
        return jacobians.by_camera[:, :, CAMERA_PARAMETERS.index(name)]
    of, _, parameter = name.rpartition(".")
    if of not in rig.lasers.names or parameter not in ("tilt_1", "tilt_2", "distance"):
        raise DataError(
            "the rig's covariance",
            f"it names {name!r}, which is no parameter of this rig",
            "run ringpose calibrate-planes",
        )
    number = rig.lasers.names.index(of)
    moved = plane_derivative(points, rig.lasers.normal[number], parameter)
    return np.where((laser == number)[:, None], moved, 0.0)


def plane_derivative(
    points: Float64[Array, "n xyz=3"], light_normal: Float64[Array, "3"], parameter: str
) -> Float64[Array, "n xyz=3"]:
    """dP/dtilt_k = -P (e_k . r) / (m . r) and dP/ddistance = r / (m . r), for points of one light plane."""
    ray = points / points[:, 2:]
    along = ray if parameter == "distance" else -points * (ray @ _tilt_axis(light_normal, parameter))[:, None]
    derivative: Float64[Array, "n xyz=3"] = along / (ray @ light_normal)[:, None]
    return derivative


def _tilt_axis(normal: Float64[Array, "3"], parameter: str) -> Float64[Array, "3"]:
    first, second = tilt_basis(normal)
    axis: Float64[Array, "3"] = second if parameter == "tilt_2" else first
    return axis
