"""Corners of a marker from its sides.

A window around a corner (OpenCV's refinement) sees the corner rounded by blur and puts it 0.15 px inside; a side is
straight for hundreds of pixels. Each side is a parabola (a lens bends it), and a corner is where two of them meet.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from scipy.special import ndtr

from ringpose.calibrate.corner_likeness import likeness_of_ends
from ringpose.types.arrays import Array, Float64, UInt8

REACH_PX = 4.0
"""How far across a side is looked for the edge, and at most half a cell of the marker's black border."""

CELLS = 6
"""Cells across the smallest dictionaries' markers, border included; a border cell is no larger than this share."""

SHORTEST_SIDE_PX = 24.0
"""Below this a side has too few clean samples."""

MINIMUM_SAMPLES = 8

LARGEST_MARGIN = 0.1
"""Share of a side at its ends that is left out at most ..."""

CLEAR_BLURS = 4.0
"""... and if its blur is known, so many of its standard deviations: nearer, the corner is rounded."""

LEAST_BLUR_PX = 0.4

_ROUNDS = 4

_STEPS = np.arange(-1.0, 1.0 + 1e-9, 0.125)
_OUTLIER = 4.0 * 1.4826
_FLANK = 0.8125
"""Middle of the outer quarter of the steps to either side."""

_UNEVEN = 0.1
"""Share of the contrast by which flanks may miss a plane."""


class SideCorners(NamedTuple):
    """A marker's corners from its sides."""

    points_px: Float64[Array, "corner=4 xy=2"]
    likeness: float
    """Correlation of a side's errors at its two ends; zero where not all the sides are seen."""


