"""Least squares: robust scale and weights, the Gauss-Newton iteration, elimination of parameters, and damping."""

from collections.abc import Callable
from typing import NamedTuple, Protocol, TypeVar

import numpy as np

from ringpose.types.arrays import Array, Bool, Float64

State = TypeVar("State")


class LinearProblem(Protocol):
    """Residuals linearised at a state; what else is needed for the step is known to `retract` alone."""

    @property
    def decrease(self) -> float:
        """By how much the step is predicted to reduce the sum of squares."""


Problem = TypeVar("Problem", bound=LinearProblem)

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
    linearize: Callable[[State], Problem],
    retract: Callable[[State, Problem], State],
    start: State,
    iterations: int,
    tolerance: float = 0.0,
) -> tuple[State, bool]:
    """The state after at most this number of Gauss-Newton iterations, and whether it has converged.

    It has at a state from which the next step is predicted to reduce the sum of squares by no more than the tolerance;
    a sum that is no number ends the iteration, too. `linearize` returns the problem linearised at a state, `retract`
    the state after its step, or the same state if no step makes it better, which also ends the iteration.

    The estimator of the ring iterates by itself (`estimate.solver`): its weights, its common errors and its limit of
    convergence change on the way, and it extrapolates.
    """
    state = start
    for _ in range(iterations):
        problem = linearize(state)
        if not problem.decrease > tolerance:
            return state, bool(np.isfinite(problem.decrease))
        moved = retract(state, problem)
        if moved is state:
            break
        state = moved
    return state, False


class Rows(NamedTuple):
    """The linear problem of few parameters: the step minimises |residual + jacobian step|."""

    residual: Float64[Array, "row"]
    step: Float64[Array, "parameter"]
    decrease: float

    @classmethod
    def of(cls, residual: Float64[Array, "row"], jacobian: Float64[Array, "row parameter"]) -> "Rows":
        """Residuals of a state and their derivatives by a step."""
        if not np.isfinite(residual).all():
            return cls(residual, np.zeros(jacobian.shape[1]), float("nan"))
        step = np.linalg.lstsq(jacobian, -residual)[0]
        return cls(residual, step, -float(residual @ (jacobian @ step)))


class Eliminated(NamedTuple):
    """A linear problem without the parameters that concern one part of the data alone (the pose of one view).

    With the derivatives P by the part's own parameters p and S by the shared ones s, the residuals r = P p + S s of
    unit variance are projected onto the complement of P's columns. Normal matrix and right-hand side of what is left
    are the Schur complement of those of p and s together: S^T S - S^T P (P^T P)^-1 P^T S, and the same with r.
    """

    wrt_shared: Float64[Array, "row shared"]
    """S, projected."""
    residual: Float64[Array, "row"]
    """r, projected."""
    own_step: Float64[Array, "own"]
    """(P^T P)^-1 P^T r, the step of the own parameters if the shared ones are held ..."""
    own_wrt_shared: Float64[Array, "own shared"]
    """... and -(P^T P)^-1 P^T S, its derivative by these."""
    own_decrease: float
    """By how much that step alone reduces the sum of squares."""

    @classmethod
    def of(
        cls,
        wrt_own: Float64[Array, "row own"],
        wrt_shared: Float64[Array, "row shared"],
        residual: Float64[Array, "row"],
    ) -> "Eliminated":
        """By QR decomposition of P; LinAlgError if the part does not determine its own parameters."""
        basis, triangle = np.linalg.qr(wrt_own)
        along = basis.T @ np.column_stack([wrt_shared, residual])
        across = np.column_stack([wrt_shared, residual]) - basis @ along
        own = np.linalg.solve(triangle, along)
        return cls(across[:, :-1], across[:, -1], own[:, -1], -own[:, :-1], float(along[:, -1] @ along[:, -1]))

    @property
    def information(self) -> Float64[Array, "shared shared"]:
        """Normal matrix of the shared parameters."""
        return self.wrt_shared.T @ self.wrt_shared

    @property
    def gradient(self) -> Float64[Array, "shared"]:
        """Right-hand side of the normal equations: information @ step = gradient."""
        return self.wrt_shared.T @ self.residual

    def own(self, shared_step: Float64[Array, "shared"]) -> Float64[Array, "own"]:
        """Step of the own parameters for a step of the shared ones (back-substitution)."""
        return self.own_step + self.own_wrt_shared @ shared_step


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


def square_root(covariance: Float64[Array, "n n"]) -> Float64[Array, "n n"]:
    """R of a covariance R R^T, which may be singular."""
    variance, axes = np.linalg.eigh(covariance)
    root: Float64[Array, "n n"] = axes * np.sqrt(np.maximum(variance, 0.0))
    return root
