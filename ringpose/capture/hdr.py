"""Frames of several exposures -> frames on one scale, several of the same lasers merged into one of high dynamic range.

A pixel collects `black + rate * exposure`. Of the exposures in which it is not full, each gives its rate with the
variance `(dark + gain * signal) / exposure^2` (EMVA 1288); merged is their mean, weighted by the inverse of these.
The black level is estimated from the brackets, because a wrong one would be a step where the longest exposure is full.
Dark noise and gain are constants: the optimum is flat, and for true gains of a quarter to twice as much and dark noise
of 0.4 to 3.2 of 255 grey values the variance of the mean is at most 9 % larger than with the sensor's own.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringpose.types.arrays import Array, Bool, Float32, UInt, UInt16
from ringpose.types.image import Shot, shot_with_frames

FULL_SHARE = 0.98
"""From this share of the full grey value on a pixel counts as full: its response bends below the last code."""

MAX_DN = 65000
"""Grey value of pixels that are full in every exposure."""

FULL_WELL_E, DARK_NOISE_E = 10_000.0, 40.0
"""Electrons that fill a pixel, and the standard deviation of a dark one's: between common sensors and noisy ones."""

ROUNDING_DN2 = 1 / 12
"""Variance of rounding to whole grey values."""

PEDESTAL_SHARE = 1 / 32
"""Of the full grey value, what is added to dark pixels, so that their noise is not cut off at zero."""

MIN_PIXELS = 100
"""Not full in either exposure, from which the black level is estimated."""

THINNED = 3
"""Every so many-th row and column is used for it."""


def exposed_groups(masks: Sequence[int], exposures_s: Sequence[float]) -> tuple[tuple[int, ...], ...]:
    """Frames that belong together: neighbours of the same lasers, each with an exposure of its own."""
    groups: list[list[int]] = []
    for frame, mask in enumerate(masks):
        last = groups[-1] if groups else []
        if last and masks[last[-1]] == mask and exposures_s[frame] not in [exposures_s[other] for other in last]:
            last.append(frame)
        else:
            groups.append([frame])
    return tuple(map(tuple, groups))


def merged_brackets(shot: Shot) -> Shot:
    """The shot with all its frames on the scale of its longest exposure, one for each group of exposures.

    A shot of one exposure stays as it is. Grey values become 16-bit ones, `pedestal_dn + rate * scale_s`; a pixel that
    is full wherever it was exposed has the value `saturation_dn`.
    """
    exposures_s = shot.exposure_s.tolist()
    if len(set(exposures_s)) == 1:
        return shot
    groups = exposed_groups(shot.lasers.tolist(), exposures_s)
    longest = np.array([max(group, key=lambda frame: exposures_s[frame]) for group in groups])
    full_dn, black_dn = FULL_SHARE * shot.saturation_dn, black_level_dn(shot, max(groups, key=len))
    max_rate = (full_dn - black_dn) / min(exposures_s)
    scale_s = min(max(exposures_s), MAX_DN / max_rate)
    pedestal_dn = float(np.ceil(PEDESTAL_SHARE * shot.saturation_dn * scale_s / shot.exposure_s[longest].min()))
    top_dn = int(max_rate * scale_s)
    images = np.zeros((len(groups), *shot.images.shape[1:]), dtype=np.uint16)
    for image, group in zip(images, groups, strict=True):
        rate, never = _mean_rate(shot, group, black_dn)
        image[:] = np.rint((pedestal_dn + rate * np.float32(scale_s)).clip(0, top_dn))
        image[never] = top_dn
    merged = {
        "exposures_s": [[exposures_s[frame] for frame in group] for group in groups],
        "scale_s": scale_s,
        "pedestal_dn": pedestal_dn,
        "black_dn": black_dn,
    }
    usual = max(1, int((full_dn - black_dn) * scale_s / max(exposures_s)))
    meta = {**shot.meta, "saturation_dn": top_dn, "usual_full_dn": usual, "merged": merged}
    return replace(shot_with_frames(shot, longest), images=images, meta=meta)


def black_level_dn(shot: Shot, group: Sequence[int]) -> float:
    """From the shortest and the longest exposure of a group: the grey value at which they give the same rate.

    The mean over pixels without the 2 % at either end, where something moved; 0 if too few pixels are not full.
    """
    short, long = (chosen(group, key=lambda frame: shot.exposure_s[frame]) for chosen in (min, max))
    dim, bright = shot.images[short, ::THINNED, ::THINNED], shot.images[long, ::THINNED, ::THINNED]
    usable = bright < FULL_SHARE * shot.saturation_dn
    if short == long or np.count_nonzero(usable) < MIN_PIXELS:
        return 0.0
    ratio = float(shot.exposure_s[short] / shot.exposure_s[long])
    blacks = np.sort((dim[usable] - ratio * bright[usable]) / (1 - ratio))
    rim = len(blacks) // 50
    return max(0.0, float(blacks[rim : len(blacks) - rim].mean()))


def _mean_rate(
    shot: Shot, group: Sequence[int], black_dn: float
) -> tuple[Float32[Array, "row column"], Bool[Array, "row column"]]:
    """Grey values a second, and where they are unknown: pixels that are full in every exposure of the group."""
    frames = [(shot.images[frame], np.float32(shot.exposure_s[frame])) for frame in group]
    usable = [image < FULL_SHARE * shot.saturation_dn for image, _ in frames]
    rates = [(image - np.float32(black_dn)) / exposure_s for image, exposure_s in frames]
    gain = np.float32(shot.saturation_dn / FULL_WELL_E)
    dark_variance = np.float32((gain * DARK_NOISE_E) ** 2 + ROUNDING_DN2)

    def mean(weights: Sequence[np.float32 | Float32[Array, "row column"]]) -> Float32[Array, "row column"]:
        counted = [weight * is_usable for weight, is_usable in zip(weights, usable, strict=True)]
        total = sum(weight * rate for weight, rate in zip(counted, rates, strict=True))
        return np.asarray(total / np.maximum(sum(counted), np.float32(1e-30)), dtype=np.float32)

    first = np.maximum(mean([exposure_s for _, exposure_s in frames]), 0)
    weights = [exposure_s**2 / (dark_variance + gain * first * exposure_s) for _, exposure_s in frames]
    return mean(weights), ~np.logical_or.reduce(usable)


def on_the_scale_of(image: UInt[Array, "row column"], exposure_s: float, shot: Shot) -> UInt[Array, "row column"]:
    """A frame as taken, with the grey values that a merged shot has; as it is beside one that was not merged."""
    merged = shot.meta.get("merged")
    if merged is None:
        return image
    grey = (image.astype(np.float32) - merged["black_dn"]) * (merged["scale_s"] / exposure_s) + merged["pedestal_dn"]
    scaled: UInt16[Array, "row column"] = np.rint(grey.clip(0, shot.saturation_dn)).astype(np.uint16)
    return scaled
