"""Robust scale and weights: estimates that a minority of outliers hardly changes."""

import numpy as np

from ringpose.types.arrays import Array, Float64

STD_PER_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


def robust_std(errors: Float64[Array, "*shape"]) -> float:
    """Standard deviation of normally distributed errors of zero mean, from the median of their absolute values."""
    return STD_PER_MAD * float(np.median(np.abs(errors)))


def redescending_weights(residuals: Float64[Array, "n"], scale: float) -> Float64[Array, "n"]:
    """Weights (1 + (r / s)^2)^-2 of Geman and McClure's loss, under which gross outliers lose all influence.

    Geman and McClure, Statistical Methods for Tomographic Image Reconstruction, 1987.
    """
    weights: Float64[Array, "n"] = (1.0 + (residuals / scale) ** 2) ** -2
    return weights


def huber_weights(residuals: Float64[Array, "n"], limit: float) -> Float64[Array, "n"]:
    """Weights w of Huber's loss: sum(w r^2) grows as r^2 up to the limit (in the unit of the residuals), as |r| beyond.

    Huber, Robust Estimation of a Location Parameter, 1964.
    """
    weights: Float64[Array, "n"] = limit / np.maximum(np.abs(residuals), limit)
    return weights
