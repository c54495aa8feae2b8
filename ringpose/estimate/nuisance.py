"""Nuisance parameters: errors that many residuals have in common (ringpose-method(7), section 5).

Light planes and camera are known with a joint covariance. The columns of its square root are independent errors of unit
variance; each one is a parameter of the fit beside the ring, with the prior N(0, 1). The common errors of the points of
a visible edge (`Edges.common`) are treated in the same way.
"""

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from ringpose.errors import DataError
from ringpose.estimate.measurements import Measurements, Observations, pixels_wrt_ray_and_camera
from ringpose.estimate.residuals import Residuals
from ringpose.geometry.rotations import tilt_basis
from ringpose.types.arrays import Array, Float64
from ringpose.types.covariance import CAMERA_PARAMETERS, PLANE_PARAMETERS
from ringpose.types.rig import Rig

_NEGLIGIBLE = 1e-12
"""Share of the correlation matrix's largest eigenvalue below which a combination of parameters counts as exact."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigErrors:
    """The uncertain parameters of a rig, and the square root R of their covariance R R^T."""

    parameters: tuple[str, ...]
    root: Float64[Array, "parameter error"]
    camera: Float64[Array, "camera parameter"]
    """Selects the parameters of the camera, rows as in `CAMERA_PARAMETERS`."""
    lasers: Float64[Array, "laser plane=3 parameter"]
    """Selects the parameters of the light planes, rows as in `PLANE_PARAMETERS`."""
    basis: Float64[Array, "laser 2 3"]


@lru_cache(maxsize=8)
def rig_errors(rig: Rig) -> RigErrors | None:
    """The errors of the rig's calibration; None if the rig has no covariance, or not a finite one.

    Parameters without variance are left out.
    """
    if rig.covariance is None or not np.isfinite(rig.covariance.data).all():
        return None
    uncertain = np.diag(rig.covariance.data) > 0
    names = tuple(name for name, kept in zip(rig.covariance.parameters, uncertain, strict=True) if kept)
    camera = np.zeros((4 + len(rig.camera.distortion_coefficients), len(names)))
    lasers = np.zeros((len(rig.lasers.names), len(PLANE_PARAMETERS), len(names)))
    for column, name in enumerate(names):
        laser, _, parameter = name.rpartition(".")
        if name in CAMERA_PARAMETERS[: len(camera)]:
            camera[CAMERA_PARAMETERS.index(name), column] = 1.0
        elif laser in rig.lasers.names and parameter in PLANE_PARAMETERS:
            lasers[rig.lasers.names.index(laser), PLANE_PARAMETERS.index(parameter), column] = 1.0
        else:
            raise DataError(
                "the rig's covariance",
                f"it names {name!r}, which is not a parameter of this rig",
                "run ringpose calibrate-planes",
            )
    root = _root(rig.covariance.data[np.ix_(uncertain, uncertain)])
    return RigErrors(parameters=names, root=root, camera=camera, lasers=lasers, basis=light_plane_bases(rig))


@lru_cache(maxsize=8)
def light_plane_bases(rig: Rig) -> Float64[Array, "laser 2 3"]:
    """The tilt basis of each light plane."""
    return np.array([tilt_basis(normal) for normal in rig.lasers.normal])


def _root(covariance: Float64[Array, "n n"]) -> Float64[Array, "n error"]:
    """R with R R^T the covariance, of correlations first: the parameters are pixels and microradians."""
    scale = np.sqrt(np.diag(covariance))
    variance, axes = np.linalg.eigh(covariance / scale[:, None] / scale)
    kept = variance > _NEGLIGIBLE * (float(variance[-1]) if len(variance) else 0.0)
    root: Float64[Array, "n error"] = scale[:, None] * axes[:, kept] * np.sqrt(variance[kept])
    return root


def rig_jacobian(
    residuals: Residuals, measured: Measurements, observations: Observations, errors: RigErrors, rig: Rig
) -> Float64[Array, "row parameter"]:
    """Derivatives of the residuals with respect to the rig's parameters, in their own units; 0 for the prior.

    Errors of the camera move the rays of fixed pixels, errors of a light plane move the predicted stripe.
    """
    ends, lines = residuals.ends, np.repeat(measured.lines.laser, 2)
    ray = _ray_wrt_rig(observations.rays[:, :2], errors, rig)
    y_wrt_planes = _ordinate_wrt_planes(residuals, np.concatenate([lines, measured.points.laser]), errors)
    above = ray[:, 1] - residuals.stripes.slope[:, None] * ray[:, 0] - y_wrt_planes
    distance = residuals.points.wrt_ray[:, 1:] * y_wrt_planes[ends:] + residuals.distance_wrt_x[:, None] * ray[ends:, 0]
    blocks = [observations.whitening @ above[:ends], residuals.distance_scale[:, None] * distance]
    which, share, scale = residuals.ordinates
    if len(which):
        blocks.append(scale[:, None] * (above[ends:][which] - share[:, None] * distance[which]))
    if len(measured.edges.edge):
        edge_ray = _ray_wrt_rig(measured.edges.ray[:, :2], errors, rig)
        by_ray = residuals.edge_scale[:, None] * residuals.edges.wrt_ray
        blocks.append((by_ray[:, :, None] * edge_ray).sum(axis=1))
    blocks.append(np.zeros((len(residuals.residual) - residuals.data_rows, len(errors.parameters))))
    jacobian: Float64[Array, "row parameter"] = np.concatenate(blocks)
    return jacobian


def mean_ray_jacobian(
    residuals: Residuals, measured: Measurements, observations: Observations, errors: RigErrors | None, rig: Rig
) -> Float64[Array, "xy=2 error"]:
    """Derivatives of the mean of the predicted break points by the rig's errors of unit variance, for a fixed ring.

    The abscissae are those of the measured pixels, the ordinates those of the predicted stripes.
    """
    if errors is None:
        return np.zeros((2, 0))
    points = slice(residuals.ends, None)
    x_wrt_rig = _ray_wrt_rig(observations.rays[points, :2], errors, rig)[:, 0]
    laser = np.concatenate([np.repeat(measured.lines.laser, 2), measured.points.laser])
    y_wrt_rig = _ordinate_wrt_planes(residuals, laser, errors)[points] + residuals.slope[:, None] * x_wrt_rig
    return np.array([x_wrt_rig.mean(axis=0), y_wrt_rig.mean(axis=0)]) @ errors.root


def edge_jacobian(residuals: Residuals, measured: Measurements) -> Float64[Array, "row error"]:
    """Derivatives of the residuals with respect to the common errors of visible edges, in their standard deviations."""
    jacobian = np.zeros((len(residuals.residual), measured.edges.common.shape[1]))
    jacobian[residuals.data_rows - len(measured.edges.edge) : residuals.data_rows] = measured.edges.common
    return jacobian


def _ray_wrt_rig(xy: Float64[Array, "n xy=2"], errors: RigErrors, rig: Rig) -> Float64[Array, "n 2 parameter"]:
    """Derivatives of the normalised coordinates of fixed pixels with respect to the rig's parameters."""
    if not errors.camera.any():
        return np.zeros((len(xy), 2, len(errors.parameters)))
    pixel_wrt_ray, pixel_wrt_camera = pixels_wrt_ray_and_camera(xy, rig.camera)
    derivative: Float64[Array, "n 2 parameter"] = -np.linalg.inv(pixel_wrt_ray) @ (pixel_wrt_camera @ errors.camera)
    return derivative


def _ordinate_wrt_planes(residuals: Residuals, laser: Array, errors: RigErrors) -> Float64[Array, "sample parameter"]:
    """Derivatives of the predicted ordinates with respect to tilts and distances of their light planes."""
    stripes = residuals.stripes
    y_wrt_tilts = (errors.basis[laser] @ stripes.y_wrt_light_normal[:, :, None])[:, :, 0]
    y_wrt_plane = np.column_stack([y_wrt_tilts, stripes.y_wrt_light_distance])
    derivative: Float64[Array, "sample parameter"] = (y_wrt_plane[:, None] @ errors.lasers[laser])[:, 0]
    return derivative
