"""Frames of several exposures -> frames on one scale, several of the same lasers merged into one of high dynamic range.

A pixel collects `black + rate * exposure`. Of the exposures in which it is not full, each gives its rate with the
variance `(dark + gain * signal) / exposure^2`; their mean, weighted by the inverse of these, is the best estimate.
Black level, dark noise and gain are estimated from the brackets themselves: two exposures of one scene differ by
noise alone.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from ringpose.types.arrays import Array, Float32, Float64, UInt, UInt16
from ringpose.types.frame import Shot, shot_with_frames

FULL_SHARE = 0.98
"""From this share of the full grey value on a pixel counts as full: its response bends below the last code."""

MOST_DN = 65000
"""Grey value of pixels that are full in every exposure."""

LEAST_VARIANCE_DN2 = 1 / 12
"""Of rounding to whole grey values."""

LEVELS = 24
"""Bins of grey values from which the noise is read."""

LEAST_IN_LEVEL = 100

PEDESTAL_SIGMAS = 6.0

THINNED = 3
"""Every so many-th row and column tell the noise."""

USUAL_FULL_E = 10_000.0
"""Electrons that fill a pixel of a common sensor, where the brackets do not tell the noise."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PixelNoise:
    """Grey value of a dark pixel, and the variance `dark_variance_dn2 + gain_dn_per_e * signal` of a grey value."""

    black_dn: float
    dark_variance_dn2: float
    gain_dn_per_e: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Scale:
    """Grey values that a merged frame has: `pedestal_dn + rate * unit_s`."""

    unit_s: float
    pedestal_dn: float
    """So that noise of dark pixels is not cut off."""
    full_dn: float
    """A pixel of a frame as taken is full from here on."""
    top_dn: int
    """Value of what is full in every exposure."""


