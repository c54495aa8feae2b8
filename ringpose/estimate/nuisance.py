"""Nuisance parameters: errors that many residuals have in common (ringpose-method(7), section 5).

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
from ringpose.estimate.measurements import Measurements, Observations
from ringpose.estimate.residuals import FixedColumns, Prior, Residuals
from ringpose.geometry.rays import pixels_wrt_ray_and_camera
from ringpose.geometry.ring import EDGE_SIGN, HALF_BAND, LIFT, polar_angles
from ringpose.geometry.rotations import tilt_basis
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import RigStability
from ringpose.types.rig import CAMERA_PARAMETERS, PLANE_PARAMETERS, ParameterCovariance, Rig, laser_parameters

_NEGLIGIBLE = 1e-12
"""Share of the correlation matrix's largest eigenvalue below which a combination of parameters counts as exact."""


EXACT = RigStability()
"""Of a rig that has not changed since its calibration."""

FOCAL_RATIO = "focal_ratio"
"""Change of both focal lengths together, relative to them."""

FORM_ORDERS = (2, 3, 4)
"""Orders of a ring's deviations from circle and plane; 0 and 1 are radius, centre, offset and tilt."""

FORM_PARAMETERS = tuple(
    f"form.{what}.{axis}{order}" for what in ("inner", "outer", "axial") for order in FORM_ORDERS for axis in "ab"
)
"""Amplitudes in metres: radial deviation of each edge and axial deviation of the face, a_k cos(k phi) + b_k sin(k phi),
with the angle phi from the middle of the arc that was seen."""


WALL_SD_M = 0.03
"""Standard deviation of the depth of a wall's foot below the face: interface rings are 10 to 60 mm high."""


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
                "run ringpose calibrate-planes",
            )
    root = covariance_root(total.data[np.ix_(uncertain, uncertain)])
    return RigErrors(parameters=names, root=root, camera=camera, lasers=lasers, basis=light_plane_bases(rig))


def total_covariance(rig: Rig, stability: RigStability) -> ParameterCovariance:
    """The covariance of the rig's parameters: of its calibration, if it is known and finite, plus its stability.

    Since the calibration, each plane's tilts and distance, and both focal lengths together, may have changed.
    That of a plane that was corrected is the one of its correction.
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
    """R with R R^T the covariance, of correlations first: the parameters are pixels and microradians.

    Parameters without variance have zero rows.
    """
    scale = np.sqrt(np.maximum(np.diag(covariance), np.finfo(float).tiny))
    variance, axes = np.linalg.eigh(covariance / scale[:, None] / scale)
    kept = variance > _NEGLIGIBLE * (float(variance[-1]) if len(variance) else 0.0)
    root: Float64[Array, "n error"] = scale[:, None] * axes[:, kept] * np.sqrt(variance[kept])
    return root


def fixed_columns(residuals: Residuals, observations: Observations, prior: Prior, rig: Rig) -> FixedColumns:
    """Derivatives by the errors of rig, form, mount and visible edges."""
    measured = observations.measured
    by_rig, form, columns = None, None, [np.zeros((len(residuals.residual), 0))]
    mean_ray = np.zeros((2, 0))
    errors = rig_errors(rig, prior.assumptions.stability)
    if errors is not None:
        by_rig, mean_ray = _wrt_rig(residuals, observations, errors, rig)
        mean_ray = mean_ray @ errors.root
        columns.append(by_rig @ errors.root)
    if prior.assumptions.ring_tolerance_m > 0.0:
        form = form_jacobian(residuals, measured)
        columns.append(form_sd_m(prior.assumptions.ring_tolerance_m) * form)
    if residuals.wrt_camera.shape[1] and measured.camera is not None:
        variance = measured.camera.mount.covariance
        uncertain = np.diag(variance) > 0
        columns.append(residuals.wrt_camera @ covariance_root(variance[np.ix_(uncertain, uncertain)]))
    columns.append(edge_jacobian(residuals, measured))
    return FixedColumns(
        by_rig, form, residuals.wrt_camera, mean_ray, np.concatenate(columns, axis=1), columns[-1].shape[1]
    )


def rig_jacobian(
    residuals: Residuals, observations: Observations, errors: RigErrors, rig: Rig
) -> Float64[Array, "row parameter"]:
    """Derivatives of the residuals with respect to the rig's parameters, in their own units; 0 for the prior."""
    return _wrt_rig(residuals, observations, errors, rig)[0]