def corners_from_sides(image: UInt8[Array, "row column"], corners: Float64[Array, "corner=4 xy=2"]) -> SideCorners:
    """The corners where the marker's sides meet; a corner that the sides do not confirm stays as given."""
    lengths = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    if lengths.min() < SHORTEST_SIDE_PX:
        return SideCorners(corners, 0.0)
    light = _light(image, corners)
    sides = [_side(image, corners[i], corners[(i + 1) % 4], light) for i in range(4)]
    refined = corners.copy()
    for i in range(4):
        before, after = sides[i - 1], sides[i]
        if before is not None and after is not None:
            meeting = _meeting_point(before, after, corners[i])
            if np.linalg.norm(meeting - corners[i]) < REACH_PX / 2:
                refined[i] = meeting
    likeness = [likeness_of_ends(side.left_out) for side in sides if side is not None]
    return SideCorners(refined, float(np.mean(likeness)) if len(likeness) == 4 else 0.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Side:
    """A parabola: `start + t along + (c0 + c1 t + c2 t^2) normal`, t in pixels."""

    start: Float64[Array, "2"]
    along: Float64[Array, "2"]
    normal: Float64[Array, "2"]
    """Outwards: corners run clockwise."""
    length: float
    coefficients: Float64[Array, "3"]
    left_out: float = LARGEST_MARGIN
    """Share of the side that was left out at each of its ends."""

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


class _Light(NamedTuple):
    """How brightness changes over a marker, in grey levels per pixel."""

    dark: Float64[Array, "xy=2"]
    """Within its border."""
    bright: Float64[Array, "xy=2"]
    """On the paper around it."""


def _light(image: UInt8[Array, "row column"], corners: Float64[Array, "corner=4 xy=2"]) -> _Light:
    """By the flanks of the four sides: those of one side are too narrow to tell a slope.

    Where the light falls by a two-thousandth a pixel, a level taken 3 px from the edge draws the edge 0.002 px aside,
    the same way all over the image.
    """
    sides = [_straight(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    reach = _reach(min(side.length for side in sides))
    flanks = np.array([[_flank(image, side, end * _FLANK * reach) for end in (-1.0, 1.0)] for side in sides])
    middles = (corners + np.roll(corners, -1, axis=0)) / 2
    design = np.column_stack([np.ones(4), middles - middles.mean(axis=0)])
    planes = np.linalg.lstsq(design, flanks)[0]
    uneven = np.abs(design @ planes - flanks).max(axis=0) > _UNEVEN * np.ptp(planes[0])
    dark, bright = np.where(uneven, 0.0, planes[1:]).T
    return _Light(dark=dark, bright=bright)


def _flank(image: UInt8[Array, "row column"], side: _Side, across: float) -> float:
    """Grey beside a side, so far outside it: the median, as something may lie in front of the board."""
    t = np.linspace(LARGEST_MARGIN, 1.0 - LARGEST_MARGIN, int(side.length)) * side.length
    return float(np.median(_grey(image, side.points(t, np.full(len(t), across))[None])))


def _reach(length: float) -> float:
    return min(REACH_PX, 0.5 * length / CELLS)


def _grey(image: UInt8[Array, "row column"], places: Float64[Array, "k n xy=2"]) -> Float64[Array, "k n"]:
    grey = cv2.remap(
        image,
        np.ascontiguousarray(places[..., 0], dtype=np.float32),
        np.ascontiguousarray(places[..., 1], dtype=np.float32),
        cv2.INTER_LINEAR,
        borderMode=cv2.BORDER_REPLICATE,
    )
    return np.asarray(grey, dtype=np.float64)


def _side(
    image: UInt8[Array, "row column"], start: Float64[Array, "2"], end: Float64[Array, "2"], light: _Light
) -> _Side | None:
    """The side between two corners, drawn through its edge; None where too little of the edge is seen."""
    side = _straight(start, end)
    reach = _reach(side.length)
    left_out, blur_px = LARGEST_MARGIN, reach
    for _ in range(_ROUNDS):
        t = np.linspace(left_out, 1.0 - left_out, int((1.0 - 2.0 * left_out) * side.length)) * side.length
        offset, blur_px = _edge_offset(image, side, t, reach, blur_px, light)
        fitted = _robust_parabola(t, np.polynomial.polynomial.polyval(t, side.coefficients) + offset)
        if fitted is None:
            return None
        side = replace(side, coefficients=fitted, left_out=left_out)
        left_out = min(CLEAR_BLURS * blur_px / side.length, LARGEST_MARGIN)
    return side


def _edge_offset(
    image: UInt8[Array, "row column"],
    side: _Side,
    t: Float64[Array, "n"],
    reach: float,
    blur_px: float,
    light: _Light,
) -> tuple[Float64[Array, "n"], float]:
    """How far outside the side its edge lies, NaN where there is none; and how blurred it is.

    Dark within and bright outside, the edge is an error function; each place is weighed by how steep that is there.
    """
    across = reach * _STEPS
    places = side.points(t, np.broadcast_to(across[:, None], (len(across), len(t))))
    seen = _grey(image, places)
    ends = len(across) // 4
    dark, bright = _level(t, seen[:ends].mean(axis=0)), _level(t, seen[-ends:].mean(axis=0))
    rise = bright - dark
    there = (rise > 0) & (seen[-ends:].mean(axis=0) - seen[:ends].mean(axis=0) > 0.5 * rise)
    if not there.any():
        return np.full(len(t), np.nan), blur_px
    within, beyond = (float(slope @ side.normal) for slope in light)
    below = dark + within * (across - across[:ends].mean())[:, None]
    above = bright + beyond * (across - across[-ends:].mean())[:, None]
    share = (seen - below) / np.where(there, above - below, 1.0)
    steep = np.exp(-0.5 * (across / blur_px) ** 2)
    model = ndtr(across / blur_px)
    scale = blur_px * np.sqrt(2 * np.pi)
    offset: Float64[Array, "n"] = np.where(there, scale * steep @ (model[:, None] - share) / (steep @ steep), np.nan)
    mean = np.median(share[:, there], axis=1)
    beside = np.abs(mean - (across > 0) - 0.5 * (across == 0)).sum() * (across[1] - across[0])
    return offset, float(np.clip(np.sqrt(np.pi / 2) * beside, LEAST_BLUR_PX, reach))


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
