"""Corners of a marker from its sides.

A window around a corner (OpenCV's refinement) sees the corner rounded by blur and puts it 0.15 px inside; a side is
straight for hundreds of pixels. Each side is a parabola (a lens bends it), and a corner is where two of them meet.
"""

from dataclasses import dataclass, replace

import cv2
import numpy as np

from ringpose.types.arrays import Array, Float64, UInt8

REACH_PX = 4.0
"""How far across a side is looked for the edge, and at most half a cell of the marker's black border."""

CELLS = 6
"""Cells across the smallest dictionaries' markers, border included; a border cell is no larger than this share."""

SHORTEST_SIDE_PX = 24.0
"""Below this a side has too few clean samples."""

MINIMUM_SAMPLES = 8

_STEPS = np.arange(-1.0, 1.0 + 1e-9, 0.125)
_OUTLIER = 4.0 * 1.4826


def corners_from_sides(
    image: UInt8[Array, "row column"], corners: Float64[Array, "corner=4 xy=2"]
) -> Float64[Array, "corner=4 xy=2"]:
    """The corners where the marker's sides meet; a corner that the sides do not confirm stays as given."""
    lengths = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    if lengths.min() < SHORTEST_SIDE_PX:
        return corners
    sides = [_side(image, corners[i], corners[(i + 1) % 4]) for i in range(4)]
    refined = corners.copy()
    for i in range(4):
        before, after = sides[i - 1], sides[i]
        if before is not None and after is not None:
            meeting = _meeting_point(before, after, corners[i])
            if np.linalg.norm(meeting - corners[i]) < REACH_PX / 2:
                refined[i] = meeting
    return refined


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Side:
    """A parabola: `start + t along + (c0 + c1 t + c2 t^2) normal`, t in pixels."""

    start: Float64[Array, "2"]
    along: Float64[Array, "2"]
    normal: Float64[Array, "2"]
    """Outwards: corners run clockwise."""
    length: float
    coefficients: Float64[Array, "3"]

    def points(self, t: Float64[Array, "n"], across: Float64[Array, "*k n"]) -> Float64[Array, "*k n 2"]:
        """Points at t, so far outside the parabola."""
        offset = np.polynomial.polynomial.polyval(t, self.coefficients) + across
        points: Float64[Array, "*k n 2"] = self.start + t[:, None] * self.along + offset[..., None] * self.normal
        return points

    def tangent(self, t: float) -> tuple[Float64[Array, "2"], Float64[Array, "2"]]:
        """Point and direction at t."""
        slope = self.coefficients[1] + 2 * self.coefficients[2] * t
        return self.points(np.array([t]), np.zeros(1))[0], self.along + slope * self.normal


def _straight(start: Float64[Array, "2"], end: Float64[Array, "2"]) -> _Side:
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    normal = np.array([along[1], -along[0]])
    return _Side(start=start, along=along, normal=normal, length=length, coefficients=np.zeros(3))


def _side(image: UInt8[Array, "row column"], start: Float64[Array, "2"], end: Float64[Array, "2"]) -> _Side | None:
    """The side between two corners, drawn through its edge; None where too little of the edge is seen."""
    side = _straight(start, end)
    t = np.linspace(0.1, 0.9, int(0.8 * side.length)) * side.length
    reach = min(REACH_PX, 0.5 * side.length / CELLS)
    for _ in range(3):
        offset = _edge_offset(image, side, t, reach)
        fitted = _robust_parabola(t, np.polynomial.polynomial.polyval(t, side.coefficients) + offset)
        if fitted is None:
            return None
        side = replace(side, coefficients=fitted)
    return side


def _edge_offset(
    image: UInt8[Array, "row column"], side: _Side, t: Float64[Array, "n"], reach: float
) -> Float64[Array, "n"]:
    """How far outside the side its edge lies; NaN where there is none.

    Dark within and bright outside, the edge lies where their areas make up the sum of what is seen. Unlike the centroid
    of the rise, of which noise would leave positive parts, more of them in the bright, this has no bias (0.03 px).
    """
    across = reach * _STEPS
    places = side.points(t, np.broadcast_to(across[:, None], (len(across), len(t))))
    grey = cv2.remap(
        image,
        np.ascontiguousarray(places[..., 0], dtype=np.float32),
        np.ascontiguousarray(places[..., 1], dtype=np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    seen = np.asarray(grey, dtype=np.float64)
    ends = len(across) // 4
    dark, bright = _level(t, seen[:ends].mean(axis=0)), _level(t, seen[-ends:].mean(axis=0))
    rise = bright - dark
    mean = (seen[1:] + seen[:-1]).mean(axis=0) / 2
    there = (rise > 0) & (seen[-ends:].mean(axis=0) - seen[:ends].mean(axis=0) > 0.5 * rise)
    offset: Float64[Array, "n"] = np.where(
        there, reach * ((bright + dark) - 2 * mean) / np.where(there, rise, 1.0), np.nan
    )
    return offset


def _level(t: Float64[Array, "n"], grey: Float64[Array, "n"]) -> Float64[Array, "n"]:
    """Grey along one flank of the edge: light falls off smoothly, and what lies in front of the board is cut out."""
    used = np.ones(len(t), dtype=bool)
    run = t / t[-1]
    for _ in range(3):
        line = np.polynomial.polynomial.polyfit(run[used], grey[used], 2)
        residual = np.abs(grey - np.polynomial.polynomial.polyval(run, line))
        used = residual <= max(_OUTLIER * float(np.median(residual)), 1e-6)
    level: Float64[Array, "n"] = np.polynomial.polynomial.polyval(run, line)
    return level


def _robust_parabola(t: Float64[Array, "n"], offset: Float64[Array, "n"]) -> Float64[Array, "3"] | None:
    used = np.isfinite(offset)
    coefficients = None
    for _ in range(3):
        if used.sum() < MINIMUM_SAMPLES:
            return None
        coefficients = np.polynomial.polynomial.polyfit(t[used], offset[used], 2)
        residual = offset - np.polynomial.polynomial.polyval(t, coefficients)
        limit = max(_OUTLIER * float(np.median(np.abs(residual[used]))), 1e-6)
        used = np.isfinite(offset) & (np.abs(np.nan_to_num(residual, nan=np.inf)) < limit)
    return coefficients


def _meeting_point(before: _Side, after: _Side, corner: Float64[Array, "2"]) -> Float64[Array, "2"]:
    """Where the side that ends in a corner meets the side that starts there: tangents, re-drawn at the meeting."""
    t_before, t_after = before.length, 0.0
    meeting = corner
    for _ in range(3):
        first, along = before.tangent(t_before)
        second, away = after.tangent(t_after)
        system = np.stack([along, -away], axis=1)
        if abs(np.linalg.det(system)) < 1e-6:
            return corner
        step = np.linalg.solve(system, second - first)
        meeting = first + step[0] * along
        t_before, t_after = t_before + step[0], t_after + step[1]
    return meeting
