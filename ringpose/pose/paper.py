"""Method `paper`: the closed form of Liu, Xie and Liu (2020), section 5, read literally (method(7), section 4).

It works in millimetres, as the paper does: the plane row, of size 1e-3, then hardly counts beside rows of size
1e2, so the centre is free to leave the ring's plane: exact on true points, decimetres off along the normal with
the noise of any real image. Kept as a baseline.
"""

import numpy as np

from ringpose.geometry.least_squares import damped_solution
from ringpose.pose.closed_form import (
    SINGULAR_BELOW,
    ClosedForm,
    damped_center,
    equal_distance_rows,
    facing,
    mean_radii,
)
from ringpose.types.arrays import Array, Float64, Int64

MILLIMETRES = 1000.0
"""In a metre."""


def paper_form(points_m: Float64[Array, "batch point xyz=3"], edges: Int64[Array, "point"]) -> ClosedForm:
    """Plane, centre, radii and the mean of the points as the grasp point."""
    points = MILLIMETRES * points_m
    mean = points.mean(axis=1)
    plane = scaled_plane(points)
    center, quotient = ring_center(points, edges, plane)
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


def ring_center(
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
