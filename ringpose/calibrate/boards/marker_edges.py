"""Corners of a marker from its sides.

A window around a corner (OpenCV's refinement) sees the corner rounded by blur and puts it 0.15 px inside; a side is
straight for hundreds of pixels. Each side is a parabola (a lens bends it), and a corner is where two of them meet.

The pixels beside a marker's side, as shares of the rise from dark to bright.

Rows are read where a side runs down the image, columns where it runs along: between pixels nothing is interpolated.

Dark and bright beside a marker's sides, which a share of the rise between them is told by.

A marker's side as a parabola in the image: a lens bends it.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from scipy.special import ndtr

from ringpose.calibrate.boards.corner_errors import endpoint_correlation
from ringpose.calibrate.boards.edge_profile import MIN_BLUR_PX, EdgeProfile, normal_profile, seen_profile
from ringpose.geometry.robust import robust_std
from ringpose.types.arrays import Array, Bool, Float64, UInt8

MIN_SIDE_PX = 24.0
"""Below this a side has too few clean samples."""

CLEAR_BLURS = 4.0
"""So many standard deviations of its blur are left out at a side's ends, at most a tenth: nearer, the corner is
rounded."""

MAX_STEP_PX = 2.0
"""Further from where it was found a corner is not moved."""

_NORMAL_ROUNDS, _ROUNDS = 2, 5
"""Rounds of error functions, until sides are nearly where they stay, and all of them."""

_BLUR_ROUNDS = 3

_MAX_MISS = 0.2
"""Share of the rise beyond which something lies in front of the edge."""


class SideCorners(NamedTuple):
    """A marker's corners from its sides."""

    points_px: Float64[Array, "corner=4 xy=2"]
    likeness: float
    """Correlation of a side's errors at its two ends; zero where not all the sides are seen."""


