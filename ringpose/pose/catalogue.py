"""Identification of a ring by a catalogue: Bayesian model comparison of its entries."""

from collections.abc import Mapping, Sequence
from math import exp, log, pi, sqrt

import numpy as np

from ringpose.types.arrays import Array, Float64
from ringpose.types.pose import KnownRadii, Ring

NONE_OF_THESE = "none of these"
"""Key of the probability that the ring is not in the catalogue."""

LIKELY_ENOUGH = 0.95
"""Probability from which a ring's radii are used as a prior."""

RADIUS_FROM_M, RADIUS_TO_M = 0.2, 2.0
BAND_FROM_M, BAND_TO_M = 0.005, 0.2
"""Prior of a ring that is not in the catalogue: log-uniform radius and band within these limits."""


def ring_posterior(
    curvature: float, band_m: float, covariance: Float64[Array, "2 2"], rings: Sequence[Ring]
) -> Mapping[str, float]:
    """Probability of each ring, given the curvature and the band's width of a pose without known radii.

    The errors of curvature and width are Gaussian even where those of the radii are not. An interval of the catalogue
    counts as a Gaussian of the same standard deviation; all rings, and "none of these", have equal prior probability.
    """
    logs = {NONE_OF_THESE: _log_density_of_any(curvature, band_m, np.sqrt(np.diag(covariance)))}
    logs |= {ring.name: _log_density(curvature, band_m, covariance, ring.known_radii) for ring in rings}
    largest = max(logs.values())
    shares = {name: exp(value - largest) for name, value in logs.items()}
    total = sum(shares.values())
    return {name: share / total for name, share in shares.items()}


def likely_ring(posterior: Mapping[str, float], rings: Sequence[Ring]) -> Ring | None:
    """The ring whose probability exceeds `LIKELY_ENOUGH`, if any."""
    return next((ring for ring in rings if posterior[ring.name] > LIKELY_ENOUGH), None)


def _log_density(curvature: float, band_m: float, covariance: Float64[Array, "2 2"], known: KnownRadii) -> float:
    """Log probability density of the measured curvature and width for a ring with these radii."""
    inner_m, outer_m = known.radius_m.tolist()
    expected = np.array([2.0 / (inner_m + outer_m), outer_m - inner_m])
    wrt_radius = np.array([[-0.5 * expected[0] ** 2, -0.5 * expected[0] ** 2], [-1.0, 1.0]])
    total = covariance + wrt_radius @ np.diag(known.sd_m**2) @ wrt_radius.T
    error = np.array([curvature, band_m]) - expected
    return float(-0.5 * error @ np.linalg.solve(total, error) - 0.5 * log(np.linalg.det(total)) - log(2 * pi))


def _log_density_of_any(curvature: float, band_m: float, sd: Float64[Array, "2"]) -> float:
    """Log probability density of the measured curvature and width for a ring of any size, integrated over the prior."""
    curvature_sd, band_sd = sd.tolist()
    logs = np.linspace(log(1 / RADIUS_TO_M), log(1 / RADIUS_FROM_M), 400)
    likelihood = np.exp(-0.5 * np.minimum(((np.exp(logs) - curvature) / curvature_sd) ** 2, 1400.0))
    density = max(float(likelihood.mean()) / (curvature_sd * sqrt(2 * pi)), 1e-300)
    nearest_m = min(max(band_m, BAND_FROM_M), BAND_TO_M)
    beyond = min(((band_m - nearest_m) / band_sd) ** 2, 1400.0)
    return log(density) - log(nearest_m * log(BAND_TO_M / BAND_FROM_M)) - 0.5 * float(beyond)
