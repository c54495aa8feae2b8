"""Readable NumPy twin of the kernel that finds stripe centres: the oracle of its tests (ringpose-method(7), section 3).

Its steps are those of the kernel, each in the module of the same name: noise and coarse search, ridges (here), links
along the columns, centres, and what the differences between centres say of their standard deviations.
"""

import numpy as np

from ringpose.kernels.reference_stripe_centers import Light, centers
from ringpose.kernels.reference_stripe_links import Ridge, pieces
from ringpose.kernels.reference_stripe_patches import Filter, Pixels, bend, pixels_of, sections, split_filters
from ringpose.kernels.reference_stripe_search import enough, noise_figures, searched
from ringpose.kernels.stripes import Centers, Filters, StripeRules
from ringpose.types.arrays import Array, Bool, Float32, Int32, Int64, UInt


def stripes(
    image: UInt[Array, "row column"],
    dark: UInt[Array, "row column"] | None,
    bands: Int32[Array, "band side=4"] | None,
    filters: Filters,
    rules: StripeRules,
) -> Centers:
    """Twin of `ringpose.kernels.stripes.stripes`."""
    pixels, every = pixels_of(image, dark), split_filters(filters)
    noise = noise_figures(pixels, every[0])
    found = ridges(pixels, searched(image, dark, bands, noise, rules), noise, every[0], rules)
    return centers(Light(pixels, image >= rules.full_dn), pieces(pixels, found, every[0], rules), every, rules)


def ridges(
    pixels: Pixels,
    wanted: Bool[Array, "row column"],
    noise: Float32[Array, "row column"],
    filter_: Filter,
    rules: StripeRules,
) -> list[list[Ridge]]:
    """For each column, from the top, where the smoothed image bends most; the outermost rows have no ridge."""
    places: Int64[Array, "axis row column"] = np.indices(pixels.shape)
    response = bend(filter_, sections(pixels, places[0], places[1], filter_.reach))
    above, here, below = response[:-2], response[1:-1], response[2:]
    is_ridge = wanted[1:-1] & (here < above) & (here <= below) & (here <= -enough(rules, noise[1:-1]))
    columns: list[list[Ridge]] = [[] for _ in range(pixels.shape[1])]
    for x, i in np.argwhere(is_ridge.T).tolist():
        curve = (above[i, x] + below[i, x]) - 2 * here[i, x]
        y = np.float32(i + 1) + np.float32(0.5) * (above[i, x] - below[i, x]) / curve
        columns[x].append(Ridge(x, i + 1, y, -here[i, x], curve, noise[i + 1, x]))
    return columns