def corners_from_sides(image: UInt8[Array, "row column"], corners: Float64[Array, "corner=4 xy=2"]) -> SideCorners:
    """The corners where the marker's sides meet; a corner that the sides do not confirm stays as given."""
    lengths = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    if lengths.min() < MIN_SIDE_PX:
        return SideCorners(corners, 0.0)
    light = marker_light(image, corners)
    opposite = [_opposite_sides(image, corners, first, light) for first in (0, 1)]
    sides = [opposite[i % 2][i // 2] for i in range(4)]
    refined = corners.copy()
    for i in range(4):
        before, after = sides[i - 1], sides[i]
        if before is not None and after is not None:
            meeting = meeting_point(before, after, corners[i])
            if np.linalg.norm(meeting - corners[i]) < MAX_STEP_PX:
                refined[i] = meeting
    likeness = [endpoint_correlation(side.left_out) for side in sides if side is not None]
    return SideCorners(refined, float(np.mean(likeness)) if len(likeness) == 4 else 0.0)


class Light(NamedTuple):
    """How brightness changes over a marker, in grey levels per pixel."""

    dark: Float64[Array, "xy=2"]
    """Within its border."""
    bright: Float64[Array, "xy=2"]
    """On the paper around it."""


MAX_MARGIN = 0.1
"""Share of a side at its ends that is left out at most."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Side:
    """A parabola: `start + t along + (c0 + c1 t + c2 t^2) normal`, t in pixels."""

    start: Float64[Array, "2"]
    along: Float64[Array, "2"]
    normal: Float64[Array, "2"]
    """Outwards: corners run clockwise."""
    length: float
    coefficients: Float64[Array, "3"]
    left_out: float = MAX_MARGIN
    """Share of the side that was left out at each of its ends."""

    def points(self, t: Float64[Array, "n"], across: Float64[Array, "*k n"]) -> Float64[Array, "*k n 2"]:
        """Points at t, so far outside the parabola."""
        offset = self.offset(t) + across
        points: Float64[Array, "*k n 2"] = self.start + t[:, None] * self.along + offset[..., None] * self.normal
        return points

    def offset(self, t: Float64[Array, "n"]) -> Float64[Array, "n"]:
        """How far outside the chord the parabola is."""
        offset: Float64[Array, "n"] = np.polynomial.polynomial.polyval(t, self.coefficients)
        return offset

    def slope(self, t: Float64[Array, "n"]) -> Float64[Array, "n"]:
        """Of the parabola to its chord."""
        slope: Float64[Array, "n"] = self.coefficients[1] + 2 * self.coefficients[2] * t
        return slope

    def tangent(self, t: float) -> tuple[Float64[Array, "2"], Float64[Array, "2"]]:
        """Point and direction at t."""
        place = np.array([t])
        return self.points(place, np.zeros(1))[0], self.along + self.slope(place)[0] * self.normal


def _opposite_sides(
    image: UInt8[Array, "row column"], corners: Float64[Array, "corner=4 xy=2"], first: int, light: Light
) -> list[Side | None]:
    """Two sides drawn through their edges, which are blurred alike; None for one of which too little is seen."""
    chords = [straight_side(corners[i], corners[(i + 1) % 4]) for i in (first, first + 2)]
    for farthest_px in (REACH_PX, MAX_REACH_PX):
        reach = min(reach_px(side.length, farthest_px) for side in chords)
        sides, blur_px = _sides_within(image, chords, light, reach)
        if FLANK_BLURS * blur_px < reach:
            break
    return sides


def _sides_within(
    image: UInt8[Array, "row column"], chords: list[Side], light: Light, reach: float
) -> tuple[list[Side | None], float]:
    """The sides by what lies so near, and the blur of their edges."""
    sides: list[Side | None] = list(chords)
    profile, left_out = normal_profile(reach), MAX_MARGIN
    for turn in range(_ROUNDS):
        seen = [
            None if side is None else side_samples(image, side, (left_out, reach), light, profile.blur_px)
            for side in sides
        ]
        sides = [
            None if side is None or samples is None else _redrawn(side, samples, profile, left_out)
            for side, samples in zip(sides, seen, strict=True)
        ]
        left = [samples for side, samples in zip(sides, seen, strict=True) if side is not None and samples is not None]
        if not left:
            break
        profile = _profile(left, reach, normal=turn < _NORMAL_ROUNDS)
        shortest = min(side.length for side in sides if side is not None)
        left_out = min(CLEAR_BLURS * profile.blur_px / shortest, MAX_MARGIN)
    return sides, profile.blur_px


class SideSamples(NamedTuple):
    """One row for each line of pixels across the side."""

    t: Float64[Array, "line"]
    """Where it crosses the side."""
    across: Float64[Array, "line pixel"]
    """How far outside the side."""
    share: Float64[Array, "line pixel"]
    """Of the rise."""
    used: Bool[Array, "line pixel"]
    """Within reach, where there is an edge."""
    spacing: float
    """Distance of a line's pixels across the side."""


def _redrawn(side: Side, samples: SideSamples, profile: EdgeProfile, left_out: float) -> Side | None:
    """The side through its edge: each line of pixels tells how far outside it lies, weighted by gradient."""
    across = np.where(samples.used, samples.across, 0.0)
    steep = np.where(samples.used, profile.denominator(across), 0.0)
    missed = np.where(samples.used, profile.share(across) - samples.share, 0.0)
    told = np.sum(steep**2, axis=1)
    offset = np.where(told > 0, np.sum(steep * missed, axis=1) / np.where(told > 0, told, 1.0), np.nan)
    coefficients = robust_parabola(samples.t, side.offset(samples.t) + offset)
    return None if coefficients is None else replace(side, coefficients=coefficients, left_out=left_out)


def _profile(seen: list[SideSamples], reach: float, normal: bool) -> EdgeProfile:
    """What the sides' pixels show of the rise."""
    blur_px = float(np.median([_blur_px(samples, reach) for samples in seen]))
    if normal:
        return normal_profile(blur_px)
    across = np.concatenate([samples.across[samples.used] for samples in seen])
    share = np.concatenate([samples.share[samples.used] for samples in seen])
    return seen_profile(across, share, blur_px, reach)


def _blur_px(samples: SideSamples, reach: float) -> float:
    """Standard deviation of the error function nearest to the rise, by least squares.

    It starts from the area between the rise and a sudden one, (2 / pi)^1/2 of it; where sides run along rows, that is
    the area of a few places within a pixel.
    """
    across, share = samples.across[samples.used], samples.share[samples.used]
    beside = np.abs(share - np.heaviside(across, 0.5)).sum() * samples.spacing
    blur = float(np.clip(np.sqrt(np.pi / 2) * beside / samples.used.any(axis=1).sum(), MIN_BLUR_PX, reach))
    aside = 0.0
    for _ in range(_BLUR_ROUNDS):
        place = (across - aside) / blur
        steep = np.exp(-0.5 * place**2) / (np.sqrt(2 * np.pi) * blur)
        design = np.column_stack([-steep, -place * steep])
        missed = np.clip(share - ndtr(place), -_MAX_MISS, _MAX_MISS)
        step = np.linalg.lstsq(design.T @ design, design.T @ missed)[0]
        aside += float(step[0])
        blur = float(np.clip(blur + step[1], MIN_BLUR_PX, reach))
    return blur


FLANK_BLURS, MIN_FLANK, MAX_FLANK = 3.0, 0.3, 0.6
"""Pixels beyond so many standard deviations of the blur tell dark and bright; between these shares of the reach."""

MIN_RISE = 0.5
"""Share of the rise that a line of pixels shows at least where there is an edge."""


def side_samples(
    image: UInt8[Array, "row column"], side: Side, extent: tuple[float, float], light: Light, blur_px: float
) -> SideSamples | None:
    """Of a side less a share at its ends, and so far across it; None where too little of its edge is seen."""
    left_out, reach = extent
    clear_px = float(np.clip(FLANK_BLURS * blur_px, MIN_FLANK * reach, MAX_FLANK * reach))
    t, across, grey = _pixels(image, side, left_out, reach)
    inside, outside = ((sign * across >= clear_px) & (np.abs(across) <= reach) for sign in (-1.0, 1.0))
    seen = inside.any(axis=1) & outside.any(axis=1)
    if seen.sum() < MINIMUM_SAMPLES:
        return None
    t, across, grey, inside, outside = (each[seen] for each in (t, across, grey, inside, outside))
    in_image = np.where(np.isfinite(across), across, 0.0)
    falls = [float(slope @ side.normal) * in_image for slope in light]
    levels = [_mean(grey - fall, flank) for fall, flank in zip(falls, (inside, outside), strict=True)]
    dark, bright = (smooth_level(t, level)[:, None] + fall for level, fall in zip(levels, falls, strict=True))
    rise = np.median(bright - dark, axis=1)
    there = (rise > 0) & (levels[1] - levels[0] > MIN_RISE * rise)
    if there.sum() < MINIMUM_SAMPLES:
        return None
    share = (grey - dark) / np.where(there[:, None], bright - dark, 1.0)
    used = there[:, None] & (np.abs(across) <= reach)
    return SideSamples(t, across, share, used, _spacing(side))


def _pixels(
    image: UInt8[Array, "row column"], side: Side, left_out: float, reach: float
) -> tuple[Float64[Array, "line"], Float64[Array, "line pixel"], Float64[Array, "line pixel"]]:
    """Where each line of pixels crosses the side, how far outside the side its pixels are, and their grey."""
    lies = abs(side.along[0]) >= abs(side.along[1])
    lined, crossed = (0, 1) if lies else (1, 0)
    ends = np.sort(side.start[lined] + np.array([left_out, 1.0 - left_out]) * side.length * side.along[lined])
    lines = np.arange(np.ceil(ends[0]), np.floor(ends[1]) + 1)
    t = (lines - side.start[lined]) / side.along[lined]
    t = t - side.offset(t) * side.normal[lined] / side.along[lined]
    middle = side.points(t, np.zeros(len(t)))[:, crossed]
    most = int(np.ceil(reach / _spacing(side)))
    pixels = np.rint(middle)[:, None] + np.arange(-most, most + 1)
    upright = side.normal[crossed] - side.slope(t) * side.along[crossed]
    across = (pixels - middle[:, None]) * upright[:, None]
    picture = image if lies else image.T
    size = picture.shape
    within = (pixels >= 0) & (pixels < size[0]) & ((lines >= 0) & (lines < size[1]))[:, None]
    row = np.clip(pixels, 0, size[0] - 1).astype(np.int64)
    column = np.clip(lines, 0, size[1] - 1).astype(np.int64)
    return t, np.where(within, across, np.inf), picture[row, column[:, None]].astype(np.float64)


def _spacing(side: Side) -> float:
    return float(np.abs(side.normal).max())


def _mean(grey: Float64[Array, "line pixel"], flank: Bool[Array, "line pixel"]) -> Float64[Array, "line"]:
    mean: Float64[Array, "line"] = np.sum(grey, axis=1, where=flank) / flank.sum(axis=1)
    return mean


REACH_PX = 5.0
"""How far across a side is looked for the edge, and at most half a cell of the marker's black border ..."""

MAX_REACH_PX = 8.0
"""... and how far where the edge is so blurred that less tells neither dark nor bright."""

CELLS = 6
"""Cells across the smallest dictionaries' markers, border included; a border cell is no larger than this share."""

_FLANK = 0.65
"""Of the reach: middle of what is taken for dark, and for bright."""

_UNEVEN = 0.1
"""Share of the contrast by which flanks may miss a plane."""

_LIGHT_OUTLIER_SIGMAS = 4.0


def marker_light(image: UInt8[Array, "row column"], corners: Float64[Array, "corner=4 xy=2"]) -> Light:
    """By the flanks of the four sides: those of one side are too narrow to tell a slope.

    Where the light falls by a two-thousandth a pixel, a level taken 3 px from the edge draws the edge 0.002 px aside,
    the same way all over the image.
    """
    sides = [straight_side(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    reach = reach_px(min(side.length for side in sides))
    flanks = np.array([[_flank(image, side, end * _FLANK * reach) for end in (-1.0, 1.0)] for side in sides])
    middles = (corners + np.roll(corners, -1, axis=0)) / 2
    design = np.column_stack([np.ones(4), middles - middles.mean(axis=0)])
    planes = np.linalg.lstsq(design, flanks)[0]
    uneven = np.abs(design @ planes - flanks).max(axis=0) > _UNEVEN * np.ptp(planes[0])
    dark, bright = np.where(uneven, 0.0, planes[1:]).T
    return Light(dark=dark, bright=bright)


def reach_px(length: float, farthest_px: float = REACH_PX) -> float:
    """How far across a side of this length is looked."""
    return min(farthest_px, 0.5 * length / CELLS)


def smooth_level(t: Float64[Array, "n"], grey: Float64[Array, "n"]) -> Float64[Array, "n"]:
    """Grey along one flank of the edge: light falls off smoothly, and what lies in front of the board is cut out."""
    used = np.ones(len(t), dtype=bool)
    run = t / np.abs(t).max()
    for _ in range(3):
        line = np.polynomial.polynomial.polyfit(run[used], grey[used], 2)
        residual = np.abs(grey - np.polynomial.polynomial.polyval(run, line))
        used = residual <= max(_LIGHT_OUTLIER_SIGMAS * robust_std(residual), 1e-6)
    level: Float64[Array, "n"] = np.polynomial.polynomial.polyval(run, line)
    return level


def _flank(image: UInt8[Array, "row column"], side: Side, across: float) -> float:
    """Grey beside a side, so far outside it: the median, as something may lie in front of the board."""
    t = np.linspace(MAX_MARGIN, 1.0 - MAX_MARGIN, int(side.length)) * side.length
    places = side.points(t, np.full(len(t), across)).astype(np.float32)
    grey = cv2.remap(image, places[None, :, 0], places[None, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return float(np.median(np.asarray(grey, dtype=np.float64)))


MINIMUM_SAMPLES = 8

_OUTLIER_SIGMAS = 4.0


def straight_side(start: Float64[Array, "2"], end: Float64[Array, "2"]) -> Side:
    """The chord between two corners."""
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    normal = np.array([along[1], -along[0]])
    return Side(start=start, along=along, normal=normal, length=length, coefficients=np.zeros(3))


def robust_parabola(t: Float64[Array, "n"], offset: Float64[Array, "n"]) -> Float64[Array, "3"] | None:
    """Coefficients, strays and NaN left out; None where too few are left."""
    used = np.isfinite(offset)
    coefficients = None
    for _ in range(3):
        if used.sum() < MINIMUM_SAMPLES:
            return None
        coefficients = np.polynomial.polynomial.polyfit(t[used], offset[used], 2)
        residual = offset - np.polynomial.polynomial.polyval(t, coefficients)
        limit = max(_OUTLIER_SIGMAS * robust_std(residual[used]), 1e-6)
        used = np.isfinite(offset) & (np.abs(np.nan_to_num(residual, nan=np.inf)) < limit)
    return coefficients


def meeting_point(before: Side, after: Side, corner: Float64[Array, "2"]) -> Float64[Array, "2"]:
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
