"""Where the image should show the ring's edges, and how well that is known."""

from typing import NamedTuple

import cv2
import numpy as np

from ringpose.detect.ring_arc_fit import Sights
from ringpose.detect.ring_arcs import RingArcs, arc_points, off_face_m
from ringpose.geometry.rays import project, project_undistorted
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.rig import Rig

MARGIN_PX = 8.0
"""Closer to the image's border no edge is looked for."""

HALF_TURN = 2.0
"""Radians of the ring to both sides of the stripes that can be in view."""

CELL_PX, CELLS = 4.0, 2
"""Places up to so many cells of an image's grid from a stripe's centre are left out: 8 to 12 px."""

WIDER = 0.3
"""Share of the image's size by which distortion may shift what is near its border."""

OBLIQUE = 3.0
"""Most by which foreshortening and depth shrink an error across the edge in the image."""

DETOUR = 1.3
"""Length of an arc from the stripes to the farthest corner of the image, over the distance."""

NUDGE_M = 1e-4
"""Step off the face that tells metres a pixel."""


class EdgeTrace(NamedTuple):
    """Places on the predicted edges that lie in the image: along the inner edge, then along the outer."""

    point: Float64[Array, "n xyz=3"]
    outward: Float64[Array, "n xyz=3"]
    """Unit vector on the ring's plane that leads off the face."""
    side: Float64[Array, "n"]
    """1 on the inner edge, -1 on the outer."""
    place_px: Float64[Array, "n xy=2"]
    normal: Float64[Array, "n xy=2"]
    """Unit normal of the edge in the image, off the face."""
    metres_per_px: Float64[Array, "n"]
    """On the ring's plane, for a step along the normal."""
    number: Float64[Array, "n"]
    """Counts the places along an edge; those on the image's border are missing."""


def chosen(trace: EdgeTrace, which: Bool[Array, "n"]) -> EdgeTrace:
    """Some of the places."""
    return EdgeTrace(*(part[which] for part in trace))


def edge_trace(
    arcs: RingArcs, covariance: Float64[Array, "state=7 state=7"], rig: Rig, spacing_px: int | float, sigma_px: float
) -> EdgeTrace:
    """Places about `spacing_px` apart along both edges, where these are predicted to `sigma_px`."""
    camera = rig.camera
    size = np.array([camera.image_width, camera.image_height])
    metres_per_px = arcs.origin[2] / camera.camera_matrix[0, 0]
    middle = np.abs(project_undistorted(arcs.origin, camera) - size / 2)
    count = int(DETOUR * np.hypot(*(middle + size / 2)) / spacing_px)
    number = np.arange(-count, count + 1, dtype=np.float64)
    number = number[np.abs(arcs.curvature * number * spacing_px * metres_per_px) < HALF_TURN]
    side, number = np.repeat([1.0, -1.0], len(number)), np.tile(number, 2)
    point, outward = arc_points(arcs, number * spacing_px * metres_per_px, side)

    _, rows = off_face_m(arcs, point, side)
    sigma_m = np.sqrt(np.maximum(np.sum((rows @ covariance) * rows, axis=-1), 0.0))
    straight = project_undistorted(point, camera)
    near = np.all((straight > -WIDER * size) & (straight < (1 + WIDER) * size), axis=-1)
    near &= sigma_m < OBLIQUE * sigma_px * metres_per_px
    point, outward, side, number, sigma_m = point[near], outward[near], side[near], number[near], sigma_m[near]

    trace = imaged(point, outward, arcs.axes[2], side, number, rig)
    return chosen(trace, in_image(trace, rig) & (sigma_m < sigma_px * trace.metres_per_px))


def imaged(
    point: Float64[Array, "n xyz=3"],
    outward: Float64[Array, "n xyz=3"],
    normal: Float64[Array, "xyz=3"],
    side: Float64[Array, "n"],
    number: Float64[Array, "n"],
    rig: Rig,
) -> EdgeTrace:
    """Points of edges on the plane of this normal, and where the image has them, within its border or beyond."""
    along = np.cross(normal, outward)
    place, nudged, beside = project(np.stack([point, point + NUDGE_M * outward, point + NUDGE_M * along]), rig.camera)
    across = np.stack([-(beside - place)[:, 1], (beside - place)[:, 0]], axis=-1)
    across /= np.hypot(*across.T)[:, None]
    px_per_m = np.sum(across * (nudged - place), axis=-1) / NUDGE_M
    across *= np.sign(px_per_m)[:, None]
    return EdgeTrace(point, outward, side, place, across, 1 / np.abs(px_per_m), number)


def in_image(trace: EdgeTrace, rig: Rig) -> Bool[Array, "n"]:
    """Which places lie well inside the image's border."""
    last = np.array([rig.camera.image_width, rig.camera.image_height]) - 1
    inside: Bool[Array, "n"] = np.all((trace.place_px > MARGIN_PX) & (trace.place_px < last - MARGIN_PX), axis=-1)
    return inside


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


def clear_of(stripes_px: Float64[Array, "center xy=2"] | None, trace: EdgeTrace) -> EdgeTrace:
    """The places without those beside a stripe."""
    if stripes_px is None or not len(trace.side) or not len(stripes_px):
        return trace
    cells = np.floor(np.concatenate([trace.place_px, stripes_px]) / CELL_PX).astype(np.int64)
    cells -= cells.min(axis=0)
    column, row = cells.T
    lit = np.zeros((row.max() + 1, column.max() + 1), dtype=np.uint8)
    lit[row[len(trace.side) :], column[len(trace.side) :]] = 1
    lit = cv2.dilate(lit, np.ones((2 * CELLS + 1, 2 * CELLS + 1), dtype=np.uint8))
    return chosen(trace, lit[row[: len(trace.side)], column[: len(trace.side)]] == 0)
