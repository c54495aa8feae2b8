"""What the hits of some rays send back to the camera.

How much light a lit surface sends towards the camera.

Points, normals and directions are arrays (xyz, ray); a normal points to the side that is seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringpose.simulate.laser_planes import Sheets, in_sheet, irradiance_w_m2
from ringpose.simulate.placement import Placement
from ringpose.simulate.target import Target
from ringpose.types.arrays import Array, Bool, Float64, Int8, Int64
from ringpose.types.scene import Light, Material

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
class Intersections:
    """Points that rays met, in the target frame."""

    surface: Int8[Array, "hit"]
    point: Float64[Array, "xyz=3 hit"]
    normal: Float64[Array, "xyz=3 hit"]
    """Unit normals of the side that is seen."""
    to_eye: Float64[Array, "xyz=3 hit"]

    def at(self, which: Int64[Array, "chosen"]) -> "Intersections":
        """Some of the hits."""
        return Intersections(
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
) -> Intersections:
    """The hits of rays on the surfaces with their fine relief."""
    point, normal = stand.target.settled(stand.placement.eye_m, direction, parameter, surface)
    return Intersections(surface=surface, point=point, normal=normal, to_eye=-_unit(direction))


def ambient_radiance(stand: Stand, hits: Intersections) -> tuple[Float64[Array, "hit"], Bool[Array, "hit"]]:
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


def laser_radiance(stand: Stand, hits: Intersections, laser: int) -> tuple[Float64[Array, "hit"], Bool[Array, "hit"]]:
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
    stand: Stand, hits: Intersections, lit: Int64[Array, "lit"], to_light: Float64[Array, "xyz=3 lit"]
) -> Float64[Array, "lit"]:
    """Radiance for each W/m2 across the light's direction."""
    normal, material = hits.normal[:, lit], surfaces(stand.target.materials, hits.surface[lit])
    cosine = np.einsum("ij,ij->j", normal, to_light)
    radiance: Float64[Array, "lit"] = cosine * reflectance_per_sr(material, normal, to_light, hits.to_eye[:, lit])
    return radiance


def _unit(vector: Float64[Array, "xyz=3 n"]) -> Float64[Array, "xyz=3 n"]:
    unit: Float64[Array, "xyz=3 n"] = vector / np.sqrt(np.einsum("ij,ij->j", vector, vector))
    return unit


_LAMPS = np.array([[0.45, -0.75, -0.50], [-0.85, -0.25, -0.45], [0.20, 0.60, -0.77], [0.95, 0.10, -0.30]])
"""Directions towards a laboratory's lamps and windows, camera frame, ..."""

_SHARPNESS = np.array([25.0, 8.0, 40.0, 15.0])
"""... how narrow each is (a lobe exp(k (cos - 1))), ..."""

_SHARES = np.array([0.25, 0.20, 0.10, 0.10])
"""... and each one's share of the irradiance; the walls give the rest."""

_SMOOTHEST = 0.02
"""A smoother surface would mirror the projector as a point."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surfaces:
    """Materials at the hits."""

    diffuse: Float64[Array, "ray"]
    specular: Float64[Array, "ray"]
    roughness: Float64[Array, "ray"]


def surfaces(materials: Sequence[Material], surface: Int8[Array, "ray"]) -> Surfaces:
    """The materials of numbered surfaces."""
    table = np.array([(material.diffuse, material.specular, material.roughness) for material in materials])
    diffuse, specular, roughness = table[surface].T
    return Surfaces(diffuse=diffuse, specular=specular, roughness=np.maximum(roughness, _SMOOTHEST))


def reflectance_per_sr(
    material: Surfaces,
    normal: Float64[Array, "xyz=3 ray"],
    to_light: Float64[Array, "xyz=3 ray"],
    to_eye: Float64[Array, "xyz=3 ray"],
) -> Float64[Array, "ray"]:
    """Lambert plus GGX with Smith's shadowing and Schlick's Fresnel term; directions are unit vectors."""
    half = to_light + to_eye
    half /= np.maximum(np.linalg.norm(half, axis=0), 1e-9)
    n_half, n_light, n_eye = (np.maximum(_dot(normal, vector), 1e-4) for vector in (half, to_light, to_eye))
    alpha2 = material.roughness**2
    spread = alpha2 / (np.pi * (n_half**2 * (alpha2 - 1) + 1) ** 2)
    fresnel = material.specular + (1 - material.specular) * (1 - _dot(half, to_eye).clip(0, 1)) ** 5
    fresnel = np.where(material.specular > 0, fresnel, 0.0)
    smith = (n_light + np.sqrt(alpha2 + (1 - alpha2) * n_light**2)) * (
        n_eye + np.sqrt(alpha2 + (1 - alpha2) * n_eye**2)
    )
    reflectance: Float64[Array, "ray"] = material.diffuse / np.pi + spread * fresnel / smith
    return reflectance


def laboratory_radiance(
    material: Surfaces,
    normal: Float64[Array, "xyz=3 ray"],
    to_eye: Float64[Array, "xyz=3 ray"],
    rotation: Float64[Array, "3 3"],
) -> Float64[Array, "ray"]:
    """Radiance towards the eye, per unit of ambient irradiance, under lamps and walls.

    The walls are grey all round; a lamp is a lobe of light, widened by the surface's roughness where it is mirrored.
    `rotation` turns target coordinates into the camera's, in which the lamps stand.
    """
    n_eye = _dot(normal, to_eye).clip(0, 1)
    mirrored = 2 * _dot(normal, to_eye) * normal - to_eye
    walls = 1 - _SHARES.sum()
    matt, glossy = np.full_like(n_eye, walls), np.full_like(n_eye, walls)
    lamps = rotation.T @ (_LAMPS / np.linalg.norm(_LAMPS, axis=1, keepdims=True)).T
    for lamp, sharpness, share in zip(lamps.T, _SHARPNESS, _SHARES, strict=True):
        matt += share * (lamp @ normal).clip(0, None)
        blurred = 1 / (1 / sharpness + material.roughness**2)
        glossy += share * blurred / 2 * np.exp(blurred * ((lamp @ mirrored).clip(-1, 1) - 1))
    fresnel = np.where(material.specular > 0, material.specular + (1 - material.specular) * (1 - n_eye) ** 5, 0.0)
    radiance: Float64[Array, "ray"] = (material.diffuse * matt + fresnel * glossy) / np.pi
    return radiance


def _dot(first: Float64[Array, "xyz=3 ray"], second: Float64[Array, "xyz=3 ray"]) -> Float64[Array, "ray"]:
    product: Float64[Array, "ray"] = np.einsum("ij,ij->j", first, second)
    return product
