"""How well depths are known along the light planes, before any noise of the shot itself."""

from dataclasses import dataclass

import numpy as np

from ringpose.geometry.rays import intersect, project, rays
from ringpose.geometry.rotations import tilt_basis
from ringpose.pose.measurements import pixels_by_ray_and_camera
from ringpose.types.arrays import Array, Float64
from ringpose.types.camera import Camera
from ringpose.types.covariance import CAMERA_PARAMETERS, ParameterCovariance, laser_parameters
from ringpose.types.rig import LaserPlanes

COLUMNS = 9
"""Places along each stripe at which the depth is judged."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class DepthUncertainty:
    """Standard deviation of depths along the stripe of each laser on a wall across the optical axis."""

    distances_m: tuple[float, ...]
    depth_sd_m: Float64[Array, "laser distance place"]
    """NaN where the stripe is out of the image."""

    @property
    def worst_m(self) -> Float64[Array, "laser distance"]:
        """The largest along each stripe; NaN where none of it is in the image."""
        filled = np.nan_to_num(self.depth_sd_m, nan=-1.0).max(axis=-1)
        return np.where(filled >= 0, filled, np.nan)


def depth_uncertainty(
    camera: Camera, lasers: LaserPlanes, covariance: ParameterCovariance, distances_m: tuple[float, ...]
) -> DepthUncertainty:
    """What the joint covariance of camera and planes means for triangulated depths (ringpose-method(7), section 1)."""
    by_laser = [
        [_depth_sd_m(camera, lasers, covariance, laser, distance_m) for distance_m in distances_m]
        for laser in range(len(lasers.names))
    ]
    return DepthUncertainty(distances_m=distances_m, depth_sd_m=np.array(by_laser))


def _depth_sd_m(
    camera: Camera, lasers: LaserPlanes, covariance: ParameterCovariance, laser: int, distance_m: float
) -> Float64[Array, "place"]:
    pixels = _stripe_px(camera, lasers.normal[laser], float(lasers.distance_m[laser]), distance_m)
    inside = np.isfinite(pixels).all(axis=1)
    sd = np.full(len(pixels), np.nan)
    if inside.any():
        jacobian = _depth_jacobian(camera, lasers, covariance.parameters, laser, pixels[inside])
        sd[inside] = np.sqrt(np.einsum("ni,ij,nj->n", jacobian, covariance.data, jacobian).clip(0))
    return sd


def _stripe_px(
    camera: Camera, normal: Float64[Array, "xyz=3"], distance_m: float, wall_m: float
) -> Float64[Array, "place xy=2"]:
    """Pixels along the stripe on the wall z = wall_m, as far as they are in the image."""
    size = np.array([camera.image_width, camera.image_height])
    across = 1 if abs(normal[1]) >= abs(normal[0]) else 0
    edge = np.full((COLUMNS, 2), (size - 1) / 2)
    edge[:, 1 - across] = np.linspace(0, size[1 - across] - 1, COLUMNS)
    place = rays(edge, camera) * wall_m
    steep = normal[across]
    if abs(steep) < 1e-6:
        return np.full((COLUMNS, 2), np.nan)
    other = 1 - across
    place[:, across] = (distance_m - normal[other] * place[:, other] - normal[2] * wall_m) / steep
    pixels = project(place, camera)
    inside = np.all((pixels > -0.5) & (pixels < size - 0.5), axis=1)
    return np.where(inside[:, None], pixels, np.nan)


def _depth_jacobian(
    camera: Camera, lasers: LaserPlanes, parameters: tuple[str, ...], laser: int, pixels: Float64[Array, "n xy=2"]
) -> Float64[Array, "n parameter"]:
    """Derivative of z = d / (m . r), r = (x, y, 1), by the parameters: z / d for d, -z m . dr / (m . r) for the ray."""
    normal, distance_m = lasers.normal[laser], lasers.distance_m[laser]
    directions = rays(pixels, camera)
    points = intersect(directions, normal, np.array(float(distance_m)))
    cosine = directions @ normal
    by_plane = np.column_stack([-(points @ tilt_basis(normal).T), np.ones(len(points))]) / cosine[:, None]
    by_ray, by_camera = pixels_by_ray_and_camera(directions[:, :2], camera)
    ray_by_camera = -np.linalg.solve(by_ray, by_camera)
    depth_by_camera = -(points[:, 2] / cosine)[:, None] * np.einsum("i,nip->np", normal[:2], ray_by_camera)
    return _in_order(depth_by_camera, by_plane, parameters, lasers.names[laser])


def _in_order(
    by_camera: Float64[Array, "n camera"],
    by_plane: Float64[Array, "n plane=3"],
    parameters: tuple[str, ...],
    laser: str,
) -> Float64[Array, "n parameter"]:
    own = dict(zip(laser_parameters([laser]), by_plane.T, strict=True))
    own |= dict(zip(CAMERA_PARAMETERS, by_camera.T, strict=False))
    zero = np.zeros(len(by_plane))
    return np.column_stack([own.get(name, zero) for name in parameters])
