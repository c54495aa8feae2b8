"""Nuisance parameters: errors that many residuals have in common (ringpose-method(7), section 5).

Light planes and camera are known with a joint covariance. The columns of its square root are independent errors of unit
variance; each one is a parameter of the fit beside the ring, with the prior N(0, 1). The common errors of the points of
a visible edge (`Edges.common`) are treated in the same way.
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ringpose.errors import DataError
from ringpose.estimate.measurements import Measurements, Observations, pixels_wrt_ray_and_camera
from ringpose.estimate.residuals import Residuals, RingState, StripePrediction
from ringpose.geometry.rotations import tilt_basis
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.covariance import CAMERA_PARAMETERS, PLANE_PARAMETERS
from ringpose.types.rig import Rig

_NEGLIGIBLE = 1e-12
"""Share of the correlation matrix's largest eigenvalue below which a combination of parameters counts as exact."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigErrors:
    """The square root of the rig's covariance, by camera and laser."""

    camera: Float64[Array, "camera error"]
    """Rows as in `CAMERA_PARAMETERS`; zeros for what is not in the covariance."""
    lasers: Float64[Array, "laser plane=3 error"]
    """Rows as in `PLANE_PARAMETERS`."""
    basis: Float64[Array, "laser 2 3"]


@lru_cache(maxsize=8)
def rig_errors(rig: Rig) -> RigErrors | None:
    """The errors of the rig's calibration; None if the rig has no covariance, or not a finite one."""
    if rig.covariance is None or not np.isfinite(rig.covariance.data).all():
        return None
    root = _root(rig.covariance.data)
    camera = np.zeros((4 + len(rig.camera.distortion_coefficients), root.shape[1]))
    lasers = np.zeros((len(rig.lasers.names), len(PLANE_PARAMETERS), root.shape[1]))
    for name, row in zip(rig.covariance.parameters, root, strict=True):
        laser, _, parameter = name.rpartition(".")
        if name in CAMERA_PARAMETERS[: len(camera)]:
            camera[CAMERA_PARAMETERS.index(name)] = row
        elif laser in rig.lasers.names and parameter in PLANE_PARAMETERS:
            lasers[rig.lasers.names.index(laser), PLANE_PARAMETERS.index(parameter)] = row
        else:
            raise DataError(
                "the rig's covariance",
                f"it names {name!r}, which is not a parameter of this rig",
                "run ringpose calibrate-planes",
            )
    return RigErrors(camera=camera, lasers=lasers, basis=light_plane_bases(rig))


@lru_cache(maxsize=8)
def light_plane_bases(rig: Rig) -> Float64[Array, "laser 2 3"]:
    """The tilt basis of each light plane."""
    return np.array([tilt_basis(normal) for normal in rig.lasers.normal])


def _root(covariance: Float64[Array, "n n"]) -> Float64[Array, "n error"]:
    """R with R R^T the covariance, of correlations first: the parameters are pixels and microradians."""
    deviation = np.sqrt(np.diag(covariance))
    scale = np.where(deviation > 0, deviation, 1.0)
    variance, axes = np.linalg.eigh(covariance / scale[:, None] / scale)
    kept = variance > _NEGLIGIBLE * max(float(variance[-1]), 0.0)
    root: Float64[Array, "n error"] = scale[:, None] * axes[:, kept] * np.sqrt(variance[kept])
    return root


class NuisanceJacobian(NamedTuple):
    """B: derivatives with respect to common errors of unit variance, the rig's first, then the visible edges'."""

    residual: Float64[Array, "row error"]
    """Of the residuals; 0 for the prior."""
    mean: Float64[Array, "error"]
    """Of the mean of the break points, along the band, in metres."""

    def information(self, weights: Float64[Array, "row"]) -> Float64[Array, "error error"]:
        """1 + B^T W B: information of prior and weighted residuals on the common errors."""
        information: Float64[Array, "error error"] = (self.residual.T * weights) @ self.residual
        information.flat[:: len(information) + 1] += 1.0
        return information


