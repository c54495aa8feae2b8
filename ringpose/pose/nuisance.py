"""How errors that many residuals have in common move them.

Light planes and camera are known with a joint covariance. Its square root says how independent unit errors move the
parameters; each of them is an unknown of the fit beside the ring, held to zero by its own unit (ringpose-method(7),
section 5: the rig's covariance, carried over to first order).
"""

from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ringpose.errors import DataError
from ringpose.geometry.rotations import tilt_basis
from ringpose.pose.measurements import Measurements, Observations, pixels_by_ray_and_camera
from ringpose.pose.residuals import RingState, Rows, Sights
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.covariance import CAMERA_PARAMETERS, PLANE_PARAMETERS
from ringpose.types.rig import Rig

_NEGLIGIBLE = 1e-12
"""Share of the correlations' largest eigenvalue under which a direction of correlated parameters counts as known."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigErrors:
    """The square root of the rig's covariance by places."""

    camera: Float64[Array, "camera error"]
    """Rows as in `CAMERA_PARAMETERS`; zeros for what is not in the covariance."""
    lasers: Float64[Array, "laser plane=3 error"]
    """Rows as in `PLANE_PARAMETERS`."""
    basis: Float64[Array, "laser 2 3"]


@lru_cache(maxsize=8)
def rig_errors(rig: Rig) -> RigErrors | None:
    """None if nothing is known of them."""
    if rig.covariance is None or not np.isfinite(rig.covariance.data).all():
        return None
    root = _root(rig.covariance.data)
    camera = np.zeros((4 + len(rig.camera.distortion_coefficients), root.shape[1]))
    lasers = np.zeros((len(rig.lasers.names), len(PLANE_PARAMETERS), root.shape[1]))
    for name, row in zip(rig.covariance.parameters, root, strict=True):
        laser, _, what = name.rpartition(".")
        if name in CAMERA_PARAMETERS[: len(camera)]:
            camera[CAMERA_PARAMETERS.index(name)] = row
        elif laser in rig.lasers.names and what in PLANE_PARAMETERS:
            lasers[rig.lasers.names.index(laser), PLANE_PARAMETERS.index(what)] = row
        else:
            raise DataError(
                "the rig's covariance",
                f"it names {name!r}, which is no parameter of this rig",
                "run ringpose calibrate-planes",
            )
    return RigErrors(camera=camera, lasers=lasers, basis=light_plane_bases(rig))


@lru_cache(maxsize=8)
def light_plane_bases(rig: Rig) -> Float64[Array, "laser 2 3"]:
    """The tilt basis of each light plane."""
    return np.array([tilt_basis(normal) for normal in rig.lasers.normal])


def _root(covariance: Float64[Array, "n n"]) -> Float64[Array, "n error"]:
    """R with R R^T the covariance; parameters are first brought to one scale: pixels beside microradians."""
    deviation = np.sqrt(np.diag(covariance))
    scale = np.where(deviation > 0, deviation, 1.0)
    variance, axes = np.linalg.eigh(covariance / scale[:, None] / scale)
    kept = variance > _NEGLIGIBLE * max(float(variance[-1]), 0.0)
    root: Float64[Array, "n error"] = scale[:, None] * axes[:, kept] * np.sqrt(variance[kept])
    return root


class ByRig(NamedTuple):
    """Derivatives by unit errors that residuals have in common, most of them the rig's."""

    rows: Float64[Array, "row error"]
    """Of the residuals; zero for what is known beforehand."""
    mean: Float64[Array, "error"]
    """Of the mean of the break points, along the band."""


def rows_by_common_errors(
    state: RingState, rows: Rows, measured: Measurements, sighted: Observations, errors: RigErrors | None, rig: Rig
) -> ByRig | None:
    """How what many residuals have in common moves them: a wrong rig, a wrong place or lean of a whole visible edge.

    None if there is nothing of that.
    """
    found = None if errors is None else rows_by_rig(state, rows, measured, sighted, errors, rig)
    if rows.edges is None:
        return found
    alike = rows_by_edge_errors(measured, len(rows.residual), rows.ends + len(rows.by_x) + len(rows.across.which))
    if found is None:
        return alike
    return ByRig(np.column_stack([found.rows, alike.rows]), np.append(found.mean, alike.mean))


def rows_by_edge_errors(measured: Measurements, count: int, first: int) -> ByRig:
    """How what the points of a visible edge err alike moves so many residuals, of which theirs begin at `first`."""
    common = np.zeros((count, measured.edges.common.shape[1]))
    common[first : first + len(measured.edges.edge)] = measured.edges.common
    return ByRig(common, np.zeros(common.shape[1]))


def rows_by_rig(
    state: RingState, rows: Rows, measured: Measurements, sighted: Observations, errors: RigErrors, rig: Rig
) -> ByRig:
    """How a wrong rig moves the residuals."""
    ends = rows.ends
    laser = np.concatenate([np.repeat(measured.lines.laser, 2), measured.points.laser])
    shift = _ray_shift(sighted.rays[:, :2], errors, rig)
    predicted = _ordinate_shift(rows.sights, laser, state, errors)
    above = shift[:, 1] - rows.sights.slope[:, None] * shift[:, 0] - predicted
    tips, y_shift = shift[ends:, 0], predicted[ends:]
    distance = rows.arcs.by_ray[:, 1:] * y_shift + rows.by_x[:, None] * tips
    parts = [sighted.whitening @ above[:ends], rows.along_scale[:, None] * distance]

    which, share, scale = rows.across
    if len(which):
        parts.append(scale[:, None] * (above[ends:][which] - share[:, None] * distance[which]))
    if rows.edges is not None:
        seen = _ray_shift(measured.edges.ray[:, :2], errors, rig)
        parts.append((rows.edges.by_ray[:, :, None] * seen).sum(axis=1))
    parts.append(np.zeros((len(rows.residual) - sum(map(len, parts)), parts[0].shape[-1])))
    mean = np.stack([tips.sum(axis=0), (y_shift + rows.slope[:, None] * tips).sum(axis=0)]) / len(tips)
    return ByRig(np.concatenate(parts), state.along @ rows.origin.by_ray @ mean)


def _ray_shift(xy: Float64[Array, "n xy=2"], errors: RigErrors, rig: Rig) -> Float64[Array, "n 2 error"]:
    """How normalised coordinates of fixed pixels move with the camera's parameters."""
    if not errors.camera.any():
        return np.zeros((len(xy), 2, errors.camera.shape[1]))
    by_ray, by_camera = pixels_by_ray_and_camera(xy, rig.camera)
    shift: Float64[Array, "n 2 error"] = -np.linalg.inv(by_ray) @ (by_camera @ errors.camera)
    return shift


def _ordinate_shift(
    sights: Sights, laser: Int64[Array, "sight"], state: RingState, errors: RigErrors
) -> Float64[Array, "sight error"]:
    """How the predicted ordinate moves with the light plane, at constant abscissa: -(dm - dd q) . r / (m - d q)_y."""
    along = (errors.basis[laser] @ sights.rays[:, :, None])[:, :, 0]
    by_plane = np.column_stack([-along, sights.rays @ state.plane]) / sights.denominator[:, None]
    return (by_plane[:, None] @ errors.lasers[laser])[:, 0]
