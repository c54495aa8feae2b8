"""The spread of errors some of which are no errors but strays."""

import numpy as np

from ringpose.types.arrays import Array, Float64

_OF_MEDIAN = 1.4826
"""Standard deviation of normal errors over the median of their absolute values."""


def robust_std(errors: Float64[Array, "*shape"]) -> float:
    """Standard deviation of the normal errors that have this median of absolute values: strays hardly change it."""
    return _OF_MEDIAN * float(np.median(np.abs(errors)))


def huber_weights(residuals: Float64[Array, "n"], limit: float) -> Float64[Array, "n"]:
    """Weights w of Huber's loss: sum(w r^2) grows as r^2 up to the limit (in the unit of the residuals), as |r| beyond.

    Huber, Robust Estimation of a Location Parameter, 1964.
    """
    weights: Float64[Array, "n"] = limit / np.maximum(np.abs(residuals), limit)
    return weights
