"""Mass, centre of mass and inertia of a target, summed from its parts."""

from collections.abc import Sequence

import numpy as np

from ringpose.types.arrays import Array, Float64
from ringpose.types.target import Box, Part, Revolution

_GAUSS = np.polynomial.legendre.leggauss(3)
"""Nodes and weights, exact for the moments of a straight piece of a profile."""


def mass_properties(
    parts: Sequence[Part],
) -> tuple[float, Float64[Array, "xyz=3"], Float64[Array, "3 3"]]:
    """Mass, centre of mass and inertia about it, in the target frame; NaN where the parts have no mass.

    Boxes are solid and uniform, surfaces of revolution are shells of uniform thickness.
    """
    masses = np.array([part.mass_kg for part in parts])
    mass_kg = float(masses.sum())
    if mass_kg == 0.0:
        return 0.0, np.full(3, np.nan), np.full((3, 3), np.nan)
    moments = [_moments(part.shape) for part in parts]
    centers = np.array(
        [part.rotation @ center + part.translation_m for part, (center, _) in zip(parts, moments, strict=True)]
    )
    center_m: Float64[Array, "xyz=3"] = masses @ centers / mass_kg
    inertia = np.zeros((3, 3))
    for part, (_, own), at in zip(parts, moments, centers - center_m, strict=True):
        steiner = at @ at * np.eye(3) - np.outer(at, at)
        inertia += part.mass_kg * (part.rotation @ np.diag(own) @ part.rotation.T + steiner)
    return mass_kg, center_m, inertia


def _moments(shape: Box | Revolution) -> tuple[Float64[Array, "xyz=3"], Float64[Array, "xyz=3"]]:
    """Centre of mass, and principal moments about it per kilogram, in the part frame."""
    if isinstance(shape, Box):
        square = (shape.high_m - shape.low_m) ** 2
        return (shape.low_m + shape.high_m) / 2, (square.sum() - square) / 12
    first, second = shape.profile_m[:-1, None], shape.profile_m[1:, None]
    share = (1 + _GAUSS[0][:, None]) / 2
    point = first + share * (second - first)
    radius, height = point[..., 0], point[..., 1]
    area = np.linalg.norm(second - first, axis=-1) * _GAUSS[1] / 2 * radius  # but for 2 pi
    area = area / area.sum()
    middle = float((area * height).sum())
    axial, along = float((area * radius**2).sum()), float((area * (height - middle) ** 2).sum())
    return np.array([0.0, 0.0, middle]), np.array([axial / 2 + along, axial / 2 + along, axial])
