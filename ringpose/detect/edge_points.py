"""Intensity steps -> independent points of the ring's edges, with standard deviations that explain their scatter.

The sigma of a single step only ranks it among its neighbours. The actual errors (facets of foil, walls and shadows
beside the edge) are estimated from the scatter of neighbouring steps about the fitted ring.
"""

from typing import NamedTuple

import numpy as np

from ringpose.detect.edge_search import EdgeTrace, rays_beside
from ringpose.geometry.least_squares import STD_PER_MAD
from ringpose.geometry.ring import EDGE_SIGN, RingArcs, edge_distances
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.detection import RingEdgePoints

BLUR_SIGMA_PX = 0.03
"""Standard deviation of a step's position due to the assumed shape of its blur."""

GROUP = 3
"""Neighbouring steps that are averaged into one point: 12 px, about the largest facet of crinkled foil."""

STRETCH = 15
"""Number of neighbouring steps, or points, from whose scatter their errors are estimated."""

SHARED = 6
"""Weight, in steps, of the whole edge's scatter in that estimate: a few steps may agree by chance."""

OUTLIER_SIGMAS = 3.5
"""A point farther from the ring is rejected; in the scatter its distance is clipped to this."""

DISPLACED_PX = 0.4
"""A stretch whose mean is this far off the ring is another edge: the rim of a wall, a chamfer, a shadow."""

MAX_DISTANCE_PX = 1.5
"""Maximum distance of a step from the ring, whatever the scatter of its neighbours."""

POINT_SIGMA_PX = 0.5
"""Maximum standard deviation of a point."""

MINIMUM_POINTS = 12
"""Minimum number of points: fewer may be an accidental alignment."""


class _Points(NamedTuple):
    number: Float64[Array, "n"]
    edge_sign: Float64[Array, "n"]
    """-1 on the inner edge, +1 on the outer."""
    position_px: Float64[Array, "n xy=2"]
    normal: Float64[Array, "n xy=2"]
    residual_px: Float64[Array, "n"]
    """Distance off the face, along the normal, from the edge of the fitted ring."""
    sigma_px: Float64[Array, "n"]

    def selected(self, which: Bool[Array, "n"]) -> "_Points":
        return _Points(*(part[which] for part in self))


def ring_edge_points(
    arcs: RingArcs, trace: EdgeTrace, offset_px: Float64[Array, "n"], sigma_px: Float64[Array, "n"]
) -> RingEdgePoints | None:
    """Points of the ring near `arcs`, from steps at these offsets from the places of a trace; None for too few."""
    position = trace.position_px + offset_px[:, None] * trace.normal
    distances = edge_distances(arcs, rays_beside(trace, offset_px), trace.edge_sign)
    residual_px = trace.edge_sign * distances.distance_m / trace.metres_per_px
    steps = _Points(
        trace.number, trace.edge_sign, position, trace.normal, residual_px, np.hypot(sigma_px, BLUR_SIGMA_PX)
    )
    steps = steps.selected(~_displaced(steps))
    steps = _inliers(steps._replace(sigma_px=steps.sigma_px * _scale(steps)))
    points = _grouped(steps)
    # The blur error is common to the steps of a group, so that averaging does not reduce it.
    points = points._replace(sigma_px=np.hypot(points.sigma_px, BLUR_SIGMA_PX))
    points = _inliers(points._replace(sigma_px=points.sigma_px * np.maximum(_scale(points), 1.0)))
    known = points.sigma_px < POINT_SIGMA_PX
    if np.count_nonzero(known) < MINIMUM_POINTS:
        return None
    return RingEdgePoints(
        position_px=points.position_px[known],
        normal=points.normal[known],
        sigma_px=points.sigma_px[known],
        edge=(points.edge_sign[known] > 0).astype(np.int64),
    )


def _displaced(points: _Points) -> Bool[Array, "n"]:
    """Which points lie in a stretch that is off the ring as a whole, by more than its own scatter."""
    displaced = np.zeros(len(points.edge_sign), dtype=bool)
    for here in _edges(points):
        near = _stretches(points.residual_px[here])
        middle = near.mean(axis=-1)
        variance = np.einsum("ij,ij->i", near, near) / near.shape[1] - middle**2
        displaced[here] = (np.abs(middle) > DISPLACED_PX) & (middle**2 > variance)
    return displaced


def _inliers(points: _Points) -> _Points:
    return points.selected(np.abs(points.residual_px) < np.minimum(OUTLIER_SIGMAS * points.sigma_px, MAX_DISTANCE_PX))


def _scale(points: _Points) -> Float64[Array, "n"]:
    """Root mean square of the whitened residuals over a stretch of the same edge, outliers clipped."""
    scale = np.ones(len(points.edge_sign))
    deviation = np.abs(points.residual_px / points.sigma_px)
    for here in _edges(points):
        near = _stretches(deviation[here])
        median = np.sort(near, axis=-1)[:, near.shape[1] // 2, None]
        near = np.minimum(near, OUTLIER_SIGMAS * STD_PER_MAD * median)
        squares = np.einsum("ij,ij->i", near, near)
        scale[here] = np.sqrt((squares + SHARED * squares.mean() / near.shape[1]) / (near.shape[1] + SHARED))
    return np.maximum(scale, 1e-3)


def _grouped(steps: _Points) -> _Points:
    """Weighted means of neighbouring steps, along the inner edge first."""
    key = np.floor(steps.number / GROUP)
    begins = np.append(True, (np.diff(key) != 0) | (np.diff(steps.edge_sign) != 0))[: len(key)]
    group = np.cumsum(begins) - 1
    weight = steps.sigma_px**-2
    total = np.bincount(group, weight)
    columns = (steps.number, steps.edge_sign, steps.residual_px, *steps.position_px.T, *steps.normal.T)
    means = [np.bincount(group, weight * values) / total for values in columns]
    number, edge_sign, residual_px = means[:3]
    position, normal = np.stack(means[3:5], axis=-1), np.stack(means[5:], axis=-1)
    normal /= np.hypot(*normal.T)[:, None]
    return _Points(number, edge_sign, position, normal, residual_px, total**-0.5)


def _edges(points: _Points) -> list[Int64[Array, "m"]]:
    """Indices of the points on the inner and on the outer edge, of each edge that has at least two."""
    edges = [np.flatnonzero(points.edge_sign == sign) for sign in EDGE_SIGN]
    return [here for here in edges if len(here) >= 2]


def _stretches(values: Float64[Array, "n"]) -> Float64[Array, "n near"]:
    """The values of the neighbours of each point, mirrored at the ends."""
    half = min(STRETCH, len(values)) // 2
    mirrored = np.concatenate([values[half - 1 :: -1], values, values[: -half - 1 : -1]])
    near: Float64[Array, "n near"] = mirrored[np.arange(len(values))[:, None] + np.arange(2 * half + 1)]
    return near
