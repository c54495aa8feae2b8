"""How far an answer is from the truth: pure functions, camera frame, metres and radians."""

import numpy as np

from ringpose.geometry.rotations import tilt_basis
from ringpose.types.arrays import Array, Float64


def distance_to_circle_m(
    point_m: Float64[Array, "3"], center_m: Float64[Array, "3"], normal: Float64[Array, "3"], radius_m: float
) -> float:
    """Distance of a point from a circle in space: how far beside the ring a gripper would close there."""
    height_m = normal @ (point_m - center_m)
    from_axis_m = np.linalg.norm(point_m - center_m - height_m * normal)
    return float(np.hypot(height_m, from_axis_m - radius_m))


def mahalanobis_squared(error: Float64[Array, "n"], covariance: Float64[Array, "n n"]) -> float:
    """Squared length of an error in standard deviations; a direction without variance counts as 1e-12 of the largest.

    Divided by n and averaged over many shots this is the NEES, which is 1 where the covariance is honest.
    """
    variance, axes = np.linalg.eigh(covariance)
    floor = max(float(variance[-1]) * 1e-12, float(np.finfo(float).tiny))
    return float(np.sum((axes.T @ error) ** 2 / np.maximum(variance, floor)))


def tilt_error_rad(normal: Float64[Array, "3"], true_normal: Float64[Array, "3"]) -> Float64[Array, "2"]:
    """The tilts t1, t2 that turn the answer's normal into the true one, in the answer's own tilt basis."""
    tilt: Float64[Array, "2"] = tilt_basis(normal) @ true_normal / (normal @ true_normal)
    return tilt
