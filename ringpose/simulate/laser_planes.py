"""Light sheets of the lasers: geometry and irradiance."""

from dataclasses import dataclass

import numpy as np

from ringpose.simulate.placement import Placement
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.rig import LaserPlanes
from ringpose.types.scene import LaserLight

MAX_DISTANCE_SIGMAS = 4.5
"""Distance from the plane, in sigmas of the thickness, beyond which the light is neglected: 4e-5 of the peak."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Sheets:
    """The light planes in a target's frame."""

    normal: Float64[Array, "laser xyz=3"]
    distance_m: Float64[Array, "laser"]
    projector_m: Float64[Array, "laser xyz=3"]
    axis: Float64[Array, "laser xyz=3"]
    """Central direction of each fan, a unit vector in its plane."""
    light: LaserLight


def sheets(planes: LaserPlanes, light: LaserLight, placement: Placement) -> Sheets:
    """The light planes of the rig in the frame of a target."""
    normal = placement.vectors_target(planes.normal.T).T
    axes = np.array([0.0, 0.0, 1.0]) - planes.normal[:, 2:] * planes.normal
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    return Sheets(
        normal=normal,
        distance_m=planes.distance_m - planes.normal @ placement.translation_m,
        projector_m=placement.points_target(planes.projector_m.T).T,
        axis=placement.vectors_target(axes.T).T,
        light=light,
    )


def half_thickness_m(light: LaserLight, range_m: Float64[Array, "n"]) -> Float64[Array, "n"]:
    """Standard deviation of the sheet's thickness at a distance from the projector."""
    thickness: Float64[Array, "n"] = np.hypot(light.sigma_m, light.divergence_rad * range_m)
    return thickness


def in_sheet(
    sheet: Sheets, laser: int, point: Float64[Array, "xyz=3 n"], slack_m: Float64[Array, "n"] | float = 0.0
) -> Bool[Array, "n"]:
    """Whether the sheet of a laser passes within `slack_m` of the points; occlusion is not considered."""
    off_m = np.abs(sheet.normal[laser] @ point - sheet.distance_m[laser])
    reach_m = MAX_DISTANCE_SIGMAS * _farthest_half_thickness_m(sheet, laser, point)
    near: Bool[Array, "n"] = off_m < reach_m + slack_m
    return near


def irradiance_w_m2(sheet: Sheets, laser: int, point: Float64[Array, "xyz=3 n"]) -> Float64[Array, "n"]:
    """Irradiance normal to the light: power of the fan per arc length, times the Gaussian across the sheet."""
    range_m = np.maximum(np.linalg.norm(point - sheet.projector_m[laser][:, None], axis=0), 1e-6)
    sigma_m = half_thickness_m(sheet.light, range_m)
    off_m = sheet.normal[laser] @ point - sheet.distance_m[laser]
    across = np.exp(-0.5 * (off_m / sigma_m) ** 2) / (np.sqrt(2 * np.pi) * sigma_m)
    return np.where(in_fan(sheet, laser, point), sheet.light.power_w / (sheet.light.fan_rad * range_m) * across, 0.0)


def in_fan(sheet: Sheets, laser: int, point: Float64[Array, "xyz=3 n"]) -> Bool[Array, "n"]:
    """Whether points lie within the fan angle."""
    from_projector = point - sheet.projector_m[laser][:, None]
    along = sheet.axis[laser] @ from_projector
    aside = np.cross(sheet.normal[laser], sheet.axis[laser]) @ from_projector
    inside: Bool[Array, "n"] = np.abs(np.arctan2(aside, along)) <= sheet.light.fan_rad / 2
    return inside


def _farthest_half_thickness_m(sheet: Sheets, laser: int, point: Float64[Array, "xyz=3 n"]) -> float:
    """Maximum over all points: a single bound is enough, because sheets diverge little and most points are far away."""
    if sheet.light.divergence_rad == 0.0 or not point.shape[1]:
        return sheet.light.sigma_m
    from_projector = point - sheet.projector_m[laser][:, None]
    range_m = np.sqrt(np.einsum("ij,ij->j", from_projector, from_projector).max())
    return float(half_thickness_m(sheet.light, np.array([range_m]))[0])
