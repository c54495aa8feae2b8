"""Errors that many residuals have in common, nuisance parameters of the fit (ringpose-method(7), section 5).

Light planes and camera are known with a joint covariance, that of the calibration plus what may have changed since
(section 11). The columns of its square root are independent errors of unit variance; each one is a parameter of the fit
beside the ring, with the prior N(0, 1). The rates of a moving target (section 8), the form of a real ring (section 12)
and the common errors of the points of a visible edge (`ringpose.estimate.factors.edges`) are treated in the same way.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import lru_cache
from math import sqrt

import numpy as np

from ringpose.errors import DataError
from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.linearization import Derivatives, FixedColumns, ImageFactor, Residuals
from ringpose.geometry.rays import pixels_wrt_ray_and_camera
from ringpose.geometry.ring import EDGE_SIGN, LIFT, edge_distances, polar_angles
from ringpose.geometry.rotations import tilt_basis
from ringpose.geometry.sheets import bends_of, light_normals
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.assumptions import RigStability
from ringpose.types.rig import (
    BOW_PARAMETERS,
    CAMERA_PARAMETERS,
    PLANE_PARAMETERS,
    Camera,
    ParameterCovariance,
    Rig,
    laser_parameters,
)

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


def form_amplitude_m(tolerance_m: float) -> float:
    """Standard deviation of each amplitude, so that the deviation at any angle has the tolerance as its own."""
    return tolerance_m / sqrt(len(FORM_ORDERS))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigErrors:
    """The uncertain parameters of a rig, and the square root R of their covariance R R^T."""

    parameters: tuple[str, ...]
    root: Float64[Array, "parameter error"]
    camera: Float64[Array, "camera parameter"]
    """Derivatives of the camera's parameters, rows as in `CAMERA_PARAMETERS`."""
    lasers: Float64[Array, "laser sheet parameter"]
    """Selects the parameters of the light planes, rows as in `PLANE_PARAMETERS`, with bent planes then as in
    `BOW_PARAMETERS`."""
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
    of_laser = PLANE_PARAMETERS + (BOW_PARAMETERS if rig.bows else ())
    lasers = np.zeros((len(rig.lasers.names), len(of_laser), len(names)))
    for column, name in enumerate(names):
        laser, _, parameter = name.rpartition(".")
        if name == FOCAL_RATIO:
            camera[:2, column] = rig.camera.camera_matrix[[0, 1], [0, 1]]
        elif name in CAMERA_PARAMETERS[: len(camera)]:
            camera[CAMERA_PARAMETERS.index(name), column] = 1.0
        elif laser in rig.lasers.names and parameter in of_laser:
            lasers[rig.lasers.names.index(laser), of_laser.index(parameter), column] = 1.0
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
    calibrated = _with_bows(calibrated, rig)
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


def _with_bows(calibrated: ParameterCovariance, rig: Rig) -> ParameterCovariance:
    """The covariance with the standard deviations of those bows that it does not have, as if they were independent."""
    stated = {f"{name}.bow": bow.sd_per_rad for name, bow in rig.bows.items()}
    missing = [name for name in stated if name not in calibrated.parameters]
    if not missing:
        return calibrated
    count = len(calibrated.parameters)
    data = np.diag([0.0] * count + [stated[name] ** 2 for name in missing])
    data[:count, :count] = calibrated.data
    return ParameterCovariance(parameters=(*calibrated.parameters, *missing), data=data)


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


# Derivatives of points in space


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
    jacobians = point_jacobians(points, light_normals(points, laser, rig), rig.camera)
    independent = np.zeros((len(points), 3, len(points), 3))
    each = np.arange(len(points))
    independent[each, :, each] = jacobians.wrt_pixel @ covariance_px2 @ jacobians.wrt_pixel.swapaxes(1, 2)
    total = independent.reshape(points.size, points.size)
    if rig.covariance is None:
        return total
    errors = rig_errors(rig)
    if errors is None:
        return np.full_like(total, np.nan)
    wrt_rig = points_wrt_errors(points, laser, rig, jacobians, errors).reshape(points.size, -1)
    total += wrt_rig @ wrt_rig.T
    return total


