"""Light planes through triangulated stripe centres (ringpose-method(7), section 6)."""

import numpy as np

from ringpose.calibrate.normal_spread import normal_spread
from ringpose.geometry.planes import nearest_plane
from ringpose.types.arrays import Array, Float64
from ringpose.types.options import PlanesMethod

_TUKEY = 4.685
"""Tukey's constant: 95 % efficient on normal errors."""

_ITERATIONS = 20

_SMALLEST_SCALE_M = 1e-9
"""Scale below which points are exact, so that rounding is not taken for outliers."""


def light_plane(
    points: Float64[Array, "n xyz=3"], method: PlanesMethod
) -> tuple[Float64[Array, "3"], float, Float64[Array, "n"]]:
    """Unit normal, distance and the points' weights by one of the methods."""
    return paper_plane(points) if method is PlanesMethod.PAPER else robust_plane(points)


def robust_plane(
    points: Float64[Array, "n xyz=3"], start: tuple[Float64[Array, "3"], float] | None = None
) -> tuple[Float64[Array, "3"], float, Float64[Array, "n"]]:
    """Unit normal, distance and weights of the plane nearest to most points: total least squares, re-weighted.

    It starts from the plane nearest to all, or from another.
    """
    weights = np.ones(len(points))
    normal, distance_m = nearest_plane(points)[:2] if start is None else start
    for _ in range(_ITERATIONS):
        residual = points @ normal - distance_m
        scale = max(normal_spread(residual), _SMALLEST_SCALE_M)
        moved = np.clip(1 - (residual / (_TUKEY * scale)) ** 2, 0.0, None) ** 2
        normal, distance_m, _ = nearest_plane(points, moved)
        if np.abs(moved - weights).max() < 1e-6:
            break
        weights = moved
    return *downward(normal, distance_m), weights


def paper_plane(points: Float64[Array, "n xyz=3"]) -> tuple[Float64[Array, "3"], float, Float64[Array, "n"]]:
    """The paper's form S . P = 1 by least squares, as unit normal and distance; all weights one.

    It minimises no distance: |S| comes out too large when points scatter, and a plane through the camera has no S.
    """
    scaled, _, _, _ = np.linalg.lstsq(points, np.ones(len(points)), rcond=None)
    length = float(np.linalg.norm(scaled))
    return *downward(scaled / length, 1 / length), np.ones(len(points))


def downward(normal: Float64[Array, "3"], distance_m: float) -> tuple[Float64[Array, "3"], float]:
    """The same plane with its normal's largest component positive, so that two calibrations compare."""
    if normal[np.argmax(np.abs(normal))] < 0:
        return -normal, -distance_m
    return normal, distance_m


def condition(points: Float64[Array, "n xyz=3"], weights: Float64[Array, "n"]) -> float:
    """Extent of the points along their longest direction over that across it, in their plane.

    Infinite for points on one line, which leave the plane open.
    """
    _, _, (along, across, _) = nearest_plane(points, weights)
    return float(along / across) if across > 0 else float("inf")


def extent_m(points: Float64[Array, "n xyz=3"]) -> float:
    """Root mean square distance of the points from their middle."""
    return float(np.sqrt(np.mean(np.sum((points - points.mean(axis=0)) ** 2, axis=1))))