def _wrt_rig(
    residuals: Residuals, observations: Observations, errors: RigErrors, rig: Rig
) -> tuple[Float64[Array, "row parameter"], Float64[Array, "xy=2 parameter"]]:
    """Derivatives of the residuals, and of the mean of the predicted break points for a fixed ring.

    Errors of the camera move the rays of fixed pixels, errors of a light plane move the predicted stripe. Of predicted
    points, the abscissae are those of the measured pixels, the ordinates those of the predicted stripes.
    """
    measured, ends, stripes = observations.measured, residuals.ends, residuals.stripes
    samples = len(observations.view.rays)
    rays = _rays_wrt_rig(np.concatenate([observations.view.rays, observations.view.visible_rays]), errors, rig)
    ray, edge_ray = rays[:samples], rays[samples:]
    laser = np.concatenate([np.repeat(measured.lines.laser, 2), measured.points.laser])
    y_wrt_tilts = (errors.basis[laser] @ stripes.y_wrt_light_normal[:, :, None])[:, :, 0]
    y_wrt_plane = np.column_stack([y_wrt_tilts, stripes.y_wrt_light_distance])
    predicted_y = (y_wrt_plane[:, None] @ errors.lasers[laser])[:, 0]
    sloped = stripes.slope[:, None] * ray[:, 0]
    above = ray[:, 1] - sloped - predicted_y
    distance = residuals.points.wrt_ray[:, 1:] * predicted_y[ends:] + residuals.distance_wrt_x[:, None] * ray[ends:, 0]
    blocks = [observations.whitening @ above[:ends], residuals.distance_scale[:, None] * distance]
    which, share, scale = residuals.ordinates
    if len(which):
        blocks.append(scale[:, None] * (above[ends:][which] - share[:, None] * distance[which]))
    if len(edge_ray):
        by_ray = residuals.edge_scale[:, None] * residuals.edges.wrt_ray
        blocks.append((by_ray[:, :, None] * edge_ray).sum(axis=1))
    blocks.append(np.zeros((len(residuals.residual) - residuals.data_rows, len(errors.parameters))))
    mean_ray = np.array([ray[ends:, 0].mean(axis=0), (predicted_y + sloped)[ends:].mean(axis=0)])
    return np.concatenate(blocks), mean_ray


def form_sd_m(tolerance_m: float) -> float:
    """Standard deviation of each amplitude, so that the deviation at any angle has the tolerance as its own."""
    return tolerance_m / sqrt(len(FORM_ORDERS))


def form_jacobian(residuals: Residuals, measured: Measurements) -> Float64[Array, "row amplitude=18"]:
    """Derivatives of the residuals with respect to the amplitudes of the ring's form (`FORM_PARAMETERS`), Eq. (12.1).

    An axial deviation acts like an offset of the plane, a radial one like a change of its edge's radius, both at the
    angle of the row.
    """
    isolated = np.flatnonzero(measured.points.isolated)
    rays = residuals.stripes.rays
    angle = polar_angles(residuals.arcs, np.concatenate([rays, rays[residuals.ends :][isolated], measured.edges.ray]))
    edge = [np.full(residuals.ends, -1), measured.points.edge, measured.points.edge[isolated], measured.edges.edge]
    of_edge = np.concatenate(edge)
    shape = np.column_stack([wave(order * angle) for order in FORM_ORDERS for wave in (np.cos, np.sin)])
    jacobian = np.zeros((len(residuals.residual), len(FORM_PARAMETERS)))
    data, count = jacobian[: residuals.data_rows], shape.shape[1]
    for number, sign in enumerate(EDGE_SIGN):  # the increment HALF_BAND moves the outer edge outward, the inner inward
        radial = np.where(of_edge == number, sign * residuals.jacobian[: residuals.data_rows, HALF_BAND], 0.0)
        data[:, number * count : (number + 1) * count] = radial[:, None] * shape
    data[:, 2 * count :] = residuals.jacobian[: residuals.data_rows, LIFT, None] * shape
    return jacobian


def edge_jacobian(residuals: Residuals, measured: Measurements) -> Float64[Array, "row error"]:
    """Derivatives of the residuals with respect to the common errors of visible edges, in their standard deviations.

    What looks like an edge may be the foot of the ring's wall where the camera sees the wall and it is as bright as the
    face. Beside several stripes such an edge contradicts them; a single one leaves the tilt about it to the edges, and
    a tilt has the same effect. The depth of the foot below the face is then an error of each edge.
    """
    rows = slice(residuals.data_rows - len(measured.edges.edge), residuals.data_rows)
    columns = [measured.edges.common] if len(measured.edges.edge) else []
    if columns and measured.edges.walls and len(measured.lasers) == 1:
        outward = residuals.edge_scale * residuals.edges.wrt_step[:, LIFT]
        of_edge = measured.edges.edge[:, None] == range(len(EDGE_SIGN))
        wall_seen = of_edge & (outward[:, None] * EDGE_SIGN > 0.0)
        columns.append(WALL_SD_M * wall_seen * outward[:, None])
    jacobian = np.zeros((len(residuals.residual), sum(each.shape[1] for each in columns)))
    if columns:
        jacobian[rows] = np.concatenate(columns, axis=1)
    return jacobian


def _rays_wrt_rig(rays: Float64[Array, "n xyz=3"], errors: RigErrors, rig: Rig) -> Float64[Array, "n 2 parameter"]:
    """Derivatives of the normalised coordinates of fixed pixels with respect to the rig's parameters."""
    if not errors.camera.any():
        return np.zeros((len(rays), 2, len(errors.parameters)))
    pixel_wrt_ray, pixel_wrt_camera = pixels_wrt_ray_and_camera(rays[:, :2], rig.camera)
    derivative: Float64[Array, "n 2 parameter"] = -np.linalg.inv(pixel_wrt_ray) @ (pixel_wrt_camera @ errors.camera)
    return derivative
