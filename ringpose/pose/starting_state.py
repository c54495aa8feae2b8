"""Where the search for the most likely ring begins."""

import numpy as np

from ringpose.pose.measurements import Measurements, Sighted
from ringpose.pose.residual_rows import LIKELY_BAND_M, LIKELY_CURVATURE, Beforehand
from ringpose.pose.ring_model import RingState, Sights, cross, sights_of
from ringpose.types.arrays import Array, Float64

SHORTEST_M = 1e-9
"""A direction of less than this is none."""


def starting_state(measured: Measurements, sighted: Sighted, before: Beforehand) -> RingState | None:
    """The plane of the stripes, and a likely ring on it; None if there is none before the camera."""
    if not len(measured.points.x):
        return None
    try:
        plane = _plane(measured, sighted)
    except np.linalg.LinAlgError:
        return None
    state = RingState(plane, np.array([1.0, 0.0, 0.0]), 0.0, LIKELY_CURVATURE, 0.0)
    sights = sights_of(state, sighted)
    inverse_depth = sights.rays @ plane
    if not bool((inverse_depth > 0).all()):
        return None
    depth_m = 1.0 / inverse_depth
    ends = len(sighted.whitening)
    outward = _outward(state, measured, sighted, _along_stripes(sights, depth_m, plane)[ends:], depth_m[ends:])
    along = depth_m[ends:] * (sights.rays[ends:] @ outward)
    curvature, band_m = _likely_size(measured, along, before)
    return RingState(plane, outward, 0.0, curvature, band_m)


def _likely_size(measured: Measurements, along_m: Float64[Array, "point"], before: Beforehand) -> tuple[float, float]:
    """Curvature and width of the band."""
    by_edge: tuple[list[float], list[float]] = ([], [])
    for edge, along in zip(measured.points.edge.tolist(), along_m.tolist(), strict=True):
        by_edge[edge].append(along)
    inner, outer = by_edge
    band_m = sum(outer) / len(outer) - sum(inner) / len(inner) if inner and outer else LIKELY_BAND_M
    if before.radii is None or not np.isfinite(before.radii.radius_m).any():
        return LIKELY_CURVATURE, band_m
    inner_m, outer_m = before.radii.radius_m.tolist()
    whole = np.isfinite(outer_m - inner_m)
    return 1.0 / float(np.nanmean(before.radii.radius_m)), outer_m - inner_m if whole else band_m


def _plane(measured: Measurements, sighted: Sighted) -> Float64[Array, "3"]:
    """The q that fits the stripes: (m . r - d q . r) / (m - d q)_y is linear in q but for its weak denominator."""
    ends, count = len(sighted.whitening), len(sighted.rays)
    whitening = np.zeros((count, count))
    whitening[:ends, :ends] = sighted.whitening
    alone = ends + np.flatnonzero(measured.points.alone)
    whitening[alone, alone] = 1.0 / np.sqrt(measured.points.covariance[alone - ends, 1, 1])
    cosine = (sighted.light_normal * sighted.rays).sum(axis=1)
    plane = np.array([0.0, 0.0, float((cosine / sighted.light_distance_m).sum()) / count])
    for _ in range(2):
        steepness = sighted.light_normal[:, 1] - sighted.light_distance_m * plane[1]
        rows = whitening @ ((sighted.light_distance_m / steepness)[:, None] * sighted.rays)
        matrix = rows.T @ rows
        matrix[[0, 1], [0, 1]] += 1.0 / plane[2] ** 2  # one stripe alone: a face that looks at the camera
        plane = np.linalg.solve(matrix, rows.T @ (whitening @ (cosine / steepness)))
    return plane


def _along_stripes(
    sights: Sights, depth_m: Float64[Array, "sight"], plane: Float64[Array, "3"]
) -> Float64[Array, "sight 3"]:
    """How points of the plane move when they go along their stripes in the image."""
    rate = depth_m * (plane[0] + sights.slope * plane[1])
    moved = -rate[:, None] * sights.rays
    moved[:, 0] += 1.0
    moved[:, 1] += sights.slope
    along: Float64[Array, "sight 3"] = depth_m[:, None] * moved
    return along


def _outward(
    state: RingState,
    measured: Measurements,
    sighted: Sighted,
    by_x: Float64[Array, "point 3"],
    depth_m: Float64[Array, "point"],
) -> Float64[Array, "3"]:
    """From inner towards outer ends, seen from the middles of their stripes."""
    points = measured.points
    direction = (sighted.edge_sign * (points.x - points.middle_x)) @ by_x
    if float(direction @ direction) < SHORTEST_M**2:
        ends = sighted.rays[[-1, -len(points.x)]] * depth_m[[-1, 0], None]
        direction = cross(state.normal, ends[0] - ends[1])
    if float(direction @ direction) < SHORTEST_M**2:
        direction = by_x[0]
    direction = direction - (direction @ state.normal) * state.normal
    unit: Float64[Array, "3"] = direction / np.sqrt(direction @ direction)
    return unit
