"""Readable NumPy twin of `stripe_noise.c` and `stripe_search.c`: how noisy an image is, and where ridges may be.

See ringpose-method(7), section 3.
"""

import numpy as np

from ringpose.kernels.reference_stripe_patches import Filter, Pixels, bend, sections
from ringpose.kernels.stripes import BLOCK, CELL, StripeRules
from ringpose.types.arrays import Array, Bool, Float32, Int32, Int64, UInt

NOISE_ROWS, NOISE_BLOCKS = 128, 4
"""Size of the areas of which each has a noise figure."""

STRIPS, STRIP_COLUMNS, RANK = 8, 4, 6
"""Rows of an area that are looked at; columns whose mean is a sample; rank of the sample that counts."""

RANK_VALUE = np.float32(0.542)
"""Expected value of that sample for white noise with a response of 1."""

ROUNDING_NOISE = 0.289
"""Standard deviation of rounding to whole grey values."""

WINDOW_SHARE = 4
"""A window is passed over if one that overlaps it is brighter by this factor."""

NEIGHBOUR_SHARE = 0.4
"""Beside a window with a ridge, one of which a stripe fills this share may hold its end."""


def noise_figures(pixels: Pixels, filter_: Filter) -> Float32[Array, "row column"]:
    """Noise of the second derivative for each pixel, clutter included: a low sample of its area's absolute responses.

    An area is so tall that stripes fill the lesser part of it.
    """
    height, width = pixels.shape
    figures = np.empty((height, width), np.float32)
    for top in range(0, height, NOISE_ROWS):
        for left in range(0, width, NOISE_BLOCKS * BLOCK):
            area = (slice(top, top + NOISE_ROWS), slice(left, left + NOISE_BLOCKS * BLOCK))
            figures[area] = _area_noise(pixels, filter_, top, left)
    return figures


def _area_noise(pixels: Pixels, filter_: Filter, top: int, left: int) -> np.float32:
    """A low sample; never less than what rounding makes."""
    height = min(NOISE_ROWS, pixels.shape[0] - top)
    blocks = min(NOISE_BLOCKS, -(-(pixels.shape[1] - left) // BLOCK))
    strip = np.arange(STRIPS)
    row = top + (2 * strip + 1) * height // (2 * STRIPS)
    column = left + strip % blocks * BLOCK + np.arange(BLOCK)[:, None]
    response = abs(bend(filter_, sections(pixels, np.broadcast_to(row, column.shape), column, filter_.reach)))
    a, b, c, d = response.T.reshape(-1, STRIP_COLUMNS).T
    sample = np.sort(((a + b) + (c + d)) / STRIP_COLUMNS)[RANK] / RANK_VALUE
    return np.float32(max(sample, np.float32(ROUNDING_NOISE * filter_.bend_norm)))


def enough(rules: StripeRules, noise: Float32[Array, "*shape"]) -> Float32[Array, "*shape"]:
    """What a ridge must answer at least to continue a piece."""
    answer: Float32[Array, "*shape"] = np.maximum(np.float32(rules.continue_sigmas) * noise, rules.least_response)
    return answer


def searched(
    image: UInt[Array, "row column"],
    dark: UInt[Array, "row column"] | None,
    bands: Int32[Array, "band side=4"] | None,
    noise: Float32[Array, "row column"],
    rules: StripeRules,
) -> Bool[Array, "row column"]:
    """Pixels at which there may be ridges, in cells of 4 x 16, from whole numbers.

    Two cells below each other are a window; it holds what is brighter than the cells above and below it.
    """
    sums = cell_sums(image) - (0 if dark is None else cell_sums(dark))
    count = len(sums) - 5
    far_above, above, first, second, below, far_below = (sums[i : i + count] for i in range(6))
    window = first + second - np.minimum(above + below, far_above + far_below)
    if bands is not None:
        window = np.where(_asked(bands, image.shape, window.shape), window, 0)
    kept = _kept(window, noise, rules)
    cells = kept[:-1] | kept[1:]
    height, width = image.shape
    pixels: Bool[Array, "row column"] = np.repeat(np.repeat(cells, CELL, axis=0), BLOCK, axis=1)[:height, :width]
    return pixels


def cell_sums(image: UInt[Array, "row column"]) -> Int64[Array, "above_and_below block"]:
    """Sums over cells, from three rows of cells above the image to three below; the border's pixels are repeated."""
    height, width = image.shape
    cells, blocks = -(-height // CELL), -(-width // BLOCK)
    rows = np.clip(np.arange(-3 * CELL, (cells + 3) * CELL), 0, height - 1)
    columns = np.minimum(np.arange(blocks * BLOCK), width - 1)
    pixels = image[rows][:, columns].astype(np.int64)
    sums: Int64[Array, "above_and_below block"] = pixels.reshape(cells + 6, CELL, blocks, BLOCK).sum(axis=(1, 3))
    return sums


def _asked(
    bands: Int32[Array, "band side=4"], size: tuple[int, int], shape: tuple[int, int]
) -> Bool[Array, "window block"]:
    """Windows that hold pixels of a band; the first window begins in cell -1."""
    asked = np.zeros(shape, bool)
    for band in bands.tolist():
        pixels = np.zeros(size, bool)
        left, right, top, bottom = (max(side, 0) for side in band)
        pixels[top:bottom, left:right] = True
        rows, columns = np.flatnonzero(pixels.any(axis=1)), np.flatnonzero(pixels.any(axis=0))
        asked[np.ix_(np.unique([rows // CELL, rows // CELL + 1]), np.unique(columns // BLOCK))] = True
    return asked


def _kept(
    window: Int64[Array, "window block"], noise: Float32[Array, "row column"], rules: StripeRules
) -> Bool[Array, "window block"]:
    """Windows that may hold a ridge, and their neighbours where a stripe may end."""
    least_sum = max(1, int(float(np.float32(rules.coarse_per_response)) * float(np.float32(rules.least_response))))
    around = np.pad(window, ((1, 1), (0, 0)))
    crest = WINDOW_SHARE * window >= np.maximum(around[:-2], around[2:])
    row = np.clip(np.arange(len(window)) * CELL, 0, len(noise) - 1)
    least = np.float32(rules.coarse_per_response) * enough(rules, noise[row][:, ::BLOCK])
    kept = (window >= least_sum) & crest & (window.astype(np.float32) >= least)
    end = window.astype(np.float32)
    kept_beside: Bool[Array, "window block"] = kept.copy()
    kept_beside[:, :-1] |= kept[:, 1:] & (end[:, :-1] >= NEIGHBOUR_SHARE * least[:, 1:])
    kept_beside[:, 1:] |= kept[:, :-1] & (end[:, 1:] >= NEIGHBOUR_SHARE * least[:, :-1])
    return kept_beside
