"""How exact the corners of each view are, by their residuals, where views differ (ringpose-method(7), section 7).

A view's own residuals tell its variance from a few dozen numbers, those of all views only what is usual. Both are
weighed by how much the views really differ: moderated variances (Smyth 2004), chi-squared about a common scale.
"""

import numpy as np
from scipy.optimize import brentq
from scipy.special import digamma, polygamma

from ringpose.types.arrays import Array, Float64

_MIN_SPREAD = 1e-9
"""Variance of the logarithms of the views' variances below which the views do not differ."""


def moderated_variances(squares: Float64[Array, "view"], freedom: Float64[Array, "view"]) -> Float64[Array, "view"]:
    """Variance of each view, from the sum of its squared residuals and the degrees of freedom these have."""
    common = max(float(squares.sum() / freedom.sum()), np.finfo(float).tiny)
    own = np.maximum(squares / freedom, 1e-12 * common)
    prior, scale = _prior(np.log(own), freedom)
    if not np.isfinite(prior):
        return np.full(len(own), common)
    moderated: Float64[Array, "view"] = (prior * scale + freedom * own) / (prior + freedom)
    return moderated


def _prior(log_variance: Float64[Array, "view"], freedom: Float64[Array, "view"]) -> tuple[float, float]:
    """Degrees of freedom that the views have in common, and their common variance; infinite if they do not differ."""
    if len(log_variance) < 3:
        return float("inf"), float("nan")
    unbiased = log_variance - digamma(freedom / 2) + np.log(freedom / 2)
    spread = float(np.var(unbiased, ddof=1) - np.mean(polygamma(1, freedom / 2)))
    if spread < _MIN_SPREAD:
        return float("inf"), float("nan")
    bracket = (1 / spread, 1 / spread + 1)  # 1/x < trigamma(x) < 1/x + 1/x^2
    prior = 2 * float(brentq(lambda x: polygamma(1, x) - spread, *bracket))
    return prior, float(np.exp(unbiased.mean() + digamma(prior / 2) - np.log(prior / 2)))