def points_wrt_errors(
    points: Float64[Array, "n xyz=3"],
    laser: Int64[Array, "n"],
    rig: Rig,
    jacobians: "PointJacobians",
    errors: RigErrors,
) -> Float64[Array, "n xyz=3 error"]:
    """Derivatives of points with respect to the rig's independent errors of unit variance, which are common to all."""
    wrt_sheets = points_wrt_plane(points, light_normals(points, laser, rig), errors.basis[laser])
    bent = bends_of(rig)
    if bent is not None:  # an elevation of the sheet acts like a distance of its plane
        wrt_bow = wrt_sheets[:, :, 2:] * bent.of(laser).wrt_parameters(points)[:, None]
        wrt_sheets = np.concatenate([wrt_sheets, wrt_bow], axis=2)
    return np.asarray((jacobians.wrt_camera @ errors.camera + wrt_sheets @ errors.lasers[laser]) @ errors.root)


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


# Derivatives of the residuals of a ring, which are evaluated once, near the solution


def common_errors(residuals: Residuals, prior: Prior) -> FixedColumns:
    """Derivatives of the residuals by errors of rig, form and mount, then by those of single factors."""
    observations, assumed = residuals.observations, prior.assumptions
    rig, form, slope, columns = None, None, None, [np.zeros((len(residuals.residual), 0))]
    mean_ray = np.zeros((2, 0))
    errors = rig_errors(observations.rig, assumed.stability)
    if errors is not None:
        rig, mean_ray = rig_jacobian(residuals, errors)
        mean_ray = mean_ray @ errors.root
        columns.append(rig @ errors.root)
    if assumed.ring_tolerance_m > 0.0:
        form = form_jacobian(residuals)
        columns.append(form_amplitude_m(assumed.ring_tolerance_m) * form)
    if assumed.face_slope_rad > 0.0:
        slope = slope_jacobian(residuals)
        columns.append(assumed.face_slope_rad * slope[:, None])
    if residuals.wrt_camera.shape[1] and observations.camera is not None:
        covariance = observations.camera.mount.covariance
        uncertain = np.diag(covariance) > 0
        columns.append(residuals.wrt_camera @ covariance_root(covariance[np.ix_(uncertain, uncertain)]))
    shared = sum(each.shape[1] for each in columns)
    for factor, rows in observations.blocks:
        own = factor.own_errors(residuals.jacobian[rows], assumed.ring_tolerance_m)
        columns.append(np.zeros((len(residuals.residual), own.shape[1])))
        columns[-1][rows] = own
    joined = np.concatenate(columns, axis=1)
    return FixedColumns(rig, form, slope, residuals.wrt_camera, mean_ray, joined, joined.shape[1] - shared)


