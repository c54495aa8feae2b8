"""Single steps of brightness -> independent points of the ring's edges, with sigmas that explain their scatter."""

from typing import NamedTuple

import numpy as np

from ringpose.detect.edge_trace import EdgeTrace, beyond_px
from ringpose.geometry.ring_arcs import RingArcs
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.detection import RingEdgePoints

BLUR_SIGMA_PX = 0.03
"""By how much a step's place depends on the assumed shape of its blur."""

GROUP = 3
"""Neighbouring steps that make one point: 12 px, which a facet of crinkled foil hardly exceeds."""

STRETCH = 15
"""Neighbouring steps, or points, whose scatter tells the size of their errors."""

SHARED = 6
"""So many of them, as large as the edge's are on average, are added: a few that agree by chance say little."""

OUTLIER_SIGMAS = 3.5
"""What lies off the ring by more is none of it, and counts in the scatter as if it were so far off."""

DISPLACED_PX = 0.4
"""A stretch this far off as a whole is the rim of a wall, a chamfer, a shadow."""

FARTHEST_PX = 1.5
"""Nor is a step this far off, whatever its neighbours scatter."""

POINT_SIGMA_PX = 0.5
"""A point that is known worse is of no use."""

MINIMUM_POINTS = 12
"""Fewer points cannot tell an edge from a chance."""


class _Points(NamedTuple):
    number: Float64[Array, "n"]
    side: Float64[Array, "n"]
    position_px: Float64[Array, "n xy=2"]
    normal: Float64[Array, "n xy=2"]
    off_px: Float64[Array, "n"]
    """From the edge of the ring that explains all of them."""
    sigma_px: Float64[Array, "n"]


def ring_edge_points(
    arcs: RingArcs, trace: EdgeTrace, offset_px: Float64[Array, "n"], sigma_px: Float64[Array, "n"]
) -> RingEdgePoints | None:
    """Points of the ring near `arcs` from the steps found beside the places of a trace; None for too few.

    A step's own sigma tells how it compares with its neighbours; what they all are worth (facets of foil, walls
    and shadows beside the edge) shows in their scatter about the ring.
    """
    position = trace.place_px + offset_px[:, None] * trace.normal
    off_px = beyond_px(arcs, trace, offset_px)
    steps = _Points(trace.number, trace.side, position, trace.normal, off_px, np.hypot(sigma_px, BLUR_SIGMA_PX))
    steps = _chosen(steps, ~_displaced(steps))
    steps = _without_outliers(steps._replace(sigma_px=steps.sigma_px * _scale(steps)))
    points = _grouped(steps)
    points = points._replace(sigma_px=np.hypot(points.sigma_px, BLUR_SIGMA_PX))
    points = _without_outliers(points._replace(sigma_px=points.sigma_px * np.maximum(_scale(points), 1.0)))
    known = points.sigma_px < POINT_SIGMA_PX
    if np.count_nonzero(known) < MINIMUM_POINTS:
        return None
    return RingEdgePoints(
        position_px=points.position_px[known],
        normal=points.normal[known],
        sigma_px=points.sigma_px[known],
        edge=(points.side[known] < 0).astype(np.int64),
    )


def _without_outliers(points: _Points) -> _Points:
    kept = np.abs(points.off_px) < np.minimum(OUTLIER_SIGMAS * points.sigma_px, FARTHEST_PX)
    return _chosen(points, kept)


def _chosen(points: _Points, which: Bool[Array, "n"]) -> _Points:
    return _Points(*(part[which] for part in points))


def _grouped(steps: _Points) -> _Points:
    """Weighted means of neighbouring steps, along the inner edge first."""
    key = np.floor(steps.number / GROUP)
    begins = np.append(True, (np.diff(key) != 0) | (np.diff(steps.side) != 0))[: len(key)]
    group = np.cumsum(begins) - 1
    weight = steps.sigma_px**-2
    total = np.bincount(group, weight)

    def mean(values: Float64[Array, "n"]) -> Float64[Array, "m"]:
        return np.bincount(group, weight * values) / total

    number, side, off_px = mean(steps.number), mean(steps.side), mean(steps.off_px)
    position = np.stack([mean(steps.position_px[:, axis]) for axis in (0, 1)], axis=-1)
    normal = np.stack([mean(steps.normal[:, axis]) for axis in (0, 1)], axis=-1)
    normal /= np.hypot(*normal.T)[:, None]
    return _Points(number, side, position, normal, off_px, total**-0.5)


def _scale(points: _Points) -> Float64[Array, "n"]:
    """Root mean square of the deviations in sigmas, over a stretch of the same edge."""
    scale = np.ones(len(points.side))
    deviation = np.abs(points.off_px / points.sigma_px)
    for here in _edges(points):
        near = _stretches(deviation[here])
        middle = np.sort(near, axis=-1)[:, near.shape[1] // 2, None]
        near = np.minimum(near, OUTLIER_SIGMAS * 1.4826 * middle)
        squares = np.einsum("ij,ij->i", near, near)
        scale[here] = np.sqrt((squares + SHARED * squares.mean() / near.shape[1]) / (near.shape[1] + SHARED))
    return np.maximum(scale, 1e-3)


def _displaced(points: _Points) -> Bool[Array, "n"]:
    """Whether a stretch is off the ring as a whole, much the same everywhere: another edge beside it."""
    displaced = np.zeros(len(points.side), dtype=bool)
    for here in _edges(points):
        near = _stretches(points.off_px[here])
        middle = near.mean(axis=-1)
        variance = np.einsum("ij,ij->i", near, near) / near.shape[1] - middle**2
        displaced[here] = (np.abs(middle) > DISPLACED_PX) & (middle**2 > variance)
    return displaced


def _edges(points: _Points) -> list[Int64[Array, "m"]]:
    """Indices of the points on the inner and on the outer edge, if there are enough for a stretch."""
    edges = [np.flatnonzero(points.side == side) for side in (1.0, -1.0)]
    return [here for here in edges if len(here) >= 2]


def _stretches(values: Float64[Array, "n"]) -> Float64[Array, "n near"]:
    """The values of each one's neighbours, mirrored at the ends."""
    half = min(STRETCH, len(values)) // 2
    mirrored = np.concatenate([values[half - 1 :: -1], values, values[: -half - 1 : -1]])
    near: Float64[Array, "n near"] = mirrored[np.arange(len(values))[:, None] + np.arange(2 * half + 1)]
    return near
