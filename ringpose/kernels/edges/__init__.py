"""The kernels that follow a ring's edges, behind typed functions."""

from typing import NamedTuple

import numpy as np

from ringpose.geometry.ring_arcs import RingArcs
from ringpose.kernels import _kernels
from ringpose.kernels.lines import Lens
from ringpose.types.arrays import Array, Bool, Float64, UInt


class PlaceParams(NamedTuple):
    """Where places of the edges are wanted."""

    image_width: float
    image_height: float
    spacing_px: float
    """Distance between places, at the arcs' origin."""
    sigma_px: float
    """There is no place where the edge is predicted worse than this."""
    half_turn_rad: float
    """Most of the ring to both sides of the origin."""
    margin_px: float
    """There is no place so close to the image's border."""
    wider: float
    """Share of the image's size by which distortion may shift what is near its border."""
    oblique: float
    """Most by which foreshortening and depth shrink an error across the edge in the image."""
    detour: float
    """Length of an arc from the origin to the farthest corner of the image, over the distance."""
    nudge_m: float
    """Step off the face that tells metres a pixel."""
    farthest: float = 1e5
    """Places to both sides of the origin."""


class ProfileParams(NamedTuple):
    """How brightness across an edge is sampled; every pixel from `reach_px` + `inside_px` inside the place on."""

    reach_px: float
    inside_px: float
    """Samples that tell the surface's brightness and noise."""
    outside_px: float
    along_px: float
    """Samples along the edge that are averaged."""
    noise_dn: float
    """Least noise of a sample."""
    pooled: float
    """Neighbouring profiles whose noise is taken together."""
    saturation_dn: float


class StepParams(NamedTuple):
    """How the step in a profile is placed."""

    flat: float
    """A sum of squares that bends less than this has no minimum."""
    touched_px: float
    """Saturation this close to the edge hides how bright it is beyond."""
    spacing_px: float
    """Of the places tried."""
    pooled: float
    """Neighbouring profiles whose misfit is taken together."""


class Templates(NamedTuple):
    """All about steps that does not depend on the image, for each place of the edge."""

    across_px: Float64[Array, "sample"]
    place_px: Float64[Array, "place"]
    weight: Float64[Array, "sample place"]
    level: Float64[Array, "sample place"]
    """Orthonormal to `step` under the weights."""
    step: Float64[Array, "sample place"]
    unit: Float64[Array, "place"]
    """Size of a step of one in `step`."""


class FitParams(NamedTuple):
    """How long arcs are fitted, what counts less, and what holds them where the evidence leaves them open."""

    rounds: int
    """Of Gauss and Newton's steps."""
    outlier_sigmas: float
    """The weight of a sight falls as the fourth power of its distance beyond."""
    tilt_sigma_rad: float
    """Of priors, from here on; the tilts' and the turn's stand about given axes."""
    turn_sigma_rad: float
    curvature_sigma: float
    half_band_m: float
    half_band_sigma_m: float
    longest_step: tuple[float, ...]
    """Of a round."""


class PlanePoints(NamedTuple):
    """Points of the ring's plane."""

    point: Float64[Array, "m xyz=3"]
    sigma_m: Float64[Array, "m"]


class Sights(NamedTuple):
    """Rays that should meet an edge."""

    ray: Float64[Array, "n xyz=3"]
    side: Float64[Array, "n"]
    """1 for the inner edge, -1 for the outer."""
    sigma_m: Float64[Array, "n"]
    """Across the edge, on the ring's plane."""


def edge_places(
    arcs: RingArcs, covariance: Float64[Array, "state=7 state=7"], lens: Lens, rules: PlaceParams
) -> Float64[Array, "n column=13"]:
    """Places along the inner edge, then along the outer, where the image should show them.

    Columns: the point (3), the unit vector off the face (3), the side (1 inner, -1 outer), the place in pixels (2),
    the edge's unit normal there, off the face (2), metres a pixel along it, and the place's number along the edge.
    """
    found = _kernels.edge_places(_numbers_of(arcs), np.ascontiguousarray(covariance), lens, rules)
    return np.frombuffer(found, dtype=np.float64).reshape(-1, 13)


def edge_profiles(
    image: UInt[Array, "row column"],
    place_px: Float64[Array, "n xy=2"],
    normal: Float64[Array, "n xy=2"],
    rules: ProfileParams,
) -> tuple[Float64[Array, "n sample"], Bool[Array, "n sample"], Float64[Array, "n"]]:
    """Mean brightness across each place, above the surface's and in units of its noise; saturation; that noise.

    Between pixels grey values are interpolated; a sample is saturated if one of those averaged is.
    """
    samples = int(2 * rules.reach_px + rules.inside_px + rules.outside_px) + 1
    value, noise = np.empty((len(place_px), samples)), np.empty(len(place_px))
    saturated = np.empty(value.shape, dtype=np.bool_)
    image, place_px, normal = (np.ascontiguousarray(each) for each in (image, place_px, normal))
    _kernels.edge_profiles(image, place_px, normal, rules, value, saturated, noise)
    return value, saturated, noise


def edge_steps(
    value: Float64[Array, "n sample"],
    saturated: Bool[Array, "n sample"],
    noise_dn: Float64[Array, "n"],
    templates: Templates,
    rules: StepParams,
) -> Float64[Array, "n column=5"]:
    """The likeliest step in each profile: offset (NaN for none), sigma, height in sigmas, height in grey values, cost.

    The offset and its sigma are in pixels; the cost is the sum of squares that the step leaves unexplained.
    """
    table = np.stack([templates.weight, templates.level, templates.step])
    value, saturated, noise_dn = (np.ascontiguousarray(each) for each in (value, saturated, noise_dn))
    found = _kernels.edge_steps(
        value, saturated, noise_dn, templates.across_px, templates.place_px, templates.unit, table, rules
    )
    return np.frombuffer(found, dtype=np.float64).reshape(-1, 5)


def fitted_arcs(
    arcs: RingArcs,
    plane: PlanePoints,
    sights: Sights,
    reference: Float64[Array, "3 xyz=3"],
    rules: FitParams,
) -> tuple[RingArcs, Float64[Array, "state=7 state=7"]]:
    """The arcs after some rounds of Gauss-Newton, and the covariance of their state; NaN where nothing holds them.

    The tilts' and the turn's priors stand about the axes of `reference`.
    """
    numbers = (*rules[:-1], *rules.longest_step)
    point, plane_sigma, ray, side, sigma = (np.ascontiguousarray(each) for each in (*plane, *sights))
    axes = np.ascontiguousarray(reference)
    found = np.frombuffer(
        _kernels.edge_fit(_numbers_of(arcs), point, plane_sigma, axes, ray, side, sigma, numbers), dtype=np.float64
    )
    fitted = RingArcs(
        origin=found[:3], axes=found[3:12].reshape(3, 3), curvature=float(found[12]), half_band_m=float(found[13])
    )
    return fitted, found[14:].reshape(7, 7)


def _numbers_of(arcs: RingArcs) -> Float64[Array, "14"]:
    return np.concatenate([arcs.origin, arcs.axes.ravel(), (arcs.curvature, arcs.half_band_m)])
