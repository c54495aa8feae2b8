"""Break points in the image -> points in space with their joint covariance (ringpose-method(7), section 1).

A point is P = t r, t = d / (m . r), with the ray r and the light plane m . P = d. Its covariance is that of the break
point in the image and of the rig.
"""

from dataclasses import dataclass

import numpy as np

from ringpose.geometry.rays import intersect, rays
from ringpose.pose.measurements import pixels_by_ray_and_camera
from ringpose.pose.nuisance import rig_errors
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.camera import Camera
from ringpose.types.detection import BreakPoints
from ringpose.types.pose import RingPoints
from ringpose.types.rig import Rig


def triangulated(break_points: BreakPoints, rig: Rig) -> RingPoints:
    """Where the ray through each break point meets its laser's plane.

    NaN where a break point was not seen, and where its ray runs along the plane or meets it behind the camera.
    """
    directions = rays(break_points.position_px, rig.camera)
    position = intersect(directions, rig.lasers.normal[:, None], rig.lasers.distance_m[:, None])
    return RingPoints(position_m=position)


def point_covariance(
    points: Float64[Array, "n xyz=3"],
    covariance_px2: Float64[Array, "n xy=2 xy=2"],
    laser: Int64[Array, "n"],
    rig: Rig,
) -> Float64[Array, "coordinate coordinate"]:
    """Covariance of the 3 n coordinates x1 y1 z1 x2 ..., to first order; NaN if that of a break point is.

    The errors of break points are independent of each other; those of the rig, where its covariance is known, are
    common to all.
    """
    light_normal = rig.lasers.normal[laser]
    jacobians = point_jacobians(points, light_normal, rig.camera)
    own = np.zeros((len(points), 3, len(points), 3))
    each = np.arange(len(points))
    own[each, :, each] = jacobians.by_pixel @ covariance_px2 @ jacobians.by_pixel.swapaxes(1, 2)
    total = own.reshape(points.size, points.size)
    if rig.covariance is None:
        return total
    errors = rig_errors(rig)
    if errors is None:
        return np.full_like(total, np.nan)
    by_planes = points_by_plane(points, light_normal, errors.basis[laser]) @ errors.lasers[laser]
    by_rig = (jacobians.by_camera @ errors.camera + by_planes).reshape(points.size, -1)
    total += by_rig @ by_rig.T
    return total


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointJacobians:
    """Derivatives of points in space, each seen by one laser, by their pixels and by the camera's parameters."""

    by_pixel: Float64[Array, "n xyz=3 xy=2"]
    by_camera: Float64[Array, "n xyz=3 parameter"]
    """In the order of `CAMERA_PARAMETERS`, as many as the camera has."""


def point_jacobians(
    points: Float64[Array, "n xyz=3"], light_normal: Float64[Array, "n xyz=3"], camera: Camera
) -> PointJacobians:
    """dP/dr = t (1 - r m^T / (m . r)), chained with dr/dpixel and dr/dparameter of the distortion."""
    ray = points / points[:, 2:]
    cosine = np.sum(light_normal * ray, axis=-1)[:, None, None]
    by_ray = points[:, 2, None, None] * (np.eye(3) - ray[:, :, None] * light_normal[:, None, :] / cosine)[:, :, :2]
    pixel_by_ray, pixel_by_camera = pixels_by_ray_and_camera(ray[:, :2], camera)
    by_pixel = by_ray @ np.linalg.inv(pixel_by_ray)
    return PointJacobians(by_pixel=by_pixel, by_camera=-by_pixel @ pixel_by_camera)


def points_by_plane(
    points: Float64[Array, "n xyz=3"], light_normal: Float64[Array, "n xyz=3"], basis: Float64[Array, "n 2 xyz=3"]
) -> Float64[Array, "n xyz=3 parameter=3"]:
    """dP/dtilt_k = -P (e_k . r) / (m . r) and dP/ddistance = r / (m . r), each point by its own light plane."""
    ray = points / points[:, 2:]
    by_tilts = -points[:, :, None] * (basis @ ray[:, :, None]).swapaxes(1, 2)
    along = np.concatenate([by_tilts, ray[:, :, None]], axis=2)
    derivative: Float64[Array, "n xyz=3 parameter=3"] = along / np.sum(light_normal * ray, axis=-1)[:, None, None]
    return derivative
