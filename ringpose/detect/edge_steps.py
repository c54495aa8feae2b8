"""Where, near a predicted edge of a smooth surface, the surface ends: sub-pixel, across the edge.

The surface has one brightness up to its edge, blurred by the optics; what lies beyond has any brightness and
changes the more the farther it is. Of all places for the edge the likeliest is taken: the surface reaches as far
as its brightness does.
"""

import math
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ringpose.kernels import edges as kernels
from ringpose.kernels.edges import ProfileRules, StepRules, Templates
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


def edge_profiles(
    image: UInt[Array, "row column"],
    place_px: Float64[Array, "n xy=2"],
    normal: Float64[Array, "n xy=2"],
    reach_px: int,
    saturation_dn: int,
) -> Profiles:
    """Mean brightness across each predicted place, over `ALONG_PX` of edge; the normals point off the surface."""
    rules = ProfileRules(reach_px, INSIDE_PX, OUTSIDE_PX, ALONG_PX, NOISE_DN, POOLED, saturation_dn)
    return Profiles(*kernels.edge_profiles(image, place_px, normal, rules))


def edge_steps(profiles: Profiles, reach_px: int, blur_px: float) -> EdgeSteps:
    """The likeliest place of a step of this blur (sigma) in each profile, within `reach_px` of the predicted one."""
    rules = StepRules(FLAT, TOUCHED_PX, PLACES, POOLED)
    return EdgeSteps(*kernels.edge_steps(*profiles, _templates(reach_px, blur_px), rules).T)


@lru_cache(maxsize=256)
def _templates(reach_px: int, blur_px: float) -> Templates:
    """The two levels on both sides of each place, blurred, and the weights of the samples there."""
    across = np.arange(-reach_px - INSIDE_PX, reach_px + OUTSIDE_PX + 1, dtype=np.float64)
    place = np.arange(-reach_px, reach_px + PLACES / 2, PLACES)
    beyond = across - place[:, None]
    step = np.array([[0.5 * math.erfc(-u / (blur_px * math.sqrt(2))) for u in row] for row in beyond])
    sigma = np.sqrt(1 + (CHANGE * np.maximum(beyond, 0)) ** 2)
    orthonormal, triangle = np.linalg.qr(np.stack([np.ones_like(step), step], axis=-1) / sigma[..., None])
    basis = orthonormal / sigma[..., None]
    return Templates(
        across_px=across,
        place_px=place,
        weight=np.ascontiguousarray(sigma.T**-2.0),
        level=np.ascontiguousarray(basis[..., 0].T),
        step=np.ascontiguousarray(basis[..., 1].T),
        unit=np.abs(triangle[:, 1, 1]),
    )
