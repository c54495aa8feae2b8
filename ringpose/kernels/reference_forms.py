"""Readable NumPy twin of the kernel that solves the paper's closed forms (ringpose-method(7), section 4).

The oracle of its tests.
"""

import numpy as np

from ringpose.geometry.circles import arc_crossings, arc_equations
from ringpose.geometry.least_squares import damped_solution, inverse_condition
from ringpose.kernels.forms import LARGEST_DAMPING, SINGULAR_BELOW, ClosedForm
from ringpose.types.arrays import EDGES, Array, Float64, Int64

MILLIMETRES = 1000.0
"""In a metre."""


def paper_form(points_m: Float64[Array, "batch point xyz=3"], edges: Int64[Array, "point"]) -> ClosedForm:
    """Plane, centre, radii and the mean of the points as the grasp point."""
    points = MILLIMETRES * points_m
    mean = points.mean(axis=1)
    plane = scaled_plane(points)
    center, quotient = paper_center(points, edges, plane)
    length = np.linalg.norm(plane, axis=-1)
    normal = facing(plane / length[:, None], mean)
    return ClosedForm(
        normal=normal,
        offset_m=-1.0 / length / MILLIMETRES,
        center_m=center / MILLIMETRES,
        radius_m=mean_radii(points, edges, center) / MILLIMETRES,
        grasp_m=mean / MILLIMETRES,
        condition=1.0 / np.maximum(quotient, np.finfo(float).tiny),
        damped=quotient < SINGULAR_BELOW,
    )


def scaled_plane(points: Float64[Array, "batch point xyz=3"]) -> Float64[Array, "batch xyz=3"]:
    """The n of P^T n = 1 by least squares; unlike a unit normal it cannot be a plane through the camera."""
    return damped_solution(points, np.ones(points.shape[:2]), np.zeros(len(points)))


def paper_center(
    points: Float64[Array, "batch point xyz=3"], edges: Int64[Array, "point"], plane: Float64[Array, "batch xyz=3"]
) -> tuple[Float64[Array, "batch xyz=3"], Float64[Array, "batch"]]:
    """R of K R = M, and q of K: the equal distances of each edge, then the plane's row n^T R = 1."""
    mean = points.mean(axis=1)
    rows, targets = equal_distance_rows(points - mean[:, None], edges)
    left_over = 1.0 - np.sum(plane * mean, axis=-1)
    step, quotient = damped_center(
        np.concatenate([rows, plane[:, None]], axis=1), np.concatenate([targets, left_over[:, None]], axis=1)
    )
    return mean + step, quotient


def constrained_form(points: Float64[Array, "batch point xyz=3"], edges: Int64[Array, "point"]) -> ClosedForm:
    """Plane, centre in it, radii and the mid-band grasp point."""
    mean = points.mean(axis=1)
    normal, axes = ring_plane(points)
    center, quotient = center_in_plane(points, edges, axes)
    return ClosedForm(
        normal=normal,
        offset_m=np.sum(normal * mean, axis=-1),
        center_m=center,
        radius_m=mean_radii(points, edges, center),
        grasp_m=mid_band_point(points, edges, normal),
        condition=1.0 / np.maximum(quotient, np.finfo(float).tiny),
        damped=quotient < SINGULAR_BELOW,
    )


def ring_plane(
    points: Float64[Array, "batch point xyz=3"],
) -> tuple[Float64[Array, "batch xyz=3"], Float64[Array, "batch 2 xyz=3"]]:
    """Unit normal towards the camera, and two unit vectors in the plane, of the plane nearest to the points.

    The paper scales the plane to n^T P = 1, which fails for a plane through the camera; the smallest singular
    vector of the centred points has no such hole.
    """
    mean = points.mean(axis=1)
    axes = np.linalg.svd(points - mean[:, None])[2]
    return facing(axes[:, 2], mean), axes[:, :2]


def center_in_plane(
    points: Float64[Array, "batch point xyz=3"], edges: Int64[Array, "point"], axes: Float64[Array, "batch 2 xyz=3"]
) -> tuple[Float64[Array, "batch xyz=3"], Float64[Array, "batch"]]:
    """Centre in the plane through the mean of the points with these axes, and q of its equations."""
    mean = points.mean(axis=1)
    rows, targets = equal_distance_rows(points - mean[:, None], edges)
    step, quotient = damped_center(rows @ axes.swapaxes(1, 2), targets)
    return mean + np.einsum("bk,bkx->bx", step, axes), quotient


def mid_band_point(
    points: Float64[Array, "batch point xyz=3"],
    edges: Int64[Array, "point"],
    normal: Float64[Array, "batch xyz=3"],
) -> Float64[Array, "batch xyz=3"]:
    """Grasp point c + (r_i + r_o)/2 e, with e in the plane from the centre towards the mean of the points (section 5).

    Not by way of the centre, which would be ill-advised where it is weak: the equations above like small circles, and
    within their noise put it among the points. Two arcs that may also be straight give the same point, regularly.
    NaN if an edge was not seen: the middle of the band is then not known.
    """
    if len(set(edges.tolist())) < len(EDGES):
        return np.full_like(normal, np.nan)
    mean = points.mean(axis=1)
    between = points[:, edges == 1].mean(axis=1) - points[:, edges == 0].mean(axis=1)
    x_axis = between - np.sum(between * normal, axis=-1, keepdims=True) * normal
    length = np.linalg.norm(x_axis, axis=-1, keepdims=True)
    x_axis /= np.where(length > 0, length, np.nan)
    axes = np.stack([x_axis, np.cross(normal, x_axis)], axis=1)
    arcs = arc_equations((points - mean[:, None]) @ axes.swapaxes(1, 2), edges)
    outward = (axes[:, 0] + arcs.lean * axes[:, 1]) / np.hypot(1.0, arcs.lean)
    grasp: Float64[Array, "batch xyz=3"] = mean + arc_crossings(arcs).mean(axis=-1, keepdims=True) * outward
    return grasp


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
