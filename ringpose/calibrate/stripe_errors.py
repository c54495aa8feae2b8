"""How far a stripe's line may err in the image."""

from collections.abc import Sequence

import numpy as np

from ringpose.types.arrays import Array, Float64

REACH_PX = 16
"""Neighbours up to here may be alike; those nearer than half of it count in full. Speckle reaches a quarter."""

SHORTEST = 96
"""Fewer centres tell nothing: the line through them takes what they have in common."""

ENOUGH = 480.0
"""So many centres tell their likeness to a quarter ..."""

USUAL_LENGTH = 3.0
"""... and what fewer leave open is taken from here: 1.2 to 4.1 on simulated boards of three kinds."""

_TERMS = 4
"""Of the smooth line that centres are held against."""


def stripe_bend(points_px: Float64[Array, "n xy=2"]) -> Float64[Array, "2 n xy=2"]:
    """Two independent ways in which a stripe's line may err: shifted, and turned about its middle, by one pixel rms."""
    middle = points_px - points_px.mean(axis=0)
    along = np.linalg.svd(middle, full_matrices=False)[2][0]
    across = np.array([-along[1], along[0]])
    run = middle @ along
    ways = np.stack([np.ones(len(run)), run / np.sqrt(np.mean(run**2))])
    bend: Float64[Array, "2 n xy=2"] = ways[..., None] * across
    return bend


def center_sigma_px(points_px: Float64[Array, "n xy=2"], length: float) -> float:
    """Standard deviation of a centre for which neighbours, so many of which count as one, may be taken as independent.

    The smooth line takes some of the scatter with it, the more the longer the neighbours are alike; two more are taken
    off because the scatter itself is known from so few only (Student's distribution).
    """
    left = max(len(points_px) - (_TERMS + 2) * length, 1.0)
    _, residual = _residual_px(points_px)
    return float(np.sqrt(length * (residual @ residual) / left))


def shared_length(stripes_px: Sequence[Float64[Array, "_ xy=2"]]) -> float:
    """Number of neighbours that count as one, from the products of neighbouring residuals of many stripes.

    Short stripes, and those that printed squares cut to pieces, hardly show theirs by themselves: taken from each
    alone, errors were three times as large as they were said to be. What the smooth lines take of the products and of
    the squares is given back.
    """
    products, centers = 0.0, 0.0
    for points_px in stripes_px:
        if len(points_px) < SHORTEST:
            continue
        run, residual = _residual_px(points_px)
        share, taken = _likeness(run, residual)
        products += share * len(run)
        centers += len(run) - taken + _TERMS * share
    missing = max(ENOUGH - centers, 0.0)
    return max(products + missing * USUAL_LENGTH, 0.0) / (centers + missing)


def _likeness(run: Float64[Array, "n"], residual: Float64[Array, "n"]) -> tuple[float, float]:
    """Sum of the products of neighbours over that of the squares, and how many centres' products the line takes."""
    lag = np.arange(-REACH_PX, REACH_PX + 1)
    window = np.clip(2.0 - np.abs(lag) / (0.5 * REACH_PX), 0.0, 1.0)
    smooth = np.linalg.qr(np.polynomial.polynomial.polyvander(run / np.abs(run).max(), _TERMS - 1))[0]
    place = np.rint(run - run[0]).astype(np.int64)
    sums = []
    for values in (residual, *smooth.T):
        along = np.bincount(place, values)
        sums.append(float(along @ np.convolve(along, window, "same")))
    return sums[0] / max(float(residual @ residual), 1e-24), sum(sums[1:])


def _residual_px(points_px: Float64[Array, "n xy=2"]) -> tuple[Float64[Array, "n"], Float64[Array, "n"]]:
    """Places along a stripe in their order, and offsets there from the smooth line that a lens may bend it to."""
    middle = points_px - points_px.mean(axis=0)
    run, offset = (middle @ np.linalg.svd(middle, full_matrices=False)[2].T).T
    order = np.argsort(run)
    line = np.polynomial.polynomial.polyfit(run, offset, _TERMS - 1)
    residual: Float64[Array, "n"] = (offset - np.polynomial.polynomial.polyval(run, line))[order]
    return run[order], residual
