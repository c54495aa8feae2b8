"""Figures of many errors, some of them wild."""

import numpy as np

from ringpose.types.arrays import Array, Float64

MAD_OF_NORMAL = 1.4826
"""Standard deviation of a normal variable over the median of its sizes about its median."""


def median(values: Float64[Array, "n"]) -> float:
    """NaN of nothing."""
    return float(np.median(values)) if len(values) else float("nan")


def robust_sd(values: Float64[Array, "n"]) -> float:
    """Standard deviation by the median absolute deviation; NaN of nothing."""
    return MAD_OF_NORMAL * median(np.abs(values - median(values)))


def rms(values: Float64[Array, "n"]) -> float:
    """Root mean square; NaN of nothing."""
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")


def mean(values: Float64[Array, "n"]) -> float:
    """NaN of nothing."""
    return float(np.mean(values)) if len(values) else float("nan")
