"""Merging of exposure brackets: one frame of high dynamic range for each group of exposures, on a common scale.

The grey value of a pixel is `black + rate * exposure`. Each exposure that is not saturated gives an estimate of the
rate with the variance `(dark + gain * signal) / exposure^2` (EMVA 1288); the result is their inverse-variance weighted
mean. The black level is estimated from the brackets, because a wrong one would cause a step where the longest exposure
saturates. Dark noise and gain are constants, because the optimum is flat: for true gains of a quarter to twice the
constant and dark noise of 0.4 to 3.2 of 255 grey values, the variance is at most 9 % above that with the true values.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ringpose.types.arrays import Array, Bool, Float32, UInt
from ringpose.types.image import Shot, shot_with_frames

FULL_SHARE = 0.98
"""Share of the full grey value from which a pixel counts as saturated: its response is not linear above."""

MAX_DN = 65000
"""Upper limit for the grey value of pixels that are saturated in every exposure."""

FULL_WELL_E, DARK_NOISE_E = 10_000.0, 40.0
"""Full-well capacity and dark noise in electrons, between those of common and of noisy sensors."""

PEDESTAL_SHARE = 1 / 32
"""Offset as a share of the full grey value, so that the noise of dark pixels is not cut off at zero."""

MIN_PIXELS = 100
"""Minimum number of unsaturated pixels to estimate the black level from."""

THINNED = 3
"""The black level is estimated from every THINNED-th row and column."""


def exposure_groups(masks: Sequence[int], exposures_s: Sequence[float]) -> tuple[tuple[int, ...], ...]:
    """Frames to merge: consecutive ones of the same lasers with different exposures."""
    groups: list[list[int]] = []
    for frame, mask in enumerate(masks):
        last = groups[-1] if groups else []
        if last and masks[last[-1]] == mask and exposures_s[frame] not in [exposures_s[other] for other in last]:
            last.append(frame)
        else:
            groups.append([frame])
    return tuple(map(tuple, groups))


def merged_brackets(shot: Shot) -> Shot:
    """The shot with one frame for each group of exposures, all on the scale of its longest exposure.

    A shot of one exposure is returned unchanged. Grey values become 16-bit ones, `pedestal_dn + rate * scale_s`; a
    pixel that is saturated in every exposure has the value `saturation_dn`.
    """
    exposures_s = shot.exposure_s.tolist()
    if len(set(exposures_s)) == 1:
        return shot
    groups = exposure_groups(shot.lasers.tolist(), exposures_s)
    longest = np.array([max(group, key=lambda frame: exposures_s[frame]) for group in groups])
    full_dn, black_dn = FULL_SHARE * shot.saturation_dn, black_level_dn(shot, max(groups, key=len))
    max_rate = (full_dn - black_dn) / min(exposures_s)
    scale_s = min(max(exposures_s), MAX_DN / max_rate)
    pedestal_dn = float(np.ceil(PEDESTAL_SHARE * shot.saturation_dn * scale_s / shot.exposure_s[longest].min()))
    top_dn = int(max_rate * scale_s)
    images = np.zeros((len(groups), *shot.images.shape[1:]), dtype=np.uint16)
    for image, group in zip(images, groups, strict=True):
        rate, is_unknown = _mean_rate(shot, group, black_dn)
        image[:] = np.rint((pedestal_dn + rate * np.float32(scale_s)).clip(0, top_dn))
        image[is_unknown] = top_dn
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
    """The black level with which the shortest and the longest exposure of a group give the same rate.

    It is the mean over pixels without the 2 % at either end, where something moved; 0 with too few unsaturated pixels.
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
    """Grey values per second, and where they are unknown because every exposure of the group is saturated."""
    frames = [(shot.images[frame], np.float32(shot.exposure_s[frame])) for frame in group]
    usable = [image < FULL_SHARE * shot.saturation_dn for image, _ in frames]
    rates = [(image - np.float32(black_dn)) / exposure_s for image, exposure_s in frames]
    gain = np.float32(shot.saturation_dn / FULL_WELL_E)
    dark_variance = (gain * np.float32(DARK_NOISE_E)) ** 2

    def mean(weights: Sequence[np.float32 | Float32[Array, "row column"]]) -> Float32[Array, "row column"]:
        counted = [weight * is_usable for weight, is_usable in zip(weights, usable, strict=True)]
        total = sum(weight * rate for weight, rate in zip(counted, rates, strict=True))
        return np.asarray(total / np.maximum(sum(counted), np.float32(1e-30)), dtype=np.float32)

    first = np.maximum(mean([exposure_s for _, exposure_s in frames]), 0)
    weights = [exposure_s**2 / (dark_variance + gain * first * exposure_s) for _, exposure_s in frames]
    return mean(weights), ~np.logical_or.reduce(usable)


def scaled_like(image: UInt[Array, "row column"], exposure_s: float, shot: Shot) -> UInt[Array, "row column"]:
    """A raw frame on the grey-value scale of a merged shot; unchanged if the shot was not merged."""
    merged = shot.meta.get("merged")
    if merged is None:
        return image
    grey = (image.astype(np.float32) - merged["black_dn"]) * (merged["scale_s"] / exposure_s) + merged["pedestal_dn"]
    return np.rint(grey.clip(0, shot.saturation_dn)).astype(np.uint16)
