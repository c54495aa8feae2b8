"""Break points in the image -> points in space with their joint covariance (ringpose-method(7), section 1).

A point is P = t r, t = d / (m . r), with the ray r and the light plane m . P = d. Its covariance is that of the break
point in the image and of the rig.
"""

from dataclasses import dataclass

import numpy as np

from ringpose.estimate.nuisance import rig_errors
from ringpose.geometry.rays import intersect, pixels_wrt_ray_and_camera, rays
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.detection import BreakPoints
from ringpose.types.pose import RingPoints
from ringpose.types.rig import Camera, Rig


def triangulated(break_points: BreakPoints, rig: Rig) -> RingPoints:
    """Intersections of the rays of the break points with their light planes.

    NaN where a break point was not seen, and where its ray is parallel to the plane or meets it behind the camera.
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
    """Covariance of the 3 n coordinates x1 y1 z1 x2 ..., to first order; NaN if the covariance of a break point is NaN.

    The errors of break points are independent of each other; the errors of the rig, where its covariance is known, are
    common to all.
    """
    light_normal = rig.lasers.normal[laser]
    jacobians = point_jacobians(points, light_normal, rig.camera)
    independent = np.zeros((len(points), 3, len(points), 3))
    each = np.arange(len(points))
    independent[each, :, each] = jacobians.wrt_pixel @ covariance_px2 @ jacobians.wrt_pixel.swapaxes(1, 2)
    total = independent.reshape(points.size, points.size)
    if rig.covariance is None:
        return total
    errors = rig_errors(rig)
    if errors is None:
        return np.full_like(total, np.nan)
    wrt_planes = points_wrt_plane(points, light_normal, errors.basis[laser]) @ errors.lasers[laser]
    wrt_rig = (jacobians.wrt_camera @ errors.camera + wrt_planes).reshape(points.size, -1) @ errors.root
    total += wrt_rig @ wrt_rig.T
    return total


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PointJacobians:
    """Derivatives of points in space with respect to their pixels and to the camera's parameters."""

    wrt_pixel: Float64[Array, "n xyz=3 xy=2"]
    wrt_camera: Float64[Array, "n xyz=3 parameter"]
    """Derivatives in the order of `CAMERA_PARAMETERS`, as many as the camera has."""


def point_jacobians(
    points: Float64[Array, "n xyz=3"], light_normal: Float64[Array, "n xyz=3"], camera: Camera
) -> PointJacobians:
    """dP/dr = t (1 - r m^T / (m . r)), chained with dr/dpixel and dr/dparameter of the distortion."""
    ray = points / points[:, 2:]
    cosine = np.sum(light_normal * ray, axis=-1)[:, None, None]
    wrt_ray = points[:, 2, None, None] * (np.eye(3) - ray[:, :, None] * light_normal[:, None, :] / cosine)[:, :, :2]
    pixel_wrt_ray, pixel_wrt_camera = pixels_wrt_ray_and_camera(ray[:, :2], camera)
    wrt_pixel = wrt_ray @ np.linalg.inv(pixel_wrt_ray)
    return PointJacobians(wrt_pixel=wrt_pixel, wrt_camera=-wrt_pixel @ pixel_wrt_camera)


def points_wrt_plane(
    points: Float64[Array, "n xyz=3"], light_normal: Float64[Array, "n xyz=3"], basis: Float64[Array, "n 2 xyz=3"]
) -> Float64[Array, "n xyz=3 parameter=3"]:
    """dP/dtilt_k = -P (e_k . r) / (m . r) and dP/ddistance = r / (m . r), each point by its own light plane."""
    ray = points / points[:, 2:]
    wrt_tilts = -points[:, :, None] * (basis @ ray[:, :, None]).swapaxes(1, 2)
    along = np.concatenate([wrt_tilts, ray[:, :, None]], axis=2)
    derivative: Float64[Array, "n xyz=3 parameter=3"] = along / np.sum(light_normal * ray, axis=-1)[:, None, None]
    return derivative
