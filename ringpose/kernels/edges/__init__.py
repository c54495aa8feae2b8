"""Prediction and measurement of a ring's two edges (ringpose-method(7), section 5).

The sources are ring_arcs.c (prediction of the edges in the image) and edge_steps.c (intensity profiles and the steps in
them).
"""

from typing import NamedTuple

import numpy as np

from ringpose.geometry.ring import RingArcs
from ringpose.kernels import _kernels
from ringpose.kernels.lines import Lens
from ringpose.types.arrays import Array, Bool, Float64, UInt


class PlaceParams(NamedTuple):
    """Where points of the edges are predicted."""

    image_width: float
    image_height: float
    spacing_px: float
    """Distance between neighbouring points, at the arcs' origin."""
    sigma_px: float
    """Points with a larger predicted sigma across the edge are left out."""
    half_turn_rad: float
    """Largest angle on the ring to both sides of the origin."""
    margin_px: float
    """Points closer than this to the image border are left out."""
    wider: float
    """Upper bound of the distortion at the image border, as a share of the image size."""
    oblique: float
    """Upper bound of the factor by which foreshortening and depth reduce an error across the edge in the image."""
    detour: float
    """Upper bound of the length of an arc from the origin to the farthest image corner, divided by their distance."""
    nudge_m: float
    """Step of the numerical derivative for metres per pixel."""
    farthest: float = 1e5
    """Largest number of points to each side of the origin."""


class ProfileParams(NamedTuple):
    """Sampling of intensity profiles across an edge, every pixel from `reach_px` + `inside_px` inside the point on."""

    reach_px: float
    inside_px: float
    """Samples from which the intensity and noise of the surface are estimated."""
    outside_px: float
    along_px: float
    """Number of samples along the edge that are averaged."""
    noise_dn: float
    """Lower bound of the noise of a sample."""
    pooled: float
    """Neighbouring profiles over which the noise variance is averaged."""
    saturation_dn: float


class StepParams(NamedTuple):
    """Parameters of the step fit in a profile."""

    flat: float
    """Smallest second difference of the cost at a minimum."""
    touched_px: float
    """A profile with a saturated sample closer than this to the step is rejected."""
    spacing_px: float
    """Distance between the step positions that are tried."""
    pooled: float
    """Neighbouring profiles over which the residual variance is averaged."""


class Templates(NamedTuple):
    """Step templates, which do not depend on the image, for each position of the step."""

    across_px: Float64[Array, "sample"]
    place_px: Float64[Array, "place"]
    table: Float64[Array, "part=3 sample place"]
    """Weight; constant part, orthonormal to the step under the weights; step."""
    unit: Float64[Array, "place"]
    """Coefficient of the step part for a step of height 1."""


def edge_places(
    arcs: RingArcs, covariance: Float64[Array, "step=7 step=7"], lens: Lens, params: PlaceParams
) -> Float64[Array, "n column=13"]:
    """Predicted points of the inner edge, then of the outer edge, in the image.

    Columns: the point (3, camera frame, m), the unit vector off the face (3), the edge's sign (-1 inner, 1 outer), the
    distorted pixel position (2), the edge's unit normal there, off the face (2), metres per pixel along it, and
    the number of the point along the edge.
    """
    found = _kernels.edge_places(_numbers_of(arcs), np.ascontiguousarray(covariance), lens, params)
    return np.frombuffer(found, dtype=np.float64).reshape(-1, 13)


def edge_profiles(
    image: UInt[Array, "row column"],
    place_px: Float64[Array, "n xy=2"],
    normal: Float64[Array, "n xy=2"],
    params: ProfileParams,
) -> tuple[Float64[Array, "n sample"], Bool[Array, "n sample"], Float64[Array, "n"]]:
    """Intensity profiles across the edge less that of the surface, in units of its noise; saturation; that noise.

    Grey values are interpolated bilinearly; a sample is saturated if one of the averaged values is.
    """
    samples = int(2 * params.reach_px + params.inside_px + params.outside_px) + 1
    value, noise = np.empty((len(place_px), samples)), np.empty(len(place_px))
    saturated = np.empty(value.shape, dtype=np.bool_)
    image, place_px, normal = (np.ascontiguousarray(each) for each in (image, place_px, normal))
    _kernels.edge_profiles(image, place_px, normal, params, value, saturated, noise)
    return value, saturated, noise


def edge_steps(
    value: Float64[Array, "n sample"],
    saturated: Bool[Array, "n sample"],
    noise_dn: Float64[Array, "n"],
    templates: Templates,
    params: StepParams,
) -> Float64[Array, "n column=5"]:
    """Most likely step in each profile: offset (NaN if none), sigma, height in sigmas, height in grey values, cost.

    The offset and its sigma are in pixels; the cost is the sum of squared residuals.
    """
    value, saturated, noise_dn = (np.ascontiguousarray(each) for each in (value, saturated, noise_dn))
    found = _kernels.edge_steps(
        value, saturated, noise_dn, templates.across_px, templates.place_px, templates.unit, templates.table, params
    )
    return np.frombuffer(found, dtype=np.float64).reshape(-1, 5)


def _numbers_of(arcs: RingArcs) -> Float64[Array, "14"]:
    return np.concatenate([arcs.origin, arcs.axes.ravel(), (arcs.curvature, arcs.half_band_m)])
