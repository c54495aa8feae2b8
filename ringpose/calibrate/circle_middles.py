"""Middles of dark ellipses where the light is uneven (ringpose-method(7), section 7).

A threshold cuts deeper into a circle on the side where there is less light: where it falls by a thousandth a pixel,
OpenCV's middles of circles are 0.01 px aside. Here each pixel's share of ink is measured between the levels of ink
and paper, both linear functions of place, and an ellipse with a blurred edge is moved and widened until it has these.
"""

import numpy as np
from scipy.special import ndtr

from ringpose.calibrate.edge_profile import LEAST_BLUR_PX
from ringpose.calibrate.image_patch import grey_around
from ringpose.types.arrays import Array, Bool, Float64, UInt8

BAND_PX = 4.0
"""Half width of the band about the ellipse in which a blurred edge has its mixture of ink and paper."""

RIM_PX = 4.0
"""Width of the paper around it that tells the level of the light."""

FEWEST = 20
"""Pixels of paper, below which its level is not known; ink needs as many for a level that is not even."""


def levelled_middles(
    grey: UInt8[Array, "row column"],
    middles_px: Float64[Array, "circle xy=2"],
    conics: Float64[Array, "circle 3 3"],
) -> Float64[Array, "circle xy=2"]:
    """The middles by the ink's edges; one that cannot be told keeps its place.

    Each ellipse has the size and shape of its conic, wherever that lies, and the middle that is given.
    """
    found = [_middle(grey, *one) for one in zip(middles_px, conics, strict=True)]
    return np.array([start if one is None else one for start, one in zip(middles_px, found, strict=True)])


def _middle(
    grey: UInt8[Array, "row column"], middle: Float64[Array, "xy=2"], conic: Float64[Array, "3 3"]
) -> Float64[Array, "xy=2"] | None:
    shape, extent = _shape(conic)
    half = int(np.ceil(extent + BAND_PX + RIM_PX))
    around = grey_around(grey, middle, half)
    if around is None:
        return None
    patch, offset = around
    outside = _outside_px(offset, shape)
    share = _dark_share(patch, offset, outside)
    if share is None:
        return None
    step = _step(share, outside, offset @ shape)
    return middle + step if np.linalg.norm(step) < BAND_PX / 2 else None


def _step(
    share: Float64[Array, "row column"],
    outside: Float64[Array, "row column"],
    slope: Float64[Array, "row column xy=2"],
) -> Float64[Array, "xy=2"]:
    """What moves the ellipse to the shares in the band, its size free; the blur is that of the shares."""
    band = np.abs(outside) <= BAND_PX
    far, seen = outside[band], share[band]
    blur_px = max(np.sqrt(np.pi / 2) * 2 * BAND_PX * float(np.mean(np.abs(seen - (far < 0)))), LEAST_BLUR_PX)
    steep = np.exp(-0.5 * (far / blur_px) ** 2) / (blur_px * np.sqrt(2 * np.pi))
    normal = slope[band] / np.linalg.norm(slope[band], axis=-1, keepdims=True)
    design = steep[:, None] * np.column_stack([normal, np.ones(len(far))])
    step: Float64[Array, "xy=2"] = np.linalg.lstsq(design, seen - ndtr(-far / blur_px))[0][:2]
    return step


def _shape(conic: Float64[Array, "3 3"]) -> tuple[Float64[Array, "2 2"], float]:
    """Matrix A of the ellipse x^T A x = 1 about its middle, and its longer half axis."""
    middle = np.append(np.linalg.solve(conic[:2, :2], -conic[:2, 2]), 1.0)
    shape: Float64[Array, "2 2"] = conic[:2, :2] / -(middle @ conic @ middle)
    return shape, float(1.0 / np.sqrt(np.linalg.eigvalsh(shape)[0]))


def _outside_px(
    offset: Float64[Array, "row column xy=2"], shape: Float64[Array, "2 2"]
) -> Float64[Array, "row column"]:
    """Distance from the ellipse, negative within: exact on the axes and near the ellipse."""
    mapped = offset @ shape
    size = np.sqrt(np.sum(mapped * offset, axis=-1))
    steep = np.maximum(np.linalg.norm(mapped, axis=-1), 1e-9)
    outside: Float64[Array, "row column"] = (size - 1.0) * size / steep
    return outside


def _dark_share(
    patch: Float64[Array, "row column"],
    offset: Float64[Array, "row column xy=2"],
    outside: Float64[Array, "row column"],
) -> Float64[Array, "row column"] | None:
    """1 where there is ink, 0 where there is paper, measured in the band; None where the paper is not seen."""
    paper, ink = (outside > BAND_PX) & (outside < BAND_PX + RIM_PX), outside < -BAND_PX
    if paper.sum() < FEWEST:
        return None
    bright = _level(patch, offset, paper)
    dark = _level(patch, offset, ink) if ink.sum() >= FEWEST else np.full(patch.shape, _darkest(patch, outside))
    if (bright - dark).min() <= 0:
        return None
    share = (bright - patch) / (bright - dark)
    return np.where(outside > BAND_PX, 0.0, np.where(ink, 1.0, share))


def _darkest(patch: Float64[Array, "row column"], outside: Float64[Array, "row column"]) -> float:
    """Grey in the middle of a small circle."""
    return float(np.median(patch[outside <= np.partition(outside.ravel(), 4)[4]]))


def _level(
    patch: Float64[Array, "row column"], offset: Float64[Array, "row column xy=2"], used: Bool[Array, "row column"]
) -> Float64[Array, "row column"]:
    """Brightness as a linear function of place, over the whole patch."""
    design = np.concatenate([np.ones((*patch.shape, 1)), offset], axis=-1)
    rows = design[used]
    plane: Float64[Array, "row column"] = design @ np.linalg.solve(rows.T @ rows, rows.T @ patch[used])
    return plane