Image = Float32[Array, "row column"]


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

    A shot of one exposure stays as it is. Grey values become 16-bit ones above a pedestal; a pixel that is full
    wherever it was exposed has the value `saturation_dn`.
    """
    exposures_s = shot.exposure_s.tolist()
    if len(set(exposures_s)) == 1:
        return shot
    groups = exposed_groups(shot.lasers.tolist(), exposures_s)
    noise = pixel_noise(shot, groups)
    full_dn = FULL_SHARE * shot.saturation_dn
    highest = (full_dn - noise.black_dn) / min(exposures_s)
    unit_s = min(max(exposures_s), MOST_DN / highest)
    longest = np.array([max(group, key=lambda frame: exposures_s[frame]) for group in groups])
    pedestal = PEDESTAL_SIGMAS * noise.dark_variance_dn2**0.5 * unit_s / float(shot.exposure_s[longest].min())
    scale = Scale(unit_s=unit_s, pedestal_dn=float(np.ceil(pedestal)), full_dn=full_dn, top_dn=int(highest * unit_s))
    images = np.stack([_merged(shot, group, noise, scale) for group in groups])
    usual = max(1, int((full_dn - noise.black_dn) * unit_s / max(exposures_s)))
    merged = {
        "exposures_s": [[exposures_s[frame] for frame in group] for group in groups],
        "scale_s": unit_s,
        "pedestal_dn": scale.pedestal_dn,
        "black_dn": noise.black_dn,
        "dark_variance_dn2": noise.dark_variance_dn2,
        "gain_dn_per_e": noise.gain_dn_per_e,
    }
    meta = {**shot.meta, "saturation_dn": scale.top_dn, "usual_full_dn": usual, "merged": merged}
    return replace(shot_with_frames(shot, longest), images=images, meta=meta)


def pixel_noise(shot: Shot, groups: Sequence[Sequence[int]]) -> PixelNoise:
    """Black level and noise, from the longest and the shortest exposure of the first group of several.

    Of the difference `(short - black) / q - (long - black)`, q the ratio of the exposures, the variance is
    `dark (1/q^2 + 1) + gain signal (1/q + 1)`: a straight line over the signal.
    """
    group = max(groups, key=len)
    if len(group) == 1:
        return _usual_noise(0.0, shot.saturation_dn)
    short, long = (chosen(group, key=lambda frame: shot.exposure_s[frame]) for chosen in (min, max))
    thinned = shot.images[:, ::THINNED, ::THINNED]
    ratio = float(shot.exposure_s[short] / shot.exposure_s[long])
    return _noise_of_pair(thinned[short], thinned[long], ratio, shot.saturation_dn)


def _noise_of_pair(
    short: UInt[Array, "row column"], long: UInt[Array, "row column"], ratio: float, saturation_dn: int
) -> PixelNoise:
    usable = long < FULL_SHARE * saturation_dn
    if np.count_nonzero(usable) < LEAST_IN_LEVEL:
        return _usual_noise(0.0, saturation_dn)
    dim, bright = short[usable].astype(np.float64), long[usable].astype(np.float64)
    black_dn = max(0.0, _mean_of_most(dim - ratio * bright) / (1 - ratio))
    signal_dn = bright - black_dn
    levels = _levels(signal_dn, (dim - black_dn) / ratio - signal_dn)
    if len(levels) < 2:
        return _usual_noise(black_dn, saturation_dn)
    weight = np.array([count**0.5 / max(spread, LEAST_VARIANCE_DN2) for _, spread, count in levels])
    spreads = np.array([spread for _, spread, _ in levels])
    terms = np.array([[1 / ratio**2 + 1, max(signal, 0.0) * (1 / ratio + 1)] for signal, _, _ in levels])
    dark_variance, gain = np.linalg.lstsq(terms * weight[:, None], spreads * weight, rcond=None)[0]
    return PixelNoise(
        black_dn=black_dn,
        dark_variance_dn2=max(float(dark_variance), LEAST_VARIANCE_DN2),
        gain_dn_per_e=max(float(gain), 0.0),
    )


def _levels(signal_dn: Float64[Array, "n"], difference_dn: Float64[Array, "n"]) -> list[tuple[float, float, int]]:
    """Mean signal, variance of the difference and number of pixels in bins of equal width that have enough."""
    edges = np.linspace(signal_dn.min(), signal_dn.max() + 1e-9, LEVELS + 1)
    level = np.digitize(signal_dn, edges) - 1
    inside = [level == number for number in range(LEVELS)]
    return [
        (float(signal_dn[chosen].mean()), _variance_of_most(difference_dn[chosen]), int(np.count_nonzero(chosen)))
        for chosen in inside
        if np.count_nonzero(chosen) >= LEAST_IN_LEVEL
    ]


def _usual_noise(black_dn: float, saturation_dn: int) -> PixelNoise:
    """Of a sensor of 10000 electrons, where the brackets say nothing."""
    return PixelNoise(
        black_dn=black_dn, dark_variance_dn2=LEAST_VARIANCE_DN2, gain_dn_per_e=saturation_dn / USUAL_FULL_E
    )


def _merged(shot: Shot, group: Sequence[int], noise: PixelNoise, scale: Scale) -> UInt16[Array, "row column"]:
    images = [shot.images[frame].astype(np.float32) for frame in group]
    exposures_s = [float(shot.exposure_s[frame]) for frame in group]
    first = np.maximum(_rate(images, exposures_s, exposures_s, noise, scale), 0)
    weights = [_weight(first, exposure_s, noise) for exposure_s in exposures_s]
    rate = _rate(images, exposures_s, weights, noise, scale)
    never = np.logical_and.reduce([image >= scale.full_dn for image in images])
    grey = np.where(never, np.float32(scale.top_dn), scale.pedestal_dn + rate * np.float32(scale.unit_s))
    merged: UInt16[Array, "row column"] = np.rint(grey.clip(0, scale.top_dn)).astype(np.uint16)
    return merged


def _weight(rate: Image, exposure_s: float, noise: PixelNoise) -> Image:
    """Inverse of the variance of the rate that an exposure gives."""
    signal_dn = rate * np.float32(exposure_s)
    variance_dn2 = np.float32(noise.dark_variance_dn2) + np.float32(noise.gain_dn_per_e) * signal_dn
    weight: Image = np.float32(exposure_s**2) / variance_dn2
    return weight


def _rate(
    images: Sequence[Image],
    exposures_s: Sequence[float],
    weights: Sequence[float | Image],
    noise: PixelNoise,
    scale: Scale,
) -> Image:
    """Mean of the rates of the exposures in which a pixel is not full; 0 where it is in all."""
    total = np.zeros_like(images[0])
    weight_sum = np.zeros_like(images[0])
    for image, exposure_s, weight in zip(images, exposures_s, weights, strict=True):
        counted = np.where(image < scale.full_dn, weight, 0.0).astype(np.float32)
        total += counted * ((image - np.float32(noise.black_dn)) / np.float32(exposure_s))
        weight_sum += counted
    rate: Image = total / np.maximum(weight_sum, np.float32(1e-30))
    return rate


def _mean_of_most(values: Float64[Array, "n"]) -> float:
    low, high = np.quantile(values, [0.02, 0.98])
    return float(values[(values >= low) & (values <= high)].mean())


def _variance_of_most(values: Float64[Array, "n"]) -> float:
    """Variance about the mean, without what lies beyond four of its roots."""
    for _ in range(3):
        values = values[np.abs(values - values.mean()) <= 4 * values.std() + 1e-9]
    return float(values.var())


def on_the_scale_of(image: UInt[Array, "row column"], exposure_s: float, shot: Shot) -> UInt[Array, "row column"]:
    """A frame as taken, with the grey values that a merged shot has; as it is beside one that was not merged."""
    merged = shot.meta.get("merged")
    if merged is None:
        return image
    grey = (image.astype(np.float32) - merged["black_dn"]) * (merged["scale_s"] / exposure_s) + merged["pedestal_dn"]
    scaled: UInt16[Array, "row column"] = np.rint(grey.clip(0, shot.saturation_dn)).astype(np.uint16)
    return scaled
