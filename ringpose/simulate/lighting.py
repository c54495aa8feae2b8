"""What the hits of some rays send back to the camera."""

from dataclasses import dataclass

import numpy as np

from ringpose.simulate.placement import Placement
from ringpose.simulate.shading import laboratory_radiance, reflectance_per_sr, surfaces
from ringpose.simulate.sheets import Sheets, in_sheet, irradiance_w_m2
from ringpose.simulate.target import Target
from ringpose.types.arrays import Array, Bool, Float64, Int8, Int64
from ringpose.types.scene import Light

_FAR_M = 100.0
"""Nothing farther than this casts a shadow."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stand:
    """A target before the camera, and what shines on it."""

    target: Target
    placement: Placement
    sheets: Sheets
    light: Light
    lasers: tuple[int, ...]
    """Those that will be on in some frame; the others' layers stay black."""

    @property
    def is_lit(self) -> bool:
        """Whether anything shines but the lasers."""
        return self.light.ambient_w_m2 > 0 or self.light.sun_w_m2 > 0

    @property
    def to_sun(self) -> Float64[Array, "xyz=3 1"]:
        """Unit vector towards the sun, target frame."""
        return self.placement.vectors_target(_unit(self.light.sun_direction[:, None]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hits:
    """Points that rays met, in the target frame."""

    surface: Int8[Array, "hit"]
    point: Float64[Array, "xyz=3 hit"]
    normal: Float64[Array, "xyz=3 hit"]
    """Unit normals of the side that is seen."""
    to_eye: Float64[Array, "xyz=3 hit"]

    def at(self, which: Int64[Array, "chosen"]) -> "Hits":
        """Some of the hits."""
        return Hits(
            surface=self.surface[which],
            point=self.point[:, which],
            normal=self.normal[:, which],
            to_eye=self.to_eye[:, which],
        )


def settled_hits(
    stand: Stand,
    direction: Float64[Array, "xyz=3 hit"],
    parameter: Float64[Array, "hit"],
    surface: Int8[Array, "hit"],
) -> Hits:
    """The hits of rays on the surfaces with their fine relief."""
    point, normal = stand.target.settled(stand.placement.eye_m, direction, parameter, surface)
    return Hits(surface=surface, point=point, normal=normal, to_eye=-_unit(direction))


def ambient_radiance(stand: Stand, hits: Hits) -> tuple[Float64[Array, "hit"], Bool[Array, "hit"]]:
    """Radiance by laboratory and sun, and which points lie in a shadow that the sun casts."""
    light = stand.light
    radiance, shadowed = np.zeros(len(hits.surface)), np.zeros(len(hits.surface), dtype=np.bool_)
    if light.ambient_w_m2 > 0:
        material = surfaces(stand.target.materials, hits.surface)
        share = laboratory_radiance(material, hits.normal, hits.to_eye, stand.placement.rotation)
        radiance += light.ambient_w_m2 * share
    if light.sun_w_m2 > 0:
        to_sun = np.broadcast_to(stand.to_sun, hits.point.shape)
        facing = np.flatnonzero(np.einsum("ij,ij->j", hits.normal, to_sun) > 0)
        shadowed[facing] = stand.target.blocked(hits.point[:, facing], _FAR_M * to_sun[:, facing])
        lit = facing[~shadowed[facing]]
        radiance[lit] += light.sun_w_m2 * _reflected(stand, hits, lit, to_sun[:, lit])
    return radiance, shadowed


def laser_radiance(stand: Stand, hits: Hits, laser: int) -> tuple[Float64[Array, "hit"], Bool[Array, "hit"]]:
    """Radiance by one laser's sheet, and which of its points lie in the shadow that the target casts in it."""
    radiance, shadowed = np.zeros(len(hits.surface)), np.zeros(len(hits.surface), dtype=np.bool_)
    reached = np.flatnonzero(in_sheet(stand.sheets, laser, hits.point))
    to_projector = stand.sheets.projector_m[laser][:, None] - hits.point[:, reached]
    facing = np.einsum("ij,ij->j", hits.normal[:, reached], to_projector) > 0
    blocked = stand.target.blocked(hits.point[:, reached], to_projector)
    shadowed[reached] = blocked
    lit, to_projector = reached[facing & ~blocked], to_projector[:, facing & ~blocked]
    irradiance = irradiance_w_m2(stand.sheets, laser, hits.point[:, lit])
    radiance[lit] = irradiance * _reflected(stand, hits, lit, _unit(to_projector))
    return radiance, shadowed


def _reflected(
    stand: Stand, hits: Hits, lit: Int64[Array, "lit"], to_light: Float64[Array, "xyz=3 lit"]
) -> Float64[Array, "lit"]:
    """Radiance for each W/m2 across the light's direction."""
    normal, material = hits.normal[:, lit], surfaces(stand.target.materials, hits.surface[lit])
    cosine = np.einsum("ij,ij->j", normal, to_light)
    radiance: Float64[Array, "lit"] = cosine * reflectance_per_sr(material, normal, to_light, hits.to_eye[:, lit])
    return radiance


def _unit(vector: Float64[Array, "xyz=3 n"]) -> Float64[Array, "xyz=3 n"]:
    unit: Float64[Array, "xyz=3 n"] = vector / np.sqrt(np.einsum("ij,ij->j", vector, vector))
    return unit
