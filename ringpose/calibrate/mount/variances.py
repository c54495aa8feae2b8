"""Variances of errors by restricted likelihood (ringpose-method(7), section 13).

The corrections of the views are z_i = A_i x + sum_k O_ik e_ik + noise, with errors e_ik that are drawn anew in each
view. The likelihood of their variances has x integrated out, so that it is not biased by the parameters that are
estimated (Patterson and Thompson 1971; Searle, Casella and McCulloch, Variance Components, 1992, section 6.6).
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ringpose.geometry.least_squares import covariance_of_free
from ringpose.types.arrays import Array, Float64

_ITERATIONS = 40
_MIN_STEP = 2e-3
"""Change of the logarithm of a variance below which it has converged: a thousandth of a standard deviation."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ErrorModel:
    """The linear model of all views, and the prior of the logarithms of its variances."""

    z: Float64[Array, "view 6"]
    covariance: Float64[Array, "view 6 6"]
    """Of the noise."""
    design: Float64[Array, "view 6 common"]
    known: Float64[Array, "common common"]
    """Information about x beside that of the corrections ..."""
    gradient: Float64[Array, "common"]
    """... and the gradient that belongs to it."""
    errors: tuple[Float64[Array, "view 6 _"], ...]
    """O: by unit errors of each kind."""
    prior_mean: Float64[Array, "part"]
    prior_precision: Float64[Array, "part part"]


class Likelihood(NamedTuple):
    """Logarithm of the density of the variances, prior included, but for a constant."""

    log_density: float
    score: Float64[Array, "part"]
    information: Float64[Array, "part part"]
    """Fisher's, expected."""


def most_likely(
    model: ErrorModel,
    start: Float64[Array, "part"],
    bounds: tuple[Float64[Array, "part"], Float64[Array, "part"]],
) -> tuple[Float64[Array, "part"], Likelihood]:
    """The logarithms of variances of the highest density within bounds, by damped Fisher scoring."""
    logarithms, damping = np.clip(start, *bounds), 1e-3
    now = likelihood(model, logarithms)
    for _ in range(_ITERATIONS):
        # what would go on beyond a bound is held there
        held = ((logarithms <= bounds[0]) & (now.score < 0.0)) | ((logarithms >= bounds[1]) & (now.score > 0.0))
        damped = now.information + damping * np.diag(np.diag(now.information) + 1e-6)
        step = np.where(held, 0.0, np.linalg.solve(damped, np.where(held, 0.0, now.score)))
        moved = np.clip(logarithms + np.clip(step, -2.0, 2.0), *bounds)
        following = likelihood(model, moved)
        if following.log_density < now.log_density:
            damping *= 10.0
        else:
            logarithms, now, damping = moved, following, 0.1 * damping
        if np.abs(step).max() < _MIN_STEP:
            break
    return logarithms, now


def likelihood(model: ErrorModel, logarithms: Float64[Array, "part"]) -> Likelihood:
    """The density and its derivatives at logarithms of variances.

    Each view has its own block of the covariance V of all corrections, and of its parts B_k by each variance. With the
    weights W, the inverse of V, and P = W - W A (A^T W A)^-1 A^T W, the score is (z^T P B_k P z - tr P B_k) / 2, and
    Fisher's information tr(P B_k P B_l) / 2.
    """
    design = model.design
    variances = np.exp(logarithms).tolist()
    parts = [variance * (each @ each.swapaxes(1, 2)) for variance, each in zip(variances, model.errors, strict=True)]
    marginal = model.covariance + sum(parts)
    weights = np.linalg.inv(marginal)
    weighted = weights @ design
    information = (design.swapaxes(1, 2) @ weighted).sum(axis=0) + model.known
    gradient = (model.z[:, None] @ weighted)[:, 0].sum(axis=0) + model.gradient
    covariance = covariance_of_free(information)
    x = covariance @ gradient
    rest = (weights @ (model.z - design @ x)[..., None])[..., 0]  # W (z - A x) = P z
    free = np.diag(information) > 0.0
    scale = 1.0 / np.sqrt(np.diag(information)[free])
    scaled = information[np.ix_(free, free)] * np.outer(scale, scale)
    determinants = np.linalg.slogdet(marginal)[1].sum() + np.linalg.slogdet(scaled)[1] - 2.0 * np.log(scale).sum()
    chi2 = (model.z * (weights @ model.z[..., None])[..., 0]).sum() - gradient @ x

    seen = [weights @ part for part in parts]  # W B_k
    seen_from = [part @ weighted for part in parts]  # B_k W A
    shown = [(weighted.swapaxes(1, 2) @ each).sum(axis=0) @ covariance for each in seen_from]
    score, expected = np.zeros(len(parts)), np.zeros((len(parts), len(parts)))
    for one, part in enumerate(parts):
        squares = ((part @ rest[..., None])[..., 0] * rest).sum()
        score[one] = squares - np.trace(seen[one], axis1=1, axis2=2).sum() + np.trace(shown[one])
        for two in range(one, len(parts)):
            both = (seen_from[one].swapaxes(1, 2) @ (weights @ seen_from[two])).sum(axis=0)
            views = (seen[one] * seen[two].swapaxes(1, 2)).sum() - 2.0 * (both * covariance).sum()
            expected[one, two] = expected[two, one] = views + (shown[one] * shown[two].T).sum()
    off = logarithms - model.prior_mean
    return Likelihood(
        log_density=float(-0.5 * (determinants + chi2 + off @ model.prior_precision @ off)),
        score=0.5 * score - model.prior_precision @ off, information=0.5 * expected + model.prior_precision,
    )  # fmt: skip
