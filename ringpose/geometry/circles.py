"""Circles in space."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64, Int64

from ringpose.types.arrays import Array


def nearest_crossing(
    point: Float64[Array, "n xyz=3"],
    direction: Float64[Array, "n xyz=3"],
    center: Float64[Array, "3"],
    radius: Float64[Array, "n"],
) -> Float64[Array, "n xyz=3"]:
    """Where lines cross spheres about one centre: of the two crossings the one nearer to the line's given point.

    A line in the circle's plane meets circle and sphere at the same points. A line that passes the sphere
    by gives its point nearest to the centre. `direction` has unit length.
    """
    along = np.sum((center - point) * direction, axis=-1)
    foot = point + along[:, None] * direction
    half_chord = np.sqrt(np.maximum(radius**2 - np.sum((foot - center) ** 2, axis=-1), 0.0))
    step = along + np.where(along > 0, -half_chord, half_chord)
    crossing: Float64[Array, "n xyz=3"] = point + step[:, None] * direction
    return crossing


class Arcs(NamedTuple):
    """Two short arcs about one centre."""

    curvature: Float64[Array, "*batch"]
    """One over the radius; positive if the centre lies on the side of positive x."""
    band: Float64[Array, "*batch"]
    """Distance between the arcs."""
    outside: Float64[Array, "*batch n"]
    """Distance of each point from its arc, positive towards positive x."""


def concentric_arcs(points: Float64[Array, "*batch n xy=2"], arc: Int64[Array, "n"]) -> Arcs:
    """Two arcs about one centre through points in a plane that cross the x axis steeply; `arc` is 0 or 1.

    a (x^2 + y^2) + x + b y + c_arc = 0 is linear in a, b and the two c, stays regular where the arcs become
    straight (a = 0), and its residual is a distance along x. The usual algebraic fit |P|^2 = 2 C . P + k has
    neither property: it prefers small circles, hopelessly so for three points nearly on a line.
    """
    middle = points.mean(axis=-2, keepdims=True)
    scale = np.maximum(np.abs(points - middle).max(axis=(-2, -1), keepdims=True), np.finfo(float).tiny)
    x, y = np.moveaxis((points - middle) / scale, -1, 0)
    square = x**2 + y**2
    which = np.broadcast_to(np.eye(2)[arc], (*x.shape, 2))
    rows = np.concatenate([square[..., None], y[..., None], which], axis=-1)
    solution = np.einsum("...ij,...j->...i", np.linalg.pinv(rows, rcond=1e-12), -x)
    bend, lean = solution[..., :1], solution[..., 1:2]
    residual = np.einsum("...ij,...j->...i", rows, solution) + x
    steepness = np.hypot(2 * bend * x + 1, 2 * bend * y + lean)
    between = np.abs(solution[..., 3] - solution[..., 2]) / np.hypot(1, lean[..., 0])
    level = np.sqrt(np.maximum(1 + lean**2 - 4 * bend * solution[..., 2:].mean(axis=-1, keepdims=True), 1e-12))
    return Arcs(
        curvature=(-2 * bend / level)[..., 0] / scale[..., 0, 0],
        band=between * scale[..., 0, 0],
        outside=residual / np.maximum(steepness, 1e-9) * scale[..., 0],
    )
