"""Derivatives of Gaussians down the columns, to find stripes and to refine them (ringpose-method(7), section 3)."""

import math
from functools import lru_cache

import numpy as np

from ringpose.kernels.stripes import Filters
from ringpose.types.arrays import Array, Float64

FINEST_SIGMA_PX = 1.0
FILTERS_AN_OCTAVE = 3
REFINING_FILTERS = 11
"""Filters of 1 to 10 px to refine with, so close that the nearest one costs a stripe less than 1 % of its accuracy."""

RIDGE_REACH = 3.0
REFINING_REACH = 3.5
"""Sigmas at which a filter ends: to find a ridge less will do than to say where it is."""


@lru_cache(maxsize=16)
def stripe_filters(ridge_sigma_px: float) -> Filters:
    """The ridge filter of that sigma, and those that refine."""
    steps = np.arange(REFINING_FILTERS) / FILTERS_AN_OCTAVE
    sigmas = [ridge_sigma_px, *(FINEST_SIGMA_PX * 2**steps)]
    reaches = [math.ceil(sigma * (RIDGE_REACH if i == 0 else REFINING_REACH)) for i, sigma in enumerate(sigmas)]
    taps = np.zeros((len(sigmas), 2, max(reaches) + 1))
    figures = np.zeros((len(sigmas), 4))
    for i, (sigma, reach) in enumerate(zip(sigmas, reaches, strict=True)):
        slope, bend = _derivatives(sigma, reach)
        taps[i, 0, : reach + 1], taps[i, 1, : reach + 1] = slope, bend
        figures[i] = sigma, reach, _two_sided_norm(slope), _two_sided_norm(bend)
    return Filters(taps=taps.astype(np.float32), figures=figures)


def _derivatives(sigma_px: float, reach: int) -> tuple[Float64[Array, "tap"], Float64[Array, "tap"]]:
    """Taps of the first and second derivative of a Gaussian, from the middle on; a flat image answers with nothing."""
    y = np.arange(reach + 1, dtype=np.float64)
    gauss = np.exp(-0.5 * (y / sigma_px) ** 2)
    gauss /= 2 * gauss.sum() - gauss[0]
    bend = (y**2 / sigma_px**4 - 1 / sigma_px**2) * gauss
    bend -= (2 * bend.sum() - bend[0]) / (2 * reach + 1)
    return y / sigma_px**2 * gauss, bend


def _two_sided_norm(taps: Float64[Array, "tap"]) -> float:
    """Standard deviation of the filter's answer to white noise of 1."""
    return math.sqrt(2 * float(taps @ taps) - float(taps[0]) ** 2)
