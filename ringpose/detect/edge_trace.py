"""Where the image should show the ring's edges, and how well that is known."""

import math
from dataclasses import dataclass

from ringpose.detect.tracks import lens
from ringpose.geometry.ring_arcs import RingArcs, off_face_m
from ringpose.kernels import edges as kernels
from ringpose.kernels.edges import PlaceRules, Sights
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.rig import Rig

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
    rules = PlaceRules(
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
