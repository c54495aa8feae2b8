"""Least squares: robust scale and weights, which a minority of outliers hardly changes, and Gauss-Newton iterations."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from ringpose.types.arrays import Array, Float64

State = TypeVar("State")

STD_PER_MAD = 1.4826
"""Standard deviation of a normal distribution over its median absolute deviation."""


def robust_std(errors: Float64[Array, "*shape"]) -> float:
    """Standard deviation of normally distributed errors of zero mean, from the median of their absolute values."""
    return STD_PER_MAD * float(np.median(np.abs(errors)))


def huber_weights(residuals: Float64[Array, "n"], limit: float) -> Float64[Array, "n"]:
    """Weights w of Huber's loss: sum(w r^2) grows as r^2 up to the limit (in the unit of the residuals), as |r| beyond.

    Huber, Robust Estimation of a Location Parameter, 1964.
    """
    weights: Float64[Array, "n"] = limit / np.maximum(np.abs(residuals), limit)
    return weights


def gauss_newton(
    linearised: Callable[[State], tuple[Float64[Array, "row"], Float64[Array, "row parameter"]]],
    moved: Callable[[State, Float64[Array, "parameter"]], State],
    start: State,
    iterations: int,
) -> State:
    """The state after this number of undamped Gauss-Newton iterations, for few parameters and a start near the minimum.

    `linearised` returns the residuals r of a state and their Jacobian J with respect to a step, `moved` the state after
    a step; each step minimises |r + J step|. The iteration ends early at a state whose residuals are not finite.
    """
    state = start
    for _ in range(iterations):
        residual, jacobian = linearised(state)
        if not np.isfinite(residual).all():
            break
        state = moved(state, np.linalg.lstsq(jacobian, -residual)[0])
    return state
