"""Identification of a ring by a catalogue: Bayesian model comparison of its entries."""

from collections.abc import Mapping, Sequence
from math import log, pi, sqrt

import numpy as np

from ringpose.types.arrays import Array, Float64
from ringpose.types.plausible import FACE_WIDTH_M, RING_RADIUS_M
from ringpose.types.pose import Ring

NONE_OF_THESE = "none of these"
"""Key of the probability that the ring is not in the catalogue."""

LIKELY_ENOUGH = 0.95
"""Probability from which the radii of a ring, or of a few rings of nearly equal size, are used as a prior."""

GRID_SIGMAS, GRID_POINTS = 8.0, 400
"""Extent and number of the points at which the curvature of a ring of any size is integrated."""


def ring_posterior(
    curvature: float, band_m: float, covariance: Float64[Array, "2 2"], rings: Sequence[Ring]
) -> Mapping[str, float]:
    """Probability of each ring, given the curvature and the band's width of a pose without known radii.

    The errors of curvature and width are Gaussian even where those of the radii are not. An interval of the catalogue
    counts as a Gaussian of the same standard deviation. "None of these" has half of the prior probability, whatever the
    number of rings, so that a catalogue of many sizes does not claim each ring; the rings share the other half.
    """
    of_any = _log_density_of_any(curvature, band_m, np.sqrt(np.diag(covariance))) + log(len(rings))
    logs = np.append(_log_densities(curvature, band_m, covariance, rings), of_any)
    shares = np.exp(logs - logs.max())
    names = [*(ring.name for ring in rings), NONE_OF_THESE]
    return dict(zip(names, (shares / shares.sum()).tolist(), strict=True))


def likely_ring(posterior: Mapping[str, float], rings: Sequence[Ring]) -> Ring | None:
    """The ring whose probability exceeds `LIKELY_ENOUGH`, if any.

    Where it takes several rings to exceed it, such as flanges of two standards that differ by less than a shot shows:
    one ring that is any of them, with an interval over theirs.
    """
    likely: list[Ring] = []
    for ring in sorted(rings, key=lambda ring: -posterior[ring.name]):
        likely.append(ring)
        if sum(posterior[each.name] for each in likely) > LIKELY_ENOUGH:
            return likely[0] if len(likely) == 1 else _any_of(likely)
    return None


def _any_of(rings: Sequence[Ring]) -> Ring:
    inner, outer = (np.array([getattr(ring, key) for ring in rings]) for key in ("radius_inner_m", "radius_outer_m"))
    tolerances = [ring.tolerance_m for ring in rings if ring.tolerance_m is not None]
    return Ring(
        name=" or ".join(ring.name for ring in rings),
        radius_inner_m=(float(inner.min()), float(inner.max())),
        radius_outer_m=(float(outer.min()), float(outer.max())),
        tolerance_m=max(tolerances) if len(tolerances) == len(rings) else None,
    )


def _log_densities(
    curvature: float, band_m: float, covariance: Float64[Array, "2 2"], rings: Sequence[Ring]
) -> Float64[Array, "ring"]:
    """Log probability density of the measured curvature and width for each ring."""
    intervals = np.array([[ring.radius_inner_m, ring.radius_outer_m] for ring in rings])
    radius_m, variance = intervals.mean(axis=2), np.ptp(intervals, axis=2) ** 2 / 12.0
    expected = np.stack([2.0 / radius_m.sum(axis=1), radius_m[:, 1] - radius_m[:, 0]], axis=1)
    wrt_radius = np.empty((len(rings), 2, 2))
    wrt_radius[:, 0] = -0.5 * expected[:, :1] ** 2
    wrt_radius[:, 1] = -1.0, 1.0
    total = covariance + (wrt_radius * variance[:, np.newaxis]) @ wrt_radius.transpose(0, 2, 1)
    error = np.array([curvature, band_m]) - expected
    chi2 = (error * np.linalg.solve(total, error[..., np.newaxis])[..., 0]).sum(axis=1)
    densities: Float64[Array, "ring"] = -0.5 * chi2 - 0.5 * np.log(np.linalg.det(total)) - log(2 * pi)
    return densities


def _log_density_of_any(curvature: float, band_m: float, sd: Float64[Array, "2"]) -> float:
    """Log probability density of the measured curvature and width for a ring of any plausible size.

    Its radius and the width of its face are log-uniform; the curvature is integrated over where it may be.
    """
    curvature_sd, band_sd = sd.tolist()
    least, most = 1.0 / RING_RADIUS_M.highest, 1.0 / RING_RADIUS_M.lowest
    near = min(max(curvature, least), most)
    start = log(max(near - GRID_SIGMAS * curvature_sd, least))
    end = log(min(near + GRID_SIGMAS * curvature_sd, most))
    sigmas = (np.exp(np.linspace(start, end, GRID_POINTS)) - curvature) / curvature_sd
    likelihood = np.exp(-0.5 * np.minimum(sigmas**2, 1400.0)) / (curvature_sd * sqrt(2 * pi))
    density = float(np.trapezoid(likelihood)) / (GRID_POINTS - 1) * (end - start) / log(most / least)
    nearest_m = min(max(band_m, FACE_WIDTH_M.lowest), FACE_WIDTH_M.highest)
    beyond = min(((band_m - nearest_m) / band_sd) ** 2, 1400.0)
    of_band = log(nearest_m * log(FACE_WIDTH_M.highest / FACE_WIDTH_M.lowest))
    return log(max(density, 1e-300)) - of_band - 0.5 * float(beyond)
