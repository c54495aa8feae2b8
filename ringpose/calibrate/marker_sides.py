"""Corners of a marker from its sides.

A window around a corner (OpenCV's refinement) sees the corner rounded by blur and puts it 0.15 px inside; a side is
straight for hundreds of pixels. Each side is a parabola (a lens bends it), and a corner is where two of them meet.
"""

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.special import ndtr

from ringpose.calibrate.corner_likeness import likeness_of_ends
from ringpose.calibrate.edge_profile import LEAST_BLUR_PX, EdgeProfile, normal_profile, seen_profile
from ringpose.calibrate.side_curves import LARGEST_MARGIN, Side, meeting_point, robust_parabola, straight_side
from ringpose.calibrate.side_light import LARGEST_REACH_PX, REACH_PX, Light, marker_light, reach_px
from ringpose.calibrate.side_samples import FLANK_BLURS, SideSamples, side_samples
from ringpose.types.arrays import Array, Float64, UInt8

SHORTEST_SIDE_PX = 24.0
"""Below this a side has too few clean samples."""

CLEAR_BLURS = 4.0
"""So many standard deviations of its blur are left out at a side's ends, at most a tenth: nearer, the corner is
rounded."""

LARGEST_STEP_PX = 2.0
"""Further from where it was found a corner is not moved."""

_NORMAL_ROUNDS, _ROUNDS = 2, 5
"""Rounds of error functions, until sides are nearly where they stay, and all of them."""

_BLUR_ROUNDS = 3

_LARGEST_MISS = 0.2
"""Share of the rise beyond which something lies in front of the edge."""


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
    light = marker_light(image, corners)
    opposite = [_opposite_sides(image, corners, first, light) for first in (0, 1)]
    sides = [opposite[i % 2][i // 2] for i in range(4)]
    refined = corners.copy()
    for i in range(4):
        before, after = sides[i - 1], sides[i]
        if before is not None and after is not None:
            meeting = meeting_point(before, after, corners[i])
            if np.linalg.norm(meeting - corners[i]) < LARGEST_STEP_PX:
                refined[i] = meeting
    likeness = [likeness_of_ends(side.left_out) for side in sides if side is not None]
    return SideCorners(refined, float(np.mean(likeness)) if len(likeness) == 4 else 0.0)


def _opposite_sides(
    image: UInt8[Array, "row column"], corners: Float64[Array, "corner=4 xy=2"], first: int, light: Light
) -> list[Side | None]:
    """Two sides drawn through their edges, which are blurred alike; None for one of which too little is seen."""
    chords = [straight_side(corners[i], corners[(i + 1) % 4]) for i in (first, first + 2)]
    for farthest_px in (REACH_PX, LARGEST_REACH_PX):
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
    profile, left_out = normal_profile(reach), LARGEST_MARGIN
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
        left_out = min(CLEAR_BLURS * profile.blur_px / shortest, LARGEST_MARGIN)
    return sides, profile.blur_px


def _redrawn(side: Side, samples: SideSamples, profile: EdgeProfile, left_out: float) -> Side | None:
    """The side through its edge: each line of pixels tells how far outside it lies, weighed by steepness."""
    across = np.where(samples.used, samples.across, 0.0)
    steep = np.where(samples.used, profile.steepness(across), 0.0)
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
    blur = float(np.clip(np.sqrt(np.pi / 2) * beside / samples.used.any(axis=1).sum(), LEAST_BLUR_PX, reach))
    aside = 0.0
    for _ in range(_BLUR_ROUNDS):
        place = (across - aside) / blur
        steep = np.exp(-0.5 * place**2) / (np.sqrt(2 * np.pi) * blur)
        design = np.column_stack([-steep, -place * steep])
        missed = np.clip(share - ndtr(place), -_LARGEST_MISS, _LARGEST_MISS)
        step = np.linalg.lstsq(design.T @ design, design.T @ missed)[0]
        aside += float(step[0])
        blur = float(np.clip(blur + step[1], LEAST_BLUR_PX, reach))
    return blur
