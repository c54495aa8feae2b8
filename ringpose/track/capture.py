"""The probability that a gripper closes on the ring."""

from functools import lru_cache

import numpy as np

from ringpose.types.arrays import Array, Float64

_POINTS = 4096


def capture_probability(covariance: Float64[Array, "4 4"], radial_m: float, tilt_rad: float) -> float:
    """Probability that errors of the grasp point and of the normal are both within a gripper's limits.

    `covariance`: of the errors of the grasp point inward and along the normal (m), and of the normal's two tilts (rad).
    Captured: the middle of the band is within `radial_m` of the grasp point, and the normal within `tilt_rad`. The
    integral of the Gaussian is a mean over evenly distributed points, accurate to 0.003.
    """
    scale = np.sqrt(np.maximum(covariance.diagonal(), np.finfo(float).tiny))
    variance, axes = np.linalg.eigh(covariance / scale / scale[:, None])
    root = scale[:, None] * axes * np.sqrt(np.maximum(variance, 0.0))
    errors = _normal_points() @ root.T
    captured = (np.hypot(errors[:, 0], errors[:, 1]) <= radial_m) & (np.hypot(errors[:, 2], errors[:, 3]) <= tilt_rad)
    return float(captured.mean())


@lru_cache(maxsize=1)
def _normal_points() -> Float64[Array, "point 4"]:
    """Points that are evenly distributed as four independent normal numbers.

    Fractional parts of multiples of 1/g, ..., 1/g^4, where g^5 = g + 1 (the additive recurrence of Roberts 2018).
    """
    from scipy.special import ndtri

    ratio = 1.0
    for _ in range(50):
        ratio = (1.0 + ratio) ** 0.2
    uniform = (0.5 + np.arange(1, _POINTS + 1)[:, None] * ratio ** -np.arange(1.0, 5.0)) % 1.0
    points: Float64[Array, "point 4"] = ndtri(uniform)
    return points