def nuisance_jacobian(
    state: RingState,
    residuals: Residuals,
    measured: Measurements,
    observations: Observations,
    errors: RigErrors | None,
    rig: Rig,
) -> NuisanceJacobian | None:
    """The derivatives with respect to the rig's errors and those of visible edges; None if there are neither."""
    of_rig = None if errors is None else rig_jacobian(state, residuals, measured, observations, errors, rig)
    if residuals.edges is None:
        return of_rig
    first = residuals.ends + len(residuals.distance_wrt_x) + len(residuals.ordinates.which)
    of_edges = np.zeros((len(residuals.residual), measured.edges.common.shape[1]))
    of_edges[first : first + len(measured.edges.edge)] = measured.edges.common
    if of_rig is None:
        return NuisanceJacobian(of_edges, np.zeros(of_edges.shape[1]))
    return NuisanceJacobian(
        np.column_stack([of_rig.residual, of_edges]), np.append(of_rig.mean, np.zeros(of_edges.shape[1]))
    )


def rig_jacobian(
    state: RingState,
    residuals: Residuals,
    measured: Measurements,
    observations: Observations,
    errors: RigErrors,
    rig: Rig,
) -> NuisanceJacobian:
    """The derivatives with respect to the rig's errors: camera errors move the rays, plane errors the predictions."""
    ends = residuals.ends
    laser = np.concatenate([np.repeat(measured.lines.laser, 2), measured.points.laser])
    ray = _ray_wrt_camera(observations.rays[:, :2], errors, rig)
    ordinate = _ordinate_wrt_planes(residuals.stripes, laser, state, errors)
    above = ray[:, 1] - residuals.stripes.slope[:, None] * ray[:, 0] - ordinate
    x, y = ray[ends:, 0], ordinate[ends:]
    distance = residuals.circles.wrt_ray[:, 1:] * y + residuals.distance_wrt_x[:, None] * x
    blocks = [observations.whitening @ above[:ends], residuals.distance_scale[:, None] * distance]

    which, share, scale = residuals.ordinates
    if len(which):
        blocks.append(scale[:, None] * (above[ends:][which] - share[:, None] * distance[which]))
    if residuals.edges is not None:
        edge_ray = _ray_wrt_camera(measured.edges.ray[:, :2], errors, rig)
        blocks.append((residuals.edges.wrt_ray[:, :, None] * edge_ray).sum(axis=1))
    blocks.append(np.zeros((len(residuals.residual) - sum(map(len, blocks)), blocks[0].shape[-1])))  # the prior
    mean_ray = np.stack([x.sum(axis=0), (y + residuals.slope[:, None] * x).sum(axis=0)]) / len(x)
    return NuisanceJacobian(np.concatenate(blocks), state.tangent @ residuals.origin.wrt_ray @ mean_ray)


def _ray_wrt_camera(xy: Float64[Array, "n xy=2"], errors: RigErrors, rig: Rig) -> Float64[Array, "n 2 error"]:
    """Derivatives of the normalised coordinates of fixed pixels with respect to the camera's errors."""
    if not errors.camera.any():
        return np.zeros((len(xy), 2, errors.camera.shape[1]))
    pixel_wrt_ray, pixel_wrt_camera = pixels_wrt_ray_and_camera(xy, rig.camera)
    derivative: Float64[Array, "n 2 error"] = -np.linalg.inv(pixel_wrt_ray) @ (pixel_wrt_camera @ errors.camera)
    return derivative


def _ordinate_wrt_planes(
    stripes: StripePrediction, laser: Int64[Array, "sample"], state: RingState, errors: RigErrors
) -> Float64[Array, "sample error"]:
    """Derivatives of the predicted ordinates with respect to the planes' errors: -(dm - dd q) . r / (m - d q)_y."""
    along = (errors.basis[laser] @ stripes.rays[:, :, None])[:, :, 0]
    y_wrt_plane = np.column_stack([-along, stripes.rays @ state.plane]) / stripes.denominator[:, None]
    return (y_wrt_plane[:, None] @ errors.lasers[laser])[:, 0]
