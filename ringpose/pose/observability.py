"""From where on something counts as not determined, or as weak."""

import math

import numpy as np

from ringpose.types.arrays import Array, Float64

EDGE_ON_BELOW = 0.01
"""Sine of the angle at which the camera looks onto the ring's plane: 0.6 degrees, far less than any face shows."""

TILT_SD_LIMIT_RAD = 0.5
"""Standard deviation of the normal's direction (30 degrees) from which the points are a line within their errors.

Far below it the lever of the radius has made the centre weak, which is flagged.
"""

WEAK_SD = 0.05
"""Standard deviation of the centre, or of a radius, in radii, from which it is flagged as weak.

The centre follows from the height of the arc, and its distance is the inverse of that height. At 5 % the truth is
within 5 of the first-order standard deviations in all but one of 30 000 cases, at 10 % in all but one of 2000.
"""


def spreads_beyond(covariance: Float64[Array, "3 3"], limit: float) -> bool:
    """Whether the standard deviation is over the limit in some direction; mostly seen without eigenvalues.

    The largest variance is at least the largest on the diagonal, and at most their sum.
    """
    variances = covariance.diagonal().tolist()
    if max(variances) > limit**2:
        return True
    return not sum(variances) <= limit**2 and standard_deviation(covariance) > limit


def standard_deviation(covariance: Float64[Array, "n n"]) -> float:
    """In the direction in which it is largest."""
    if len(covariance) == 2:
        (first, mixed), (_, second) = covariance.tolist()
        return math.sqrt(max(0.5 * (first + second) + math.hypot(0.5 * (first - second), mixed), 0.0))
    return math.sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))