def rig_jacobian(
    residuals: Residuals, errors: RigErrors
) -> tuple[Float64[Array, "row parameter"], Float64[Array, "xy=2 parameter"]]:
    """Derivatives of the residuals, and of the mean of the predicted break points for a fixed ring.

    Errors of the camera move the rays of fixed pixels, errors of a light plane move the predicted stripe. The abscissae
    of predicted points are those of the measured pixels, their ordinates those of the predicted stripes.
    """
    observations, stripes, count = residuals.observations, residuals.at.stripes, len(errors.parameters)
    laser, wrt_camera = observations.laser, observations.wrt_camera
    rays = (wrt_camera.reshape(-1, len(errors.camera)) @ errors.camera).reshape(len(wrt_camera), 2, count)
    # m . r = d / depth: the cosine by the tilts is e1 . r and e2 . r; the distance acts like a cosine of -1 / depth,
    # and so does the elevation of a bent sheet
    by_sheet = [(errors.basis[laser] @ stripes.rays[:, :, None])[:, :, 0], -1.0 / stripes.depth]
    if observations.bend_m is not None:
        by_sheet.append(observations.bend_m / -stripes.depth[:, None])
    y_wrt_sheet = stripes.y_wrt_cosine[:, None] * np.column_stack(by_sheet)
    ordinates = (y_wrt_sheet[:, None] @ errors.lasers[laser])[:, 0]
    jacobian = np.zeros((len(residuals.residual), count))
    for factor, rows, _, by in _seen(residuals):
        jacobian[rows] = (factor.wrt_ray(residuals.at)[:, :, None] * rays[factor.ray]).sum(axis=1)
        if by.ordinate is not None:
            jacobian[rows] += by.ordinate * ordinates[factor.ray]
        jacobian[rows] = factor.whitened(jacobian[rows])
    points, x = observations.described, rays[: len(laser), 0]
    predicted = x, ordinates + stripes.slope[:, None] * x
    return jacobian, np.array([each[points].mean(axis=0) for each in predicted])


def form_jacobian(residuals: Residuals) -> Float64[Array, "row amplitude=18"]:
    """Derivatives of the residuals with respect to the amplitudes of the ring's form (`FORM_PARAMETERS`), Eq. (12.1).

    An axial deviation acts like an offset of the plane, a radial one like a change of its edge's radius, both at the
    angle of the row: the two ends of a line are at different angles.
    """
    at, view = residuals.at, residuals.observations.view
    phase = polar_angles(at.arcs, np.concatenate([at.stripes.rays, view.visible_rays]))[:, None] * FORM_ORDERS
    shape = np.stack([np.cos(phase), np.sin(phase)], axis=-1).reshape(len(phase), -1)
    jacobian = np.zeros((len(residuals.residual), len(FORM_PARAMETERS)))
    for factor, rows, unwhitened, by in _seen(residuals):
        deviation = np.zeros((len(unwhitened), 3))  # inner, outer, axial
        if factor.edge is not None and by.distance is not None:
            deviation[range(len(deviation)), factor.edge] -= by.distance[:, 0]
        deviation[:, 2] = unwhitened[:, 1 + LIFT]
        of_rows = deviation[:, :, None] * shape[factor.ray][:, None]
        jacobian[rows] = factor.whitened(of_rows.reshape(len(of_rows), -1))
    return jacobian


def slope_jacobian(residuals: Residuals) -> Float64[Array, "row"]:
    """Derivatives of the residuals with respect to the slope of the face, Eq. (12.3).

    The face rises outwards by the slope times the distance from its middle, and acts there like an offset of the plane.
    """
    at, arcs = residuals.at, residuals.arcs
    jacobian = np.zeros(len(residuals.residual))
    for factor, rows, unwhitened, _ in _seen(residuals):
        if factor.edge is None:
            outside_m = edge_distances(arcs, at.stripes.rays[factor.ray], np.zeros(len(unwhitened))).distance_m
        else:
            outside_m = arcs.half_band_m * np.array(EDGE_SIGN)[factor.edge]
        jacobian[rows] = factor.whitened(outside_m * unwhitened[:, 1 + LIFT])
    return jacobian


def _seen(
    residuals: Residuals,
) -> Iterator[tuple[ImageFactor, slice, Float64[Array, "row column"], Derivatives]]:
    """The factors that are seen in the image, with their rows before the whitening and the derivatives of these."""
    for factor, rows in residuals.observations.blocks:
        if isinstance(factor, ImageFactor):
            yield factor, rows, *factor.unwhitened(residuals.at)


def nuisance_columns(residuals: Residuals, fixed: FixedColumns) -> Float64[Array, "row error"]:
    """Matrix B: derivatives with respect to the rates, then the other common errors, in sigmas of their priors."""
    return np.concatenate([residuals.wrt_rates * residuals.rate_sds, fixed.columns], axis=1)
