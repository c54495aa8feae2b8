"""How far a stripe's line may err in the image."""

from collections.abc import Sequence

import numpy as np

from ringpose.types.arrays import Array, Float64

BLOCK = 16
"""Centres whose mean tells how much neighbours have in common: ten times as far as speckle reaches."""

FEWEST_BLOCKS = 30
"""So many blocks tell a mean square to a quarter ..."""

USUAL_LENGTH = 3.0
"""... and what fewer leave open is taken from here: 1.2 to 4.1 on simulated boards of three kinds."""


def stripe_bend(points_px: Float64[Array, "n xy=2"]) -> Float64[Array, "2 n xy=2"]:
    """Two independent ways in which a stripe's line may err: shifted, and turned about its middle, by one pixel rms."""
    middle = points_px - points_px.mean(axis=0)
    along = np.linalg.svd(middle, full_matrices=False)[2][0]
    across = np.array([-along[1], along[0]])
    run = middle @ along
    ways = np.stack([np.ones(len(run)), run / np.sqrt(np.mean(run**2))])
    bend: Float64[Array, "2 n xy=2"] = ways[..., None] * across
    return bend


def line_variance_px2(points_px: Float64[Array, "n xy=2"]) -> float:
    """Variance of a line's shift and turn: the centres' scatter over the number of independent centres.

    Speckle makes neighbours alike; their number is divided by the correlation length of the residuals.
    """
    residual = _residual_px(points_px)
    return float(residual.var() * correlation_length(residual) / len(residual))


def scatter_px(points_px: Float64[Array, "n xy=2"]) -> float:
    """Standard deviation of the centres across their stripe."""
    return float(_residual_px(points_px).std())


def shared_length(stripes_px: Sequence[Float64[Array, "_ xy=2"]]) -> float:
    """The correlation length that many stripes have together, from the means of blocks of their residuals.

    Short stripes, and those that printed squares cut to pieces, hardly show theirs by themselves: taken from each
    alone, errors were three times as large as they were said to be.
    """
    squares, blocks = 0.0, 0
    for points_px in stripes_px:
        if len(points_px) < 6 * BLOCK:
            continue
        residual = _residual_px(points_px)
        parts = np.array_split(residual / max(float(residual.std()), 1e-12), len(residual) // BLOCK)
        squares += sum(len(part) * float(part.mean()) ** 2 for part in parts)
        blocks += len(parts) - 4
    missing = max(FEWEST_BLOCKS - blocks, 0)
    return (squares + missing * USUAL_LENGTH) / (blocks + missing)


def _residual_px(points_px: Float64[Array, "n xy=2"]) -> Float64[Array, "n"]:
    """Offsets across a stripe from the smooth line that a lens may bend it to, in their order along it."""
    middle = points_px - points_px.mean(axis=0)
    run, offset = (middle @ np.linalg.svd(middle, full_matrices=False)[2].T).T
    order = np.argsort(run)
    line = np.polynomial.polynomial.polyfit(run, offset, 3)
    residual: Float64[Array, "n"] = (offset - np.polynomial.polynomial.polyval(run, line))[order]
    return residual


def correlation_length(residual: Float64[Array, "n"]) -> float:
    """Number of neighbours that count as one: 1 + 2 times the sum of the autocorrelation while it is significant."""
    power = float(residual @ residual)
    length = 1.0
    for lag in range(1, len(residual) // 4):
        correlation = float(residual[lag:] @ residual[:-lag]) / power if power > 0 else 0.0
        if correlation < 2 / np.sqrt(len(residual)):
            break
        length += 2 * correlation
    return length
