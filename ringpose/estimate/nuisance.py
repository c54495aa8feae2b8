"""Errors that many residuals have in common, nuisance parameters of the fit (ringpose-method(7), section 5).

Light planes and camera are known with a joint covariance, that of the calibration plus what may have changed since
(section 11). The columns of its square root are independent errors of unit variance; each one is a parameter of the fit
beside the ring, with the prior N(0, 1). The rates of a moving target (section 8), the form of a real ring (section 12)
and the common errors of the points of a visible edge are treated in the same way.

Errors of neighbouring points of a visible edge are correlated, as they come from what lies beside the edge: the foil
behind it, a wall, a shadow. The correlation exp(-distance / length) is represented by the first terms of its
Karhunen-Loeve series (`common_errors_px`).
"""

import math
from dataclasses import dataclass, replace
from functools import lru_cache
from math import sqrt

import numpy as np

from ringpose.errors import DataError
from ringpose.geometry.rays import pixels_wrt_ray_and_camera
from ringpose.geometry.rotations import tilt_basis
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.assumptions import RigStability
from ringpose.types.detection import RingEdgePoints
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
    wrt_planes = points_wrt_plane(points, rig.lasers.normal[laser], errors.basis[laser]) @ errors.lasers[laser]
    return np.asarray((jacobians.wrt_camera @ errors.camera + wrt_planes) @ errors.root)


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


# Visible edges

ROUNDED_PX = 0.05
"""Standard deviation of the common displacement of an edge: half the brightness on a rounded corner."""

CORRELATED_SHARE = 0.4
"""Share of a point's standard deviation that is correlated with its neighbours; maximum-likelihood estimate from 60
edges of rendered rings before foil, walls and shadows, which a constant error in pixels explains far worse."""

CORRELATION_LENGTH_PX = 150.0
"""Correlation length along the edge, estimated from the same edges (100 and 200 are nearly as likely)."""

TERMS = 8
"""Terms of the series; further ones have less variance than the points' independent errors."""

FRAME_PX = 0.03
"""Standard deviation of the displacement of an edge in one frame against another, by what shades or passes behind it
and differs between them; measured on rendered rings with gaps, in the sun, 6 ms apart."""

FRAMES = 2
"""Number of frames in which the edges of a moving ring are measured."""

ERRORS = 2 * (1 + TERMS + FRAMES)
"""Number of common errors of a shot: one displacement, the terms of the series and one in each frame, for each edge."""

SHORT_SERIES = 1.5
"""Factor on the autocorrelation time: a circle fitted to a short series removes part of the correlation."""

MAX_SHARE_OF_LENGTH = 3
"""Largest lag as a fraction 1 / 3 of the number of points; longer lags have too few pairs."""


def common_errors_px(edges: RingEdgePoints) -> Float64[Array, "visible error"]:
    """Displacement of each point along its normal by common errors of unit variance; 0 for errors of the other edge."""
    errors = np.zeros((len(edges.edge), 2, ERRORS // 2))
    frame = np.zeros(len(edges.edge), dtype=np.int64)
    if edges.stamp_s is not None:
        frame = np.minimum(np.unique(edges.stamp_s, return_inverse=True)[1], FRAMES - 1)
    for edge in (0, 1):
        members = np.flatnonzero(edges.edge == edge)
        if len(members):
            errors[members, edge, 0] = ROUNDED_PX
            along_px = _along_px(edges.position_px[members], edges.normal[members])
            if frame.any():
                errors[members, edge, 1 + TERMS + frame[members]] = FRAME_PX
            errors[members, edge, 1 : 1 + TERMS] = (
                CORRELATED_SHARE * edges.sigma_px[members, None] * karhunen_loeve_terms(along_px)
            )
    return errors.reshape(len(errors), ERRORS)


def karhunen_loeve_terms(along_px: Float64[Array, "n"]) -> Float64[Array, "n term"]:
    """Square root of the covariance exp(-distance / `CORRELATION_LENGTH_PX`): its largest eigenfunctions.

    sqrt(variance) cos(phase t) and sin(phase t) in turn, t from -1 to 1 along the edge (Ghanem and Spanos 1991, 2.3).
    """
    first, last = float(along_px.min()), float(along_px.max())
    half_px = max(0.5 * (last - first), 1.0)
    lengths = half_px / CORRELATION_LENGTH_PX
    # phase p of each term at the end of the edge: p = k pi/2 + atan(lengths / p), by Newton's method from above
    quarter = 0.5 * np.pi * np.arange(TERMS)
    phase: Float64[Array, "term"] = np.maximum(quarter, math.sqrt(lengths / (1.0 + lengths)))
    for _ in range(6):
        error = phase - quarter - np.arctan(lengths / phase)
        phase = phase - error / (1.0 + lengths / (phase**2 + lengths**2))
    sign = np.where(np.arange(TERMS) % 2, -1.0, 1.0)
    amplitude = np.sqrt(2.0 * lengths / (lengths**2 + phase**2))
    amplitude /= np.sqrt(1.0 + sign * np.sin(2.0 * phase) / (2.0 * phase))
    angle = ((along_px - 0.5 * (first + last)) / half_px)[:, None] * phase
    terms: Float64[Array, "n term"] = amplitude * np.where(sign > 0, np.cos(angle), np.sin(angle))
    return terms


def _along_px(position_px: Float64[Array, "n xy=2"], normal: Float64[Array, "n xy=2"]) -> Float64[Array, "n"]:
    """Positions along the edge: perpendicular to the mean normal of its points."""
    normal_x, normal_y = normal.sum(axis=0)
    length = math.hypot(normal_x, normal_y) or 1.0
    along_px: Float64[Array, "n"] = (position_px[:, 1] * normal_x - position_px[:, 0] * normal_y) / length
    return along_px


def integrated_autocorrelation_time(series: Float64[Array, "n"]) -> float:
    """Variance of the mean of a series, relative to that of as many independent standard normal numbers; at least 1.

    It is the variance plus twice the autocovariances up to the first one that is not positive (Geyer's initial
    sequence).
    """
    clipped = np.clip(series, -3.0, 3.0)
    variance = total = float(clipped @ clipped) / len(clipped)
    for lag in range(1, len(clipped) // MAX_SHARE_OF_LENGTH):
        autocovariance = float(clipped[lag:] @ clipped[:-lag]) / len(clipped)
        if autocovariance <= 0:
            break
        total += 2.0 * autocovariance
    return max(1.0, SHORT_SERIES * total if total > variance else variance)
