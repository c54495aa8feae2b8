"""The least standard deviation that any unbiased measurement of a stripe can have (Cramer-Rao).

Noise and fading are those of `stripe_images`.
"""

import math

import numpy as np

from ringpose.bench.stripe_images import EDGE_SIGMA_PX, noise_variance

REACH_SIGMAS = 6


def column_bound_px(peak_dn: float, sigma_px: float) -> float:
    """Of a stripe's centre in one column; height and background, even about the centre, cost nothing if unknown."""
    y = np.arange(-math.ceil(REACH_SIGMAS * sigma_px), math.ceil(REACH_SIGMAS * sigma_px) + 1)
    value = peak_dn * np.exp(-0.5 * (y / sigma_px) ** 2)
    slope = value * y / sigma_px**2
    return float(1 / np.sqrt(np.sum(slope**2 / noise_variance(value))))


def end_bound_px(peak_dn: float, sigma_px: float) -> float:
    """Of a stripe's end along the stripe, with a long stripe on one side that tells its height and nothing beyond."""
    y = np.arange(-math.ceil(REACH_SIGMAS * sigma_px), math.ceil(REACH_SIGMAS * sigma_px) + 1)
    x = np.arange(-REACH_SIGMAS, REACH_SIGMAS + 1) / EDGE_SIGMA_PX
    section = peak_dn * np.exp(-0.5 * (y[:, None] / sigma_px) ** 2)
    fade = np.array([0.5 * math.erfc(-step / math.sqrt(2)) for step in x])
    slope = section * np.exp(-0.5 * x**2) / (EDGE_SIGMA_PX * math.sqrt(2 * math.pi))
    return float(1 / np.sqrt(np.sum(slope**2 / noise_variance(section * fade))))
