"""Planes, `normal . point = distance`."""

import numpy as np

from ringpose.types.arrays import Array, Float64


def nearest_plane(
    points: Float64[Array, "n xyz=3"], weights: Float64[Array, "n"] | None = None
) -> tuple[Float64[Array, "3"], float, Float64[Array, "3"]]:
    """Total-least-squares plane through the points, with their singular values.

    Returns the unit normal (either sign), the distance with `normal . point = distance`, and the singular
    values of the centred weighted points, descending; the second is zero for collinear points.
    """
    weight = np.ones(len(points)) if weights is None else weights
    middle = weight @ points / weight.sum()
    _, singular_values, axes = np.linalg.svd(np.sqrt(weight)[:, None] * (points - middle), full_matrices=False)
    normal: Float64[Array, "3"] = axes[-1]
    return normal, float(normal @ middle), singular_values


def towards_camera(normal: Float64[Array, "3"], point: Float64[Array, "3"]) -> Float64[Array, "3"]:
    """The normal or its opposite, whichever points from `point` towards the camera's centre."""
    return -normal if normal @ point > 0 else normal
