"""How much light a lit surface sends towards the camera.

Points, normals and directions are arrays (xyz, ray); a normal points to the side that is seen.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ringpose.types.arrays import Array, Float64, Int8
from ringpose.types.scene import Material

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
