"""The steps of brightness beside predicted places of the ring's edges, as evidence for the ring.

Where, near a predicted edge of a smooth surface, the surface ends: sub-pixel, across the edge.

The surface has one brightness up to its edge, blurred by the optics; what lies beyond has any brightness and
changes the more the farther it is. Of all places for the edge the likeliest is taken: the surface reaches as far
as its brightness does.

Where the image should show the ring's edges, and how well that is known.
"""

import math
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import cv2
import numpy as np

from ringpose.detect.stripes import lens
from ringpose.geometry.ring_arcs import RingArcs, off_face_m
from ringpose.kernels import edges as kernels
from ringpose.kernels.edges import PlaceParams, ProfileParams, Sights, StepParams, Templates
from ringpose.types.arrays import Array, Bool, Float64, UInt, UInt8
from ringpose.types.rig import Rig

BLUR_PX = 0.9
"""Blur (sigma) of edges that is assumed as long as nothing better is known."""

STEP_SIGMA_PX = 0.5
"""A step that is known worse than this is none."""

STEP_SIGMAS = 5.0
"""Nor is one whose height is less than this many of its standard deviations: one of many places fits noise well."""

STEP_DN = 2.0
"""Nor is one of fewer grey values: rounding to whole ones moves it."""

CLUTTER = 2.5
"""Steps are trusted as if their sigmas were so many times larger: what lies beyond the edge is no even ground."""

MIN_SIGMA_PX = 0.1
"""No single step is trusted more than this."""

CELL_PX, CELLS = 4, 2
"""Places up to so many cells of an image's grid from a stripe's centre are left out: 8 to 12 px."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeImage:
    """A frame in which the ring's edges are looked for."""

    image: UInt[Array, "row column"]
    saturation_dn: int
    lit: UInt8[Array, "cell_row cell_column"] | None = None
    """Not 0 in the cells of its grid that are beside a stripe; None for a frame without lasers."""


