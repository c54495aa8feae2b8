"""Where, near a predicted edge of a smooth surface, the surface ends: sub-pixel, across the edge.

The surface has one brightness up to its edge, blurred by the optics; what lies beyond has any brightness and
changes the more the farther it is. Of all places for the edge the likeliest is taken: the surface reaches as far
as its brightness does.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from ringpose.types.arrays import Array, Bool, Float64, UInt

INSIDE_PX = 5
"""How far inside the nearest place for the edge the surface's brightness is taken from."""

OUTSIDE_PX = 3
"""How far beyond the farthest place for the edge is looked."""

ALONG_PX = 4
"""Length of edge that makes one step: what lies beyond may change within a few pixels."""

CHANGE = 0.7
"""Standard deviation of what lies beyond, per pixel from the edge, in sigmas of the surface's noise."""

PLACES = 0.25
"""Distance between the places tried, in pixels; a parabola goes between them."""

NOISE_DN = 0.3
"""Least noise of a grey value: rounding to whole ones."""

FLAT = 1e-9
"""A sum of squares that bends less than this has no minimum."""

TOUCHED_PX = 3.0
"""Saturation this close to the edge hides how bright it is beyond."""

POOLED = 9
"""Neighbouring profiles whose noise is taken together."""


class Profiles(NamedTuple):
    """Brightness across predicted places of an edge, from the surface outward."""

    across_px: Float64[Array, "sample"]
    value: Float64[Array, "n sample"]
    """Above the surface's level, in units of its noise."""
    saturated: Bool[Array, "n sample"]
    noise_dn: Float64[Array, "n"]


class EdgeSteps(NamedTuple):
    """The step found near each predicted place."""

    offset_px: Float64[Array, "n"]
    """Along the normal, from the predicted place; NaN where there is no step."""
    sigma_px: Float64[Array, "n"]
    height: Float64[Array, "n"]
    """Of the step, in its own standard deviations."""
    height_dn: Float64[Array, "n"]
    cost: Float64[Array, "n"]
    """Sum of squares that the step leaves unexplained, in units of the noise."""


class _Templates(NamedTuple):
    """All that does not depend on the image, for each place of the edge."""

    place: Float64[Array, "place"]
    weight: Float64[Array, "sample place"]
    basis: Float64[Array, "sample place_2"]
    """Orthonormal under the weights: the surface's level, and the step."""
    unit: Float64[Array, "place"]
    """Size of a step of one in that basis."""


def edge_profiles(
    image: UInt[Array, "row column"],
    place_px: Float64[Array, "n xy=2"],
    normal: Float64[Array, "n xy=2"],
    reach_px: int,
    saturation_dn: int,
) -> Profiles:
    """Mean brightness across each predicted place, over `ALONG_PX` of edge; the normals point off the surface."""
    across = np.arange(-reach_px - INSIDE_PX, reach_px + OUTSIDE_PX + 1, dtype=np.float64)
    along = np.arange(ALONG_PX) - (ALONG_PX - 1) / 2
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=-1)
    start = place_px[:, None] + along[:, None] * tangent[:, None]
    points = start[:, :, None] + across[:, None] * normal[:, None, None]
    sampled = _sampled(image, points)
    value = sampled.mean(axis=1, dtype=np.float64)
    surface = value[:, :INSIDE_PX]
    noise_dn = np.sqrt(_pooled(np.var(surface, axis=1, ddof=1)) + NOISE_DN**2 / ALONG_PX)
    saturated: Bool[Array, "n sample"] = np.max(sampled, axis=1) >= saturation_dn
    return Profiles(
        across_px=across,
        value=(value - surface.mean(axis=1, keepdims=True)) / noise_dn[:, None],
        saturated=saturated,
        noise_dn=noise_dn,
    )


def _sampled(
    image: UInt[Array, "row column"], points: Float64[Array, "n along sample xy=2"]
) -> UInt[Array, "n along sample"]:
    """Grey values between the pixels."""
    if not len(points):
        return np.zeros(points.shape[:-1], dtype=image.dtype)
    x, y = (points[..., axis].reshape(len(points), -1).astype(np.float32) for axis in (0, 1))
    sampled: UInt[Array, "n sample"] = cv2.remap(image, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return sampled.reshape(points.shape[:-1])


def edge_steps(profiles: Profiles, reach_px: int, blur_px: float) -> EdgeSteps:
    """The likeliest place of a step of this blur (sigma) in each profile, within `reach_px` of the predicted one."""
    if not len(profiles.value):
        return EdgeSteps(*np.empty((5, 0)))
    templates = _templates(reach_px, blur_px)
    count = len(templates.place)
    projected = (profiles.value @ templates.basis).reshape(-1, count, 2)
    cost = (profiles.value**2) @ templates.weight - np.sum(projected**2, axis=-1)

    rows, best = np.arange(len(cost)), np.clip(np.argmin(cost, axis=1), 1, count - 2)
    left, least, right = (cost[rows, best + k] for k in (-1, 0, 1))
    bend = left - 2 * least + right
    found = (bend > FLAT) & (least <= left) & (least <= right)
    bend = np.where(found, bend, 1.0)
    offset = templates.place[best] + np.where(found, (left - right) / (2 * bend), 0.0) * PLACES
    touched = np.any(profiles.saturated & (np.abs(profiles.across_px - offset[:, None]) < TOUCHED_PX), axis=1)
    misfit = np.maximum(_pooled(least / (len(profiles.across_px) - 3)), 1.0)
    height = np.abs(projected[rows, best, 1])
    return EdgeSteps(
        offset_px=np.where(found & ~touched, offset, np.nan),
        sigma_px=PLACES * np.sqrt(2 * misfit / bend),
        height=height / np.sqrt(misfit),
        height_dn=height * profiles.noise_dn / templates.unit[best],
        cost=least,
    )


def _pooled(values: Float64[Array, "n"]) -> Float64[Array, "n"]:
    """Running mean over neighbours, fewer at the ends."""
    if not len(values):
        return values
    window = np.ones(POOLED)
    return _same(values, window) / _same(np.ones(len(values)), window)


def _same(values: Float64[Array, "n"], window: Float64[Array, "m"]) -> Float64[Array, "n"]:
    half = len(window) // 2
    return np.convolve(values, window)[half : half + len(values)]


@lru_cache(maxsize=256)
def _templates(reach_px: int, blur_px: float) -> _Templates:
    """The two levels on both sides of each place, blurred, and the weights of the samples there."""
    across = np.arange(-reach_px - INSIDE_PX, reach_px + OUTSIDE_PX + 1, dtype=np.float64)
    place = np.arange(-reach_px, reach_px + PLACES / 2, PLACES)
    beyond = across - place[:, None]
    step = np.array([[0.5 * math.erfc(-u / (blur_px * math.sqrt(2))) for u in row] for row in beyond])
    sigma = np.sqrt(1 + (CHANGE * np.maximum(beyond, 0)) ** 2)
    orthonormal, triangle = np.linalg.qr(np.stack([np.ones_like(step), step], axis=-1) / sigma[..., None])
    basis = orthonormal / sigma[..., None]
    return _Templates(
        place=place,
        weight=np.ascontiguousarray(sigma.T**-2.0),
        basis=np.ascontiguousarray(basis.transpose(1, 0, 2).reshape(len(across), -1)),
        unit=np.abs(triangle[:, 1, 1]),
    )
