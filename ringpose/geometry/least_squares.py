"""Least squares: robust scale and weights, which a minority of outliers hardly changes, Gauss-Newton, and damping."""

from collections.abc import Callable
from typing import TypeVar

import numpy as np

from ringpose.types.arrays import Array, Bool, Float64

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
    linearize: Callable[[State], tuple[Float64[Array, "row"], Float64[Array, "row parameter"]]],
    retract: Callable[[State, Float64[Array, "parameter"]], State],
    start: State,
    iterations: int,
) -> State:
    """The state after this number of undamped Gauss-Newton iterations, for few parameters and a start near the minimum.

    `linearize` returns the residuals r of a state and their Jacobian J with respect to a step, `retract` the state
    after a step; each step minimises |r + J step|. The iteration ends early at a state whose residuals are not finite.
    """
    state = start
    for _ in range(iterations):
        residual, jacobian = linearize(state)
        if not np.isfinite(residual).all():
            break
        state = retract(state, np.linalg.lstsq(jacobian, -residual)[0])
    return state


def inverse_condition(matrix: Float64[Array, "batch row column"]) -> Float64[Array, "batch"]:
    """Ratio of the smallest to the largest singular value of each matrix, after scaling its rows to unit length.

    The scaling makes the result independent of the units of the rows; a row of zeros remains zero.
    """
    length = np.linalg.norm(matrix, axis=-1, keepdims=True)
    scaled = matrix / np.where(length > 0, length, 1.0)
    singular = np.linalg.svd(scaled, compute_uv=False)
    quotient: Float64[Array, "batch"] = singular[:, -1] / np.where(singular[:, 0] > 0, singular[:, 0], 1.0)
    return quotient


def damped_solution(
    matrix: Float64[Array, "batch row column"],
    target: Float64[Array, "batch row"],
    damping: Float64[Array, "batch"],
) -> Float64[Array, "batch column"]:
    """Damped least squares (A^T A + lambda^2 I)^-1 A^T b, with lambda = damping * largest singular value of A.

    Computed from the singular value decomposition: A^T A is not formed, and zero damping gives the pseudo-inverse.
    """
    left, singular, right = np.linalg.svd(matrix, full_matrices=False)
    square = singular**2 + (damping[:, None] * singular[:, :1]) ** 2
    gain = np.divide(singular, square, out=np.zeros_like(singular), where=square > 0)
    along_axes = (target[:, None] @ left)[:, 0] * gain
    solution: Float64[Array, "batch column"] = (along_axes[:, None] @ right)[:, 0]
    return solution


def influence_on(
    unknown: int,
    information: Float64[Array, "*shape unknown unknown"],
    shapes: Float64[Array, "*shape unknown n"],
    weight: Float64[Array, "*shape n"],
) -> Float64[Array, "*shape n"]:
    """Influence u of each value on one unknown of a weighted linear fit: a row of (A W A^T)^-1 A W.

    The rows of A are `shapes`; `information` is A W A^T, to which a prior may have been added. Values of covariance C
    give the unknown the variance u^T C u, whatever the weights.
    """
    unit = np.zeros((information.shape[-1], 1))
    unit[unknown] = 1.0
    row = np.linalg.solve(information, np.broadcast_to(unit, (*information.shape[:-1], 1)))
    influence: Float64[Array, "*shape n"] = (row * shapes).sum(axis=-2) * weight
    return influence


MIN_SHARE = 1e-14
"""Lower limit of eigenvalues, over the largest one: rounding of smaller ones would make variances negative."""


def damped_step(
    information: Float64[Array, "parameter parameter"],
    gradient: Float64[Array, "parameter"],
    free: Bool[Array, "parameter"],
    damping: float,
) -> Float64[Array, "parameter"]:
    """Levenberg-Marquardt step of the free parameters; `gradient` is the right-hand side of the normal equations."""
    return covariance_of_free(information * (1 + damping * np.eye(len(free))), free) @ gradient


def covariance_of_free(
    information: Float64[Array, "parameter parameter"], free: Bool[Array, "parameter"] | None = None
) -> Float64[Array, "parameter parameter"]:
    """Inverse of the normal matrix `information` over the free parameters; zero for those held fixed.

    The parameters may have different units. By default those are free for which there is any information.
    """
    index = np.flatnonzero(np.diag(information) > 0 if free is None else free)
    scale = np.sqrt(np.diag(information)[index])
    inner = information[np.ix_(index, index)] / np.outer(scale, scale)
    covariance = np.zeros_like(information)
    size, axes = np.linalg.eigh(inner)
    size = np.maximum(size, MIN_SHARE * size.max(initial=0.0))
    covariance[np.ix_(index, index)] = (axes / size @ axes.T) / np.outer(scale, scale)
    return covariance
