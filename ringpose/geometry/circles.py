"""Circles in space."""

from typing import NamedTuple

import numpy as np

from ringpose.types.arrays import Array, Float64, Int64


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


class ArcEquations(NamedTuple):
    """Two concentric arcs: bend (x^2 + y^2) + x + lean y + level = 0, x and y from the mean of their points.

    `bend` is half the curvature (for `lean` 0), `lean` the tangent of the angle between their common radius and the
    x axis, and `level` the position of each arc along x.
    """

    bend: Float64[Array, "*batch 1"]
    lean: Float64[Array, "*batch 1"]
    level: Float64[Array, "*batch arc=2"]


def arc_equations(points: Float64[Array, "*batch n xy=2"], arc: Int64[Array, "n"]) -> ArcEquations:
    """Two arcs about one centre through points in a plane that cross the x axis steeply; `arc` is 0 or 1.

    The equation is linear in bend, lean and the two levels, is regular for straight arcs (bend = 0), and its residual
    is a distance along x. The usual algebraic fit |P|^2 = 2 C . P + k has neither property: it is biased towards small
    circles, severely for three points nearly on a line.
    """
    centred = points - points.mean(axis=-2, keepdims=True)
    scale = np.maximum(np.abs(centred).max(axis=(-2, -1), keepdims=True), np.finfo(float).tiny)
    x, y = np.moveaxis(centred / scale, -1, 0)
    which = np.broadcast_to(np.eye(2)[arc], (*x.shape, 2))
    rows = np.concatenate([(x**2 + y**2)[..., None], y[..., None], which], axis=-1)
    solution = np.einsum("...ij,...j->...i", np.linalg.pinv(rows, rcond=1e-12), -x)
    return ArcEquations(
        bend=solution[..., :1] / scale[..., 0], lean=solution[..., 1:2], level=solution[..., 2:] * scale[..., 0]
    )


def arc_crossings(arcs: ArcEquations) -> Float64[Array, "*batch arc=2"]:
    """Signed distance from the mean of the points to each arc, along the radius through the mean; positive towards +x.

    The smaller root t of bend t^2 + s t + level = 0, s = sqrt(1 + lean^2), written without a division by bend.
    """
    denominator = np.hypot(1.0, arcs.lean)
    root = np.sqrt(np.maximum(denominator**2 - 4.0 * arcs.bend * arcs.level, 0.0))
    crossings: Float64[Array, "*batch arc=2"] = -2.0 * arcs.level / (denominator + root)
    return crossings
