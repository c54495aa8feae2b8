"""Readable NumPy twin of the kernel that says how well ends are known: the oracle of its tests."""

import math

import numpy as np

from ringpose.kernels.ring import (
    CENTERS,
    CORRELATION,
    MIDDLE_X,
    MIDDLE_Y,
    SCATTER,
    SLOPE,
    X_END,
    X_START,
    Ends,
    MarkRules,
)
from ringpose.types.arrays import Array, Float64


def marked_ends(
    tracks: Float64[Array, "track column=11"],
    found: Float64[Array, "track end=2 column=10"],
    track_lasers: tuple[int, ...],
    lasers: int,
    rules: MarkRules,
) -> Ends:
    """Twin of `ringpose.kernels.ring.marked_ends`."""
    x, y, slope, sigma = np.moveaxis(found[..., :4], -1, 0)
    straight_x = tracks[:, [X_START, X_END]]
    straight_y = tracks[:, [MIDDLE_Y]] + tracks[:, [SLOPE]] * (straight_x - tracks[:, [MIDDLE_X]])
    across = _line_sigmas(tracks, x, found, rules)
    xx, xy, yy = sigma**2, sigma**2 * slope, sigma**2 * slope**2 + across**2
    with np.errstate(invalid="ignore"):
        inside = (x >= rules.border_px) & (x <= rules.image_width - 1 - rules.border_px)
        flags = np.where(inside, _flags(found, rules), rules.clipped_flag)
    position, covariance = np.stack([x, y], axis=-1), np.stack([xx, xy, xy, yy], axis=-1).reshape(-1, 2, 2, 2)
    position[~inside], covariance[~inside] = np.nan, np.nan
    straight, sigmas = np.stack([straight_x, straight_y], axis=-1), _line_sigmas(tracks, straight_x, found, rules)
    rows = (position, covariance, flags, straight, sigmas)
    ends = [np.full((lasers, *each.shape[1:]), np.nan) for each in rows]
    ends[2][:] = 0.0
    for end, each in zip(ends, rows, strict=True):
        end[list(track_lasers)] = each
    return Ends(ends[0], ends[1], ends[2].astype(np.int64), *ends[3:])


def _line_sigmas(
    tracks: Float64[Array, "track column=11"],
    x: Float64[Array, "track end=2"],
    found: Float64[Array, "track end=2 column=10"],
    rules: MarkRules,
) -> Float64[Array, "track end=2"]:
    """Standard deviations of the tracks' ordinates at those columns, with what a track's centres share.

    What lies beneath a stripe and shifts its peak by a share of itself shifts its centre by that share of its sigma.
    """
    section = found[:, 0, 7]
    count, correlation, scatter = (tracks[:, each] for each in (CENTERS, CORRELATION, SCATTER))
    length = tracks[:, X_END] - tracks[:, X_START]
    facets = np.maximum(count / (rules.facet_sigmas * section), 1.0)
    beneath = np.nan_to_num(section * np.sqrt(found[:, 0, 9] / facets))
    columns = np.maximum(count / correlation - rules.taken_by_fit, rules.least_columns)
    middle = np.maximum(scatter / np.sqrt(columns), beneath)
    away = (x - tracks[:, [MIDDLE_X]]) / (np.maximum(length, 1.0) / math.sqrt(12))[:, None]
    with np.errstate(invalid="ignore"):
        clipped = (found[..., 5] > rules.saturated_share).any(axis=1)
    rows_crossed = np.maximum(np.abs(tracks[:, SLOPE]) * length, 1.0)
    shared = np.where(clipped, rules.clipped_phase / section / rows_crossed, 0.0)
    sigmas: Float64[Array, "track end=2"] = np.hypot(middle[:, None] * np.hypot(1.0, away), shared[:, None])
    return sigmas


def _flags(found: Float64[Array, "track end=2 column=10"], rules: MarkRules) -> Float64[Array, "track end=2"]:
    """The flags of ends that were found."""
    blunt = found[..., 8] == 1
    middle = np.sqrt(np.maximum(found[..., 3] ** 2 - blunt * np.nan_to_num(found[..., 6]) ** 2, 0))
    flags: Float64[Array, "track end=2"] = (
        rules.saturated_flag * (found[..., 5] > rules.saturated_share)
        + rules.kink_flag * (found[..., 4] > rules.kink_level)
        + rules.blunt_flag * blunt
        + rules.unclear_flag * (middle > rules.unclear_px)
    )
    return flags
