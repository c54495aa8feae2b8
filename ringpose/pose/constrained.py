"""Method `paper-constrained`: the paper's equations, solved inside the ring's plane (ringpose-method(7), section 4)."""

import numpy as np

from ringpose.geometry.circles import arc_crossings, arc_equations
from ringpose.pose.closed_form import (
    SINGULAR_BELOW,
    ClosedForm,
    damped_center,
    equal_distance_rows,
    facing,
    mean_radii,
)
from ringpose.types.arrays import EDGES, Array, Float64, Int64


def constrained_form(points: Float64[Array, "batch point xyz=3"], edges: Int64[Array, "point"]) -> ClosedForm:
    """Plane, centre in it, radii and the mid-band grasp point."""
    mean = points.mean(axis=1)
    normal, axes = ring_plane(points)
    center, quotient = ring_center(points, edges, axes)
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


def ring_center(
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
