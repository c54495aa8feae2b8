"""Circles in space."""

import numpy as np

from ringpose.types.arrays import Array, Float64


def nearest_crossing(
    point: Float64[Array, "n xyz=3"],
    direction: Float64[Array, "n xyz=3"],
    center: Float64[Array, "3"],
    radius: Float64[Array, "n"],
) -> Float64[Array, "n xyz=3"]:
    """Crossings of lines with spheres about one centre: for each line, the crossing nearer to its given point.

    A line in the circle's plane meets circle and sphere at the same points. For a line that does not meet the sphere,
    its point nearest to the centre is returned. `direction` has unit length.
    """
    along = np.sum((center - point) * direction, axis=-1)
    foot = point + along[:, None] * direction
    half_chord = np.sqrt(np.maximum(radius**2 - np.sum((foot - center) ** 2, axis=-1), 0.0))
    step = along + np.where(along > 0, -half_chord, half_chord)
    crossing: Float64[Array, "n xyz=3"] = point + step[:, None] * direction
    return crossing
