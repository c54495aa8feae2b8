"""How far a stripe's line may err in the image."""

import numpy as np

from ringpose.types.arrays import Array, Float64


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
    middle = points_px - points_px.mean(axis=0)
    run, offset = (middle @ np.linalg.svd(middle, full_matrices=False)[2].T).T
    order = np.argsort(run)
    residual = offset - np.polynomial.polynomial.polyval(run, np.polynomial.polynomial.polyfit(run, offset, 3))
    return float(residual.var() * correlation_length(residual[order]) / len(residual))


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