def lit_cells(
    stripes_px: Float64[Array, "center xy=2"], image: UInt[Array, "row column"]
) -> UInt8[Array, "cell_row cell_column"]:
    """Which cells of the image are beside one of the stripes' centres."""
    lit = np.zeros((image.shape[0] // CELL_PX + 1, image.shape[1] // CELL_PX + 1), dtype=np.uint8)
    column, row = (stripes_px / CELL_PX).astype(np.int64).T
    lit[row, column] = 1
    dilated: UInt8[Array, "cell_row cell_column"] = cv2.dilate(lit, np.ones((2 * CELLS + 1, 2 * CELLS + 1), np.uint8))
    return dilated


@dataclass(frozen=True, slots=True, eq=False)
class EdgeTrace:
    """Places on the predicted edges that lie in the image: along the inner edge, then along the outer."""

    table: Float64[Array, "n column=13"]
    """As `ringpose.kernels.edges.edge_places` gives them."""

    @property
    def point(self) -> Float64[Array, "n xyz=3"]:
        """On the ring's plane."""
        return self.table[:, :3]

    @property
    def outward(self) -> Float64[Array, "n xyz=3"]:
        """Unit vector on the ring's plane that leads off the face."""
        return self.table[:, 3:6]

    @property
    def side(self) -> Float64[Array, "n"]:
        """1 on the inner edge, -1 on the outer."""
        return self.table[:, 6]

    @property
    def place_px(self) -> Float64[Array, "n xy=2"]:
        """Where the image should show the point."""
        return self.table[:, 7:9]

    @property
    def normal(self) -> Float64[Array, "n xy=2"]:
        """Unit normal of the edge in the image, off the face."""
        return self.table[:, 9:11]

    @property
    def metres_per_px(self) -> Float64[Array, "n"]:
        """On the ring's plane, for a step along the normal."""
        return self.table[:, 11]

    @property
    def number(self) -> Float64[Array, "n"]:
        """Counts the places along an edge; those on the image's border are missing."""
        return self.table[:, 12]


def clear_of_stripes(frame: EdgeImage, trace: EdgeTrace) -> EdgeTrace:
    """The places without those beside a stripe."""
    if frame.lit is None:
        return trace
    column, row = (trace.place_px / CELL_PX).astype(np.int64).T
    return chosen(trace, frame.lit[row, column] == 0)


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


def steps_beside(frame: EdgeImage, trace: EdgeTrace, reach_px: int) -> EdgeSteps:
    """The steps within `reach_px` of the places of a trace, for want of better taken as blurred by `BLUR_PX`."""
    profiles = edge_profiles(frame.image, trace.place_px, trace.normal, reach_px, frame.saturation_dn)
    return edge_steps(profiles, reach_px, BLUR_PX)


def unoccluded_steps(steps: EdgeSteps) -> Bool[Array, "n"]:
    """Which steps are more than noise."""
    known = np.isfinite(steps.offset_px) & (steps.sigma_px < STEP_SIGMA_PX)
    return known & (steps.height > STEP_SIGMAS) & (steps.height_dn > STEP_DN)


def edge_observations(trace: EdgeTrace, steps: EdgeSteps) -> Sights:
    """The clear ones among the steps as evidence for the ring."""
    clear = unoccluded_steps(steps)
    sigma_px = CLUTTER * np.hypot(steps.sigma_px[clear], MIN_SIGMA_PX)
    return sights_at(chosen(trace, clear), steps.offset_px[clear], sigma_px)


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


def edge_profiles(
    image: UInt[Array, "row column"],
    place_px: Float64[Array, "n xy=2"],
    normal: Float64[Array, "n xy=2"],
    reach_px: int,
    saturation_dn: int,
) -> Profiles:
    """Mean brightness across each predicted place, over `ALONG_PX` of edge; the normals point off the surface."""
    rules = ProfileParams(reach_px, INSIDE_PX, OUTSIDE_PX, ALONG_PX, NOISE_DN, POOLED, saturation_dn)
    return Profiles(*kernels.edge_profiles(image, place_px, normal, rules))


def edge_steps(profiles: Profiles, reach_px: int, blur_px: float) -> EdgeSteps:
    """The likeliest place of a step of this blur (sigma) in each profile, within `reach_px` of the predicted one."""
    rules = StepParams(FLAT, TOUCHED_PX, PLACES, POOLED)
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


MARGIN_PX = 8.0
"""Closer to the image's border no edge is looked for."""

HALF_TURN = 2.0
"""Radians of the ring to both sides of the stripes that can be in view."""

WIDER = 0.3
"""Share of the image's size by which distortion may shift what is near its border."""

OBLIQUE = 3.0
"""Most by which foreshortening and depth shrink an error across the edge in the image."""

DETOUR = 1.3
"""Length of an arc from the stripes to the farthest corner of the image, over the distance."""

NUDGE_M = 1e-4
"""Step off the face that tells metres a pixel."""


def chosen(trace: EdgeTrace, which: Bool[Array, "n"]) -> EdgeTrace:
    """Some of the places."""
    return EdgeTrace(trace.table[which])


def edge_trace(
    arcs: RingArcs,
    covariance: Float64[Array, "state=7 state=7"],
    rig: Rig,
    spacing_px: int | float,
    sigma_px: float,
    farthest: int | float = math.inf,
) -> EdgeTrace:
    """Places about `spacing_px` apart along both edges, where these are predicted to `sigma_px`.

    There are at most `farthest` to both sides of the arcs' origin.
    """
    rules = PlaceParams(
        image_width=rig.camera.image_width,
        image_height=rig.camera.image_height,
        spacing_px=spacing_px,
        sigma_px=sigma_px,
        half_turn_rad=HALF_TURN,
        margin_px=MARGIN_PX,
        wider=WIDER,
        oblique=OBLIQUE,
        detour=DETOUR,
        nudge_m=NUDGE_M,
        farthest=farthest,
    )
    return EdgeTrace(kernels.edge_places(arcs, covariance, lens(rig.camera), rules))


def sights_at(trace: EdgeTrace, offset_px: Float64[Array, "n"], sigma_px: Float64[Array, "n"]) -> Sights:
    """The rays to what was found beside the places."""
    return Sights(
        ray=trace.point + (offset_px * trace.metres_per_px)[:, None] * trace.outward,
        side=trace.side,
        sigma_m=sigma_px * trace.metres_per_px,
    )


def beyond_px(arcs: RingArcs, trace: EdgeTrace, offset_px: Float64[Array, "n"]) -> Float64[Array, "n"]:
    """How far off the face, along the normal, from the edge of these arcs, lies what was found beside the places."""
    beyond_m, _ = off_face_m(arcs, sights_at(trace, offset_px, offset_px).ray, trace.side)
    return beyond_m / trace.metres_per_px
