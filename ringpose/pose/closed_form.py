"""What the paper's two closed forms share (ringpose-method(7), section 4).

Points come in batches, so that one call serves a pose and all the small displacements that its
covariance asks for. Within a batch all points stand on the same edges.
"""

from dataclasses import dataclass

import numpy as np

from ringpose.geometry.least_squares import damped_solution, inverse_condition
from ringpose.types.arrays import EDGES, Array, Bool, Float64, Int64

SINGULAR_BELOW = 1e-3
"""q0: where smallest over largest singular value of the centre's equations falls below it, they are damped.

Three points with spacing a on a ring of radius R give about a / (2 R): the narrowest rig (1.5 degrees between
lasers, 0.2 m away) sees the largest ring of the launcher manuals (1.3 m) at 2e-3 and stays exact. Damped are points
on a straighter arc than any ring's, and stripes that nearly coincide (light planes that cross, at 0.19 m in the
paper's physical rig).
"""

LARGEST_DAMPING = SINGULAR_BELOW
"""lambda_max, in units of the largest singular value.

Equal to q0, so that the weakest direction keeps the share (q / q0)^2 of its undamped step from the mean of
the points: all of it at q0, nothing where the equations are singular.
"""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ClosedForm:
    """Solutions of a batch of points; lengths in metres, camera frame."""

    normal: Float64[Array, "batch xyz=3"]
    offset_m: Float64[Array, "batch"]
    """The ring's plane is `normal . point = offset_m`."""
    center_m: Float64[Array, "batch xyz=3"]
    radius_m: Float64[Array, "batch edge=2"]
    grasp_m: Float64[Array, "batch xyz=3"]
    condition: Float64[Array, "batch"]
    damped: Bool[Array, "batch"]


def equal_distance_rows(
    points: Float64[Array, "batch point xyz=3"], edges: Int64[Array, "point"]
) -> tuple[Float64[Array, "batch row xyz=3"], Float64[Array, "batch row"]]:
    """Rows 2 (P_k - P_0)^T R = |P_k|^2 - |P_0|^2: the centre R is as far from P_k as from the edge's first point.

    An edge seen by k lasers gives k - 1 rows.
    """
    first, other = _pairs(edges)
    rows = 2.0 * (points[:, other] - points[:, first])
    square = np.sum(points**2, axis=-1)
    return rows, square[:, other] - square[:, first]


def damped_center(
    rows: Float64[Array, "batch row column"], targets: Float64[Array, "batch row"]
) -> tuple[Float64[Array, "batch column"], Float64[Array, "batch"]]:
    """Least-squares solution of the centre's equations, measured from the mean of the points, and their q.

    Variable damping lambda^2 = lambda_max^2 (1 - (q / q0)^2) below q0, none above: a well-conditioned
    case stays exact, a singular one stays finite.
    """
    quotient = inverse_condition(rows)
    share = np.minimum(quotient / SINGULAR_BELOW, 1.0)
    return damped_solution(rows, targets, LARGEST_DAMPING * np.sqrt(1.0 - share**2)), quotient


def mean_radii(
    points: Float64[Array, "batch point xyz=3"], edges: Int64[Array, "point"], center: Float64[Array, "batch xyz=3"]
) -> Float64[Array, "batch edge=2"]:
    """Mean distance of each edge's points from the centre; NaN for an edge that was not seen."""
    distance = np.linalg.norm(points - center[:, None], axis=-1)
    unseen = np.full(len(points), np.nan)
    radii = [distance[:, edges == e].mean(axis=-1) if (edges == e).any() else unseen for e in range(len(EDGES))]
    return np.stack(radii, axis=-1)


def facing(
    normal: Float64[Array, "batch xyz=3"], point: Float64[Array, "batch xyz=3"]
) -> Float64[Array, "batch xyz=3"]:
    """Each normal or its opposite, whichever points from `point` towards the camera's centre."""
    away = np.sum(normal * point, axis=-1, keepdims=True) > 0
    return np.where(away, -normal, normal)


def _pairs(edges: Int64[Array, "point"]) -> tuple[Int64[Array, "row"], Int64[Array, "row"]]:
    members = [np.flatnonzero(edges == e) for e in range(len(EDGES))]
    first = np.concatenate([np.repeat(m[:1], max(len(m) - 1, 0)) for m in members])
    return first, np.concatenate([m[1:] for m in members])
