"""Radiance of lit surfaces towards the camera.

Points, normals and directions are arrays (xyz, ray); a normal points to the visible side.
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
"""Objects farther than this cast no shadow."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IlluminatedTarget:
    """A target with its placement in the camera frame and the light on it."""

    target: Target
    placement: Placement
    sheets: Sheets
    light: Light
    lasers: tuple[int, ...]
    """Lasers that are on in at least one frame; the layers of the others stay black."""

    @property
    def has_ambient_light(self) -> bool:
        """Whether there is light other than that of the lasers."""
        return self.light.ambient_w_m2 > 0 or self.light.sun_w_m2 > 0

    @property
    def to_sun(self) -> Float64[Array, "xyz=3 1"]:
        """Unit vector towards the sun, target frame."""
        return self.placement.vectors_target(_unit(self.light.sun_direction[:, None]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Intersections:
    """Intersections of rays with surfaces, in the target frame."""

    surface: Int8[Array, "hit"]
    point: Float64[Array, "xyz=3 hit"]
    normal: Float64[Array, "xyz=3 hit"]
    """Unit normals of the visible side."""
    to_eye: Float64[Array, "xyz=3 hit"]

    def at(self, which: Int64[Array, "chosen"]) -> "Intersections":
        """The intersections with these indices."""
        return Intersections(
            surface=self.surface[which],
            point=self.point[:, which],
            normal=self.normal[:, which],
            to_eye=self.to_eye[:, which],
        )


def hits_on_relief(
    illuminated: IlluminatedTarget,
    direction: Float64[Array, "xyz=3 hit"],
    parameter: Float64[Array, "hit"],
    surface: Int8[Array, "hit"],
) -> Intersections:
    """The intersections of rays with the surfaces including their fine relief."""
    point, normal = illuminated.target.on_relief(illuminated.placement.eye_m, direction, parameter, surface)
    return Intersections(surface=surface, point=point, normal=normal, to_eye=-_unit(direction))


def ambient_radiance(
    illuminated: IlluminatedTarget, hits: Intersections
) -> tuple[Float64[Array, "hit"], Bool[Array, "hit"]]:
    """Radiance due to laboratory and sun, and which points lie in the shadow of the sun."""
    light = illuminated.light
    radiance, shadowed = np.zeros(len(hits.surface)), np.zeros(len(hits.surface), dtype=np.bool_)
    if light.ambient_w_m2 > 0:
        material = surfaces(illuminated.target.materials, hits.surface)
        share = laboratory_radiance(material, hits.normal, hits.to_eye, illuminated.placement.rotation)
        radiance += light.ambient_w_m2 * share
    if light.sun_w_m2 > 0:
        to_sun = np.broadcast_to(illuminated.to_sun, hits.point.shape)
        facing = np.flatnonzero(np.einsum("ij,ij->j", hits.normal, to_sun) > 0)
        shadowed[facing] = illuminated.target.blocked(hits.point[:, facing], _FAR_M * to_sun[:, facing])
        unshadowed = facing[~shadowed[facing]]
        radiance[unshadowed] += light.sun_w_m2 * _reflected(illuminated, hits, unshadowed, to_sun[:, unshadowed])
    return radiance, shadowed


def laser_radiance(
    illuminated: IlluminatedTarget, hits: Intersections, laser: int
) -> tuple[Float64[Array, "hit"], Bool[Array, "hit"]]:
    """Radiance due to the sheet of one laser, and which points of the sheet the target shadows."""
    radiance, shadowed = np.zeros(len(hits.surface)), np.zeros(len(hits.surface), dtype=np.bool_)
    reached = np.flatnonzero(in_sheet(illuminated.sheets, laser, hits.point))
    to_projector = illuminated.sheets.projector_m[laser][:, None] - hits.point[:, reached]
    facing = np.einsum("ij,ij->j", hits.normal[:, reached], to_projector) > 0
    blocked = illuminated.target.blocked(hits.point[:, reached], to_projector)
    shadowed[reached] = blocked
    unshadowed, to_projector = reached[facing & ~blocked], to_projector[:, facing & ~blocked]
    irradiance = irradiance_w_m2(illuminated.sheets, laser, hits.point[:, unshadowed])
    radiance[unshadowed] = irradiance * _reflected(illuminated, hits, unshadowed, _unit(to_projector))
    return radiance, shadowed


def _reflected(
    illuminated: IlluminatedTarget,
    hits: Intersections,
    chosen: Int64[Array, "chosen"],
    to_light: Float64[Array, "xyz=3 chosen"],
) -> Float64[Array, "chosen"]:
    """Radiance per irradiance of 1 W/m2 normal to the light."""
    normal, material = hits.normal[:, chosen], surfaces(illuminated.target.materials, hits.surface[chosen])
    cosine = np.einsum("ij,ij->j", normal, to_light)
    radiance: Float64[Array, "chosen"] = cosine * reflectance_per_sr(material, normal, to_light, hits.to_eye[:, chosen])
    return radiance


def _unit(vector: Float64[Array, "xyz=3 n"]) -> Float64[Array, "xyz=3 n"]:
    unit: Float64[Array, "xyz=3 n"] = vector / np.sqrt(np.einsum("ij,ij->j", vector, vector))
    return unit


_LAMP_DIRECTIONS = np.array([[0.45, -0.75, -0.50], [-0.85, -0.25, -0.45], [0.20, 0.60, -0.77], [0.95, 0.10, -0.30]])
"""Directions towards the lamps and windows of a laboratory, camera frame."""

_LAMP_SHARPNESS = np.array([25.0, 8.0, 40.0, 15.0])
"""Sharpness k of the lobe exp(k (cos - 1)) of each lamp."""

_LAMP_SHARES = np.array([0.25, 0.20, 0.10, 0.10])
"""Share of each lamp in the irradiance; the walls contribute the rest."""

_MIN_ROUGHNESS = 0.02
"""Minimum roughness: a smoother surface would reflect the projector as a point."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Surfaces:
    """Materials at the intersections."""

    diffuse: Float64[Array, "ray"]
    specular: Float64[Array, "ray"]
    roughness: Float64[Array, "ray"]


def surfaces(materials: Sequence[Material], surface: Int8[Array, "ray"]) -> Surfaces:
    """The materials of numbered surfaces."""
    table = np.array([(material.diffuse, material.specular, material.roughness) for material in materials])
    diffuse, specular, roughness = table[surface].T
    return Surfaces(diffuse=diffuse, specular=specular, roughness=np.maximum(roughness, _MIN_ROUGHNESS))


def reflectance_per_sr(
    material: Surfaces,
    normal: Float64[Array, "xyz=3 ray"],
    to_light: Float64[Array, "xyz=3 ray"],
    to_eye: Float64[Array, "xyz=3 ray"],
) -> Float64[Array, "ray"]:
    """BRDF: Lambert plus GGX with Smith shadowing and the Fresnel term of Schlick; directions are unit vectors."""
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
    """Radiance towards the camera per unit of ambient irradiance of lamps and walls.

    The walls are uniformly grey; a lamp is a lobe of light, which the roughness of the surface widens in reflection.
    `rotation` transforms target coordinates to the camera frame, in which the lamps are defined.
    """
    n_eye = _dot(normal, to_eye).clip(0, 1)
    mirrored = 2 * _dot(normal, to_eye) * normal - to_eye
    walls = 1 - _LAMP_SHARES.sum()
    matt, glossy = np.full_like(n_eye, walls), np.full_like(n_eye, walls)
    lamps = rotation.T @ (_LAMP_DIRECTIONS / np.linalg.norm(_LAMP_DIRECTIONS, axis=1, keepdims=True)).T
    for lamp, sharpness, share in zip(lamps.T, _LAMP_SHARPNESS, _LAMP_SHARES, strict=True):
        matt += share * (lamp @ normal).clip(0, None)
        blurred = 1 / (1 / sharpness + material.roughness**2)
        glossy += share * blurred / 2 * np.exp(blurred * ((lamp @ mirrored).clip(-1, 1) - 1))
    fresnel = np.where(material.specular > 0, material.specular + (1 - material.specular) * (1 - n_eye) ** 5, 0.0)
    radiance: Float64[Array, "ray"] = (material.diffuse * matt + fresnel * glossy) / np.pi
    return radiance


def _dot(first: Float64[Array, "xyz=3 ray"], second: Float64[Array, "xyz=3 ray"]) -> Float64[Array, "ray"]:
    product: Float64[Array, "ray"] = np.einsum("ij,ij->j", first, second)
    return product
