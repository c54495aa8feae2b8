"""Errors that many residuals have in common, nuisance parameters of the fit (ringpose-method(7), section 5).

Light planes and camera are known with a joint covariance, that of the calibration plus what may have changed since
(section 11). The columns of its square root are independent errors of unit variance; each one is a parameter of the fit
beside the ring, with the prior N(0, 1). The rates of a moving target (section 8), the form of a real ring (section 12)
and the common errors of the points of a visible edge (`Edges.common`) are treated in the same way.
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from math import sqrt

import numpy as np

from ringpose.errors import DataError
from ringpose.geometry.rays import pixels_wrt_ray_and_camera
from ringpose.geometry.rotations import tilt_basis
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.assumptions import RigStability
from ringpose.types.rig import CAMERA_PARAMETERS, PLANE_PARAMETERS, Camera, ParameterCovariance, Rig, laser_parameters

_NEGLIGIBLE = 1e-12
"""Share of the correlation matrix's largest eigenvalue below which a combination of parameters counts as exact."""


EXACT = RigStability()
"""Stability of a rig that has not changed since its calibration."""

FOCAL_RATIO = "focal_ratio"
"""Change of both focal lengths together, relative to them."""

FORM_ORDERS = (2, 3, 4)
"""Orders of a ring's deviations from circle and plane; 0 and 1 are radius, centre, offset and tilt."""

FORM_PARAMETERS = tuple(
    f"form.{what}.{axis}{order}" for what in ("inner", "outer", "axial") for order in FORM_ORDERS for axis in "ab"
)
"""Amplitudes in metres: radial deviation of each edge and axial deviation of the face, a_k cos(k phi) + b_k sin(k phi),
with the angle phi from the middle of the arc that was seen."""

FACE_SLOPE = "face.slope"
"""Angle between the face and the ring's plane, positive where the face rises outwards: a flange may be conical."""

FORM_SHARE = 1.0 / sqrt(len(FORM_ORDERS))
"""Standard deviation of each amplitude over the tolerance, so that the deviation at any angle has the tolerance as its
own."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigErrors:
    """The uncertain parameters of a rig, and the square root R of their covariance R R^T."""

    parameters: tuple[str, ...]
    root: Float64[Array, "parameter error"]
    camera: Float64[Array, "camera parameter"]
    """Derivatives of the camera's parameters, rows as in `CAMERA_PARAMETERS`."""
    lasers: Float64[Array, "laser plane=3 parameter"]
    """Selects the parameters of the light planes, rows as in `PLANE_PARAMETERS`."""
    basis: Float64[Array, "laser 2 3"]


@lru_cache(maxsize=8)
def rig_errors(rig: Rig, stability: RigStability = EXACT) -> RigErrors | None:
    """The errors of the rig's calibration and stability; None if both are zero or not known.

    Parameters without variance are left out.
    """
    total = total_covariance(rig, stability)
    uncertain = np.diag(total.data) > 0
    names = tuple(name for name, kept in zip(total.parameters, uncertain, strict=True) if kept)
    if not names:
        return None
    camera = np.zeros((4 + len(rig.camera.distortion_coefficients), len(names)))
    lasers = np.zeros((len(rig.lasers.names), len(PLANE_PARAMETERS), len(names)))
    for column, name in enumerate(names):
        laser, _, parameter = name.rpartition(".")
        if name == FOCAL_RATIO:
            camera[:2, column] = rig.camera.camera_matrix[[0, 1], [0, 1]]
        elif name in CAMERA_PARAMETERS[: len(camera)]:
            camera[CAMERA_PARAMETERS.index(name), column] = 1.0
        elif laser in rig.lasers.names and parameter in PLANE_PARAMETERS:
            lasers[rig.lasers.names.index(laser), PLANE_PARAMETERS.index(parameter), column] = 1.0
        else:
            raise DataError(
                "the rig's covariance",
                f"it names {name!r}, which is not a parameter of this rig",
                "correct that name, or remove the covariance from the rig file",
            )
    root = covariance_root(total.data[np.ix_(uncertain, uncertain)])
    return RigErrors(parameters=names, root=root, camera=camera, lasers=lasers, basis=light_plane_bases(rig))


def total_covariance(rig: Rig, stability: RigStability) -> ParameterCovariance:
    """The covariance of the rig's parameters: of its calibration, if it is known and finite, plus its stability.

    Since the calibration, each plane's tilts and distance, and both focal lengths together, may have changed. A plane
    that was corrected has the covariance of its correction.
    """
    calibrated = rig.covariance
    if calibrated is None or not np.isfinite(calibrated.data).all():
        calibrated = ParameterCovariance(parameters=(), data=np.zeros((0, 0)))
    if stability == EXACT and not rig.moved_planes:
        return calibrated
    names = (*laser_parameters(rig.lasers.names), FOCAL_RATIO)
    names = (*calibrated.parameters, *(name for name in names if name not in calibrated.parameters))
    covariance = np.zeros((len(names), len(names)))
    covariance[: len(calibrated.parameters), : len(calibrated.parameters)] = calibrated.data
    covariance[names.index(FOCAL_RATIO), names.index(FOCAL_RATIO)] = stability.focal_ratio**2
    variance = np.array([stability.plane_tilt_rad, stability.plane_tilt_rad, stability.plane_distance_m]) ** 2
    for laser in rig.lasers.names:
        of_plane = [names.index(name) for name in laser_parameters([laser])]
        covariance[of_plane, of_plane] += variance
        if laser in rig.moved_planes:
            covariance[of_plane], covariance[:, of_plane] = 0.0, 0.0
            covariance[np.ix_(of_plane, of_plane)] = rig.moved_planes[laser].covariance
    return ParameterCovariance(parameters=names, data=covariance)


@lru_cache(maxsize=8)
def with_stability(rig: Rig, stability: RigStability) -> Rig:
    """The rig with its stability as part of its covariance; without any variance the rig stays as it is."""
    total = total_covariance(rig, stability)
    return replace(rig, covariance=total, stability=EXACT, moved_planes={}) if total.data.any() else rig


@lru_cache(maxsize=8)
def light_plane_bases(rig: Rig) -> Float64[Array, "laser 2 3"]:
    """The tilt basis of each light plane."""
    return np.array([tilt_basis(normal) for normal in rig.lasers.normal])


def covariance_root(covariance: Float64[Array, "n n"]) -> Float64[Array, "n error"]:
    """Square root R of a covariance R R^T, computed from its correlations: parameters are pixels and microradians.

    Parameters without variance have zero rows.
    """
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    variance, axes = np.linalg.eigh(covariance / scale[:, None] / scale)
    kept = variance > _NEGLIGIBLE * (float(variance[-1]) if len(variance) else 0.0)
    root: Float64[Array, "n error"] = scale[:, None] * axes[:, kept] * np.sqrt(variance[kept])
    return root


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
