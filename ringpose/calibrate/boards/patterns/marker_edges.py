"""Sub-pixel corners of a marker from its sides (ringpose-method(7), section 6).

OpenCV's refinement uses a window around the corner, where blur rounds the corner: the result is 0.15 px too far inside.
A side is straight for hundreds of pixels. Each side is modelled as a parabola, because distortion bends it, and a
corner is the intersection of two sides.

Sides are fitted iteratively. Each line of pixels across a side (an image column where the side is nearer to horizontal,
else a row; no interpolation) is cut off at a distance from the side, the reach. Its outer pixels, the flanks, give the
grey levels of the marker's dark border and of the bright paper around it. Between these levels, each pixel has its
share of the step from dark to bright. The edge-spread function turns the shares of a line into its distance from the
parabola, and the parabola is fitted again.

The iterations are not left to a least-squares solver: the samples themselves (pixels within reach, grey levels,
edge-spread function) change from round to round, so that there is not one residual function to pass to it.

The edge-spread function is measured in the image itself, because the blur of lens and pixels is not exactly Gaussian. A
wrong profile displaces an edge by up to 0.03 px, depending on its position within a pixel. Along sides that cross many
pixels this averages out, but sides nearly parallel to a row or a column are bent by it, by 0.05 px at their corners.
The deviation from the error function is estimated from all pixels beside a marker's sides.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import cache
from typing import NamedTuple

import cv2
import numpy as np
from scipy.special import ndtr

from ringpose.calibrate.boards.corner_errors import endpoint_correlation
from ringpose.calibrate.boards.patterns.image_patch import MIN_BLUR_PX, GreyImage
from ringpose.geometry.least_squares import Rows, gauss_newton, huber_weights, robust_std
from ringpose.types.arrays import Array, Bool, Float64

MIN_CELL_PX = 4.0
"""Minimum width of a cell, 24 px for a side of `CELLS` cells: narrower borders show no dark level."""

MIN_SAMPLES = 8
"""Minimum number of lines of pixels to which a parabola is fitted."""

CLEAR_BLURS = 4.0
"""Length left out at both ends of a side, where blur rounds the corner, in standard deviations of the blur."""

MAX_LEFT_OUT = 0.1
"""Maximum share of a side that is left out at each end."""

MAX_STEP_PX = 2.0
"""Maximum distance of a refined corner from the detected one."""

REACH_PX = 5.0
"""Reach: distance from a side within which pixels are used, at most half the width of the marker's black border."""

MAX_REACH_PX = 8.0
"""Reach where the edge is so blurred that neither the dark nor the bright level is seen within `REACH_PX`."""

CELLS = 6.0
"""Cells across a marker of the smallest dictionaries, border included; the border is one cell wide."""

FLANK_BLURS, MIN_FLANK, MAX_FLANK = 3.0, 0.3, 0.6
"""Distance of the flanks from the edge in standard deviations of the blur, and its limits as shares of the reach."""

MIN_RISE = 0.5
"""Minimum step from dark to bright of a line of pixels over the median step: below it the edge is covered."""

_GAUSSIAN_ROUNDS, _ROUNDS = 2, 5
"""Number of rounds with a Gaussian edge-spread function, until the sides are nearly in place, and of all rounds."""

_BLUR_ITERATIONS = 3

_MAX_PROFILE_RESIDUAL = 0.2
"""Residuals of the edge profile are clipped to this share of the step: larger ones come from occlusion."""

_FLANK_POSITION = 0.65
"""Distance from a side, in reaches, of the strips in which the brightness gradients are measured."""

_MAX_UNEVENNESS = 0.1
"""Maximum residual of the brightness of the four strips from a plane, as a share of the contrast."""

_OUTLIER_SIGMAS = 4.0
"""Limit of the residuals of robust parabolas, in robust standard deviations."""


KNOT_PX = 0.5
"""Knot spacing of the cubic spline that is added to the error function."""

RIDGE = 1.0
"""Ridge penalty of the spline's coefficients, as a number of samples: bounds coefficients in gaps of the samples."""

ROBUST_SIGMAS = 3.0
"""Limit of the Huber loss in standard deviations: larger residuals come from objects in front of the board."""

_ITERATIONS = 2

_TABLE_PX = np.linspace(-8.0, 8.0, 801)

_GAUSSIAN = np.zeros(0)
"""Coefficients of a Gaussian edge-spread function."""


class SideCorners(NamedTuple):
    """A marker's corners as intersections of its sides."""

    points_px: Float64[Array, "corner=4 xy=2"]
    end_correlation: float
    """Correlation of a side's errors at its two ends; zero if not all sides were fitted."""


Gradients = Float64[Array, "level=2 xy=2"]
"""Brightness gradients on a marker in grey levels per pixel: in its black border, and on the white paper around it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Side:
    """One side of a marker as a parabola: `start + t along + (c0 + c1 t + c2 t^2) normal`, t in pixels."""

    start: Float64[Array, "2"]
    along: Float64[Array, "2"]
    normal: Float64[Array, "2"]
    """Unit normal out of the marker, whose corners are in clockwise order."""
    length: float
    coefficients: Float64[Array, "3"]
    left_out: float = MAX_LEFT_OUT
    """Share of the side that the fit did not use at each end."""

    @property
    def pixel_spacing(self) -> float:
        """Distance of neighbouring pixels of a line, measured across the side."""
        return float(np.abs(self.normal).max())

    def points(self, t: Float64[Array, "n"], across: float = 0.0) -> Float64[Array, "n 2"]:
        """Points at t, at a distance `across` outside the parabola."""
        return self.start + np.outer(t, self.along) + np.outer(self.offset(t) + across, self.normal)

    def offset(self, t: Float64[Array, "n"]) -> Float64[Array, "n"]:
        """Distance of the parabola from its chord, positive outwards."""
        return self.coefficients[0] + t * (self.coefficients[1] + t * self.coefficients[2])


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class EdgeProfile:
    """Edge-spread function: 0 on the dark side, 1 on the bright side, tabulated by the distance from the edge.

    It is point-symmetric about the edge, where it is 0.5.
    """

    blur_px: float
    """Standard deviation of the closest error function."""
    shares: Float64[Array, "sample"]
    """Values at the tabulated distances, -8 to 8 px."""
    slopes: Float64[Array, "sample"]
    """Derivatives there, per pixel."""

    def share(self, across: Float64[Array, "*shape"]) -> Float64[Array, "*shape"]:
        """Value at distances in pixels, positive on the bright side."""
        return np.interp(across.ravel(), _TABLE_PX, self.shares).reshape(across.shape)

    def slope(self, across: Float64[Array, "*shape"]) -> Float64[Array, "*shape"]:
        """Derivative at distances in pixels, per pixel."""
        return np.interp(across.ravel(), _TABLE_PX, self.slopes).reshape(across.shape)


class SideSamples(NamedTuple):
    """Pixels beside a side of a marker, arranged in lines of pixels across the side."""

    t: Float64[Array, "line"]
    """Position along the side at which the line crosses it."""
    across: Float64[Array, "line pixel"]
    """Distance from the side, positive outwards."""
    share: Float64[Array, "line pixel"]
    """Share of the step from dark to bright: 0 at the dark level, 1 at the bright one."""
    used: Bool[Array, "line pixel"]
    """Mask of the pixels within reach, on lines that show an edge."""
    spacing: float
    """Distance of neighbouring pixels of a line, measured across the side."""


def corners_from_sides(image: GreyImage, corners: Float64[Array, "corner=4 xy=2"], cells: float = CELLS) -> SideCorners:
    """Corners of a marker as intersections of its sides; one without two fitted sides, or far away, is unchanged.

    Beside its sides, a marker is black for one of its `cells` and the paper is white for as much.
    """
    lengths = np.linalg.norm(np.roll(corners, -1, axis=0) - corners, axis=1)
    if lengths.min() < MIN_CELL_PX * cells:
        return SideCorners(corners, 0.0)
    light = marker_light(image, corners, cells)
    opposite = [_opposite_sides(image, corners, first, light, cells) for first in (0, 1)]
    sides = [opposite[i % 2][i // 2] for i in range(4)]
    refined = corners.copy()
    for i in range(4):
        before, after = sides[i - 1], sides[i]
        if before is not None and after is not None:
            intersection = side_intersection(before, after, corners[i])
            if np.linalg.norm(intersection - corners[i]) < MAX_STEP_PX:
                refined[i] = intersection
    correlations = [endpoint_correlation(side.left_out) for side in sides if side is not None]
    return SideCorners(refined, float(np.mean(correlations)) if len(correlations) == 4 else 0.0)


def marker_light(image: GreyImage, corners: Float64[Array, "corner=4 xy=2"], cells: float = CELLS) -> Gradients:
    """Brightness gradients from strips inside and outside the four sides; zero if their brightness is not a plane.

    Where the brightness changes by 0.05 % per pixel, a level taken 3 px from the edge displaces the edge by 0.002 px,
    and in the same direction all over the image. The strips of one side are too narrow to measure a gradient.
    """
    sides = [straight_side(corners[i], corners[(i + 1) % 4]) for i in range(4)]
    reach = reach_px(min(side.length for side in sides), cells=cells)
    across = _FLANK_POSITION * reach
    strips = np.array([[_strip_brightness(image, side, sign * across) for sign in (-1.0, 1.0)] for side in sides])
    middles = (corners + np.roll(corners, -1, axis=0)) / 2
    design = np.column_stack([np.ones(4), middles - middles.mean(axis=0)])
    planes = np.linalg.lstsq(design, strips)[0]
    uneven = np.abs(design @ planes - strips).max(axis=0) > _MAX_UNEVENNESS * np.ptp(planes[0])
    return np.where(uneven, 0.0, planes[1:]).T


def _strip_brightness(image: GreyImage, side: Side, across: float) -> float:
    """Median grey value along a side, at a distance outside it; the median excludes objects in front of the board."""
    t = np.linspace(MAX_LEFT_OUT, 1.0 - MAX_LEFT_OUT, int(side.length)) * side.length
    points = side.points(t, across).astype(np.float32)
    grey = cv2.remap(image, points[None, :, 0], points[None, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    return float(np.median(np.asarray(grey, dtype=np.float64)))


def straight_side(start: Float64[Array, "2"], end: Float64[Array, "2"]) -> Side:
    """A side as the chord between two corners."""
    length = float(np.linalg.norm(end - start))
    along = (end - start) / length
    normal = np.array([along[1], -along[0]])
    return Side(start=start, along=along, normal=normal, length=length, coefficients=np.zeros(3))


def reach_px(length: float, max_px: float = REACH_PX, cells: float = CELLS) -> float:
    """Distance from a side of this length within which pixels are used."""
    return min(max_px, 0.5 * length / cells)


def _opposite_sides(
    image: GreyImage, corners: Float64[Array, "corner=4 xy=2"], first: int, light: Gradients, cells: float
) -> list[Side | None]:
    """Two opposite sides, fitted together because they have the same blur; None where too little is visible."""
    chords = [straight_side(corners[i], corners[(i + 1) % 4]) for i in (first, first + 2)]
    for max_px in (REACH_PX, MAX_REACH_PX):
        reach = min(reach_px(side.length, max_px, cells) for side in chords)
        sides, blur_px = _fitted_sides(image, chords, light, reach)
        if FLANK_BLURS * blur_px < reach:
            break
    return sides


def _fitted_sides(
    image: GreyImage, chords: list[Side], light: Gradients, reach: float
) -> tuple[list[Side | None], float]:
    """The sides fitted to the pixels within reach, and the blur of their edges in pixels."""
    sides: list[Side | None] = list(chords)
    profile, left_out = edge_profile(reach), MAX_LEFT_OUT
    for iteration in range(_ROUNDS):
        samples = [
            None if side is None else side_samples(image, side, (left_out, reach), light, profile.blur_px)
            for side in sides
        ]
        sides = [
            None if side is None or own is None else _refitted_side(side, own, profile, left_out)
            for side, own in zip(sides, samples, strict=True)
        ]
        usable = [own for side, own in zip(sides, samples, strict=True) if side is not None and own is not None]
        if not usable:
            break
        blur_px = float(np.median([_blur_px(own, reach) for own in usable]))
        gaussian = iteration < _GAUSSIAN_ROUNDS
        profile = edge_profile(blur_px) if gaussian else fitted_profile(usable, blur_px, reach)
        shortest = min(side.length for side in sides if side is not None)
        left_out = min(CLEAR_BLURS * profile.blur_px / shortest, MAX_LEFT_OUT)
    return sides, profile.blur_px


def side_samples(
    image: GreyImage, side: Side, extent: tuple[float, float], light: Gradients, blur_px: float
) -> SideSamples | None:
    """Samples of a side's edge; None if too little of it is visible.

    `extent` has two values: the share of the side left out at each end, and the reach across the side in pixels.
    """
    left_out, reach = extent
    t, across, grey = _pixels(image, side, left_out, reach)
    flank_px = float(np.clip(FLANK_BLURS * blur_px, MIN_FLANK * reach, MAX_FLANK * reach))
    within = np.abs(across) <= reach
    flanks = within & (across <= -flank_px), within & (across >= flank_px)  # dark, bright
    seen = flanks[0].any(axis=1) & flanks[1].any(axis=1)
    if seen.sum() < MIN_SAMPLES:
        return None
    t, across, grey, within = t[seen], across[seen], grey[seen], within[seen]
    # Levels of dark and bright: measured in the flanks, extrapolated to each pixel by the brightness gradients.
    in_image = np.where(np.isfinite(across), across, 0.0)
    levels, smooth = [], []
    for flank, slope in zip(flanks, (light @ side.normal).tolist(), strict=True):
        own = flank[seen]
        level = np.sum(grey - slope * in_image, axis=1, where=own) / own.sum(axis=1)
        parabola = robust_parabola(t, level)
        if parabola is None:
            return None
        levels.append(level)
        smooth.append(np.polynomial.polynomial.polyval(t, parabola)[:, None] + slope * in_image)
    dark, bright = smooth
    rise = np.median(bright - dark, axis=1)
    visible = (rise > 0) & (levels[1] - levels[0] > MIN_RISE * rise)
    if visible.sum() < MIN_SAMPLES:
        return None
    share = (grey - dark) / np.where(visible[:, None], bright - dark, 1.0)
    return SideSamples(t, across, share, visible[:, None] & within, side.pixel_spacing)


def _pixels(
    image: GreyImage, side: Side, left_out: float, reach: float
) -> tuple[Float64[Array, "line"], Float64[Array, "line pixel"], Float64[Array, "line pixel"]]:
    """By line of pixels across a side: position along the side, distances of its pixels from the side, and grey values.

    Lines are image columns where the side is nearer to horizontal, else rows. Distances are infinite outside the image.
    """
    is_horizontal = abs(side.along[0]) >= abs(side.along[1])
    line_axis, pixel_axis = (0, 1) if is_horizontal else (1, 0)
    interval = np.array([left_out, 1.0 - left_out]) * side.length
    ends = np.sort(side.start[line_axis] + interval * side.along[line_axis])
    lines = np.arange(np.ceil(ends[0]), np.floor(ends[1]) + 1)
    t = (lines - side.start[line_axis]) / side.along[line_axis]  # where a line crosses the chord ...
    t = t - side.offset(t) * side.normal[line_axis] / side.along[line_axis]  # ... and, nearly, the parabola
    crossing = side.start[pixel_axis] + t * side.along[pixel_axis] + side.offset(t) * side.normal[pixel_axis]
    half = int(np.ceil(reach / side.pixel_spacing))
    pixels = np.rint(crossing)[:, None] + np.arange(-half, half + 1)
    slope = side.coefficients[1] + 2 * side.coefficients[2] * t  # of the parabola against its chord
    distance_per_pixel = side.normal[pixel_axis] - slope * side.along[pixel_axis]
    across = (pixels - crossing[:, None]) * distance_per_pixel[:, None]
    by_line = image if is_horizontal else image.T
    size = by_line.shape
    within = (pixels >= 0) & (pixels < size[0]) & ((lines >= 0) & (lines < size[1]))[:, None]
    row = np.clip(pixels, 0, size[0] - 1).astype(np.int64)
    column = np.clip(lines, 0, size[1] - 1).astype(np.int64)
    return t, np.where(within, across, np.inf), by_line[row, column[:, None]].astype(np.float64)


def _refitted_side(side: Side, samples: SideSamples, profile: EdgeProfile, left_out: float) -> Side | None:
    """The side fitted to its edge: each line of pixels adds one Gauss-Newton step of its distance from the edge."""
    across = np.where(samples.used, samples.across, 0.0)
    slope = np.where(samples.used, profile.slope(across), 0.0)
    residual = np.where(samples.used, profile.share(across) - samples.share, 0.0)
    information = np.sum(slope**2, axis=1)
    offset = np.where(
        information > 0, np.sum(slope * residual, axis=1) / np.where(information > 0, information, 1.0), np.nan
    )
    coefficients = robust_parabola(samples.t, side.offset(samples.t) + offset)
    return None if coefficients is None else replace(side, coefficients=coefficients, left_out=left_out)


def robust_parabola(t: Float64[Array, "n"], values: Float64[Array, "n"]) -> Float64[Array, "3"] | None:
    """Coefficients of a parabola fitted without outliers (occlusions) and NaN; None if too few samples are left."""
    finite = np.isfinite(values)
    scale = float(np.abs(t).max())
    basis, values = np.vander(t[finite] / scale, 3, increasing=True), values[finite]
    used = np.ones(len(values), dtype=bool)
    for _ in range(3):
        if used.sum() < MIN_SAMPLES:
            return None
        rows = basis[used]
        coefficients = np.linalg.solve(rows.T @ rows, rows.T @ values[used])
        residual = np.abs(values - basis @ coefficients)
        within = residual <= max(_OUTLIER_SIGMAS * robust_std(residual[used]), 1e-6)
        if np.array_equal(within, used):
            break
        used = within
    return coefficients / scale ** np.arange(3)


def _blur_px(samples: SideSamples, reach: float) -> float:
    """Standard deviation of the error function fitted to the edge by least squares, its position free.

    The start value follows from the area between the edge and an unblurred step, (2 / pi)^1/2 standard deviations. It
    is not accurate enough where a side is parallel to rows: there few positions within a pixel are sampled.
    `scipy.optimize.least_squares` finds the same minimum in four times the time (20 calls a marker: 37 instead of 10 ms
    of 69).
    """
    across, share = samples.across[samples.used], samples.share[samples.used]
    area = np.abs(share - np.heaviside(across, 0.5)).sum() * samples.spacing
    start = np.clip(np.sqrt(np.pi / 2) * area / samples.used.any(axis=1).sum(), MIN_BLUR_PX, reach)

    def linearize(state: Float64[Array, "2"]) -> Rows:
        shift, blur = state
        z = (across - shift) / blur
        density = np.exp(-0.5 * z**2) / (np.sqrt(2 * np.pi) * blur)
        residual = np.clip(ndtr(z) - share, -_MAX_PROFILE_RESIDUAL, _MAX_PROFILE_RESIDUAL)
        return Rows.of(residual, np.column_stack([-density, -z * density]))

    def retract(state: Float64[Array, "2"], problem: Rows) -> Float64[Array, "2"]:
        shift, blur = state + problem.step
        return np.array([shift, np.clip(blur, MIN_BLUR_PX, reach)])

    (_, blur_px), _ = gauss_newton(linearize, retract, np.array([0.0, start]), _BLUR_ITERATIONS)
    return float(blur_px)


def side_intersection(before: Side, after: Side, corner: Float64[Array, "2"]) -> Float64[Array, "2"]:
    """Intersection of the side that ends in a corner with the side that starts there, by Newton's method.

    Parallel tangents give the corner itself.
    """
    sides, t = (before, after), np.array([before.length, 0.0])
    intersection = corner
    for _ in range(3):
        points = [side.points(t[i : i + 1])[0] for i, side in enumerate(sides)]
        slopes = [side.coefficients[1] + 2 * side.coefficients[2] * t[i] for i, side in enumerate(sides)]
        tangents = [side.along + slope * side.normal for side, slope in zip(sides, slopes, strict=True)]
        system = np.stack([tangents[0], -tangents[1]], axis=1)
        if abs(np.linalg.det(system)) < 1e-6:
            return corner
        step = np.linalg.solve(system, points[1] - points[0])
        intersection = points[0] + step[0] * tangents[0]
        t = t + step
    return intersection


def fitted_profile(samples: Sequence[SideSamples], blur_px: float, reach: float) -> EdgeProfile:
    """The profile common to the edges: the error function of this blur, with the deviation that the samples show."""
    across = np.concatenate([own.across[own.used] for own in samples])
    basis = _odd(_spline, across, int(np.ceil(reach / KNOT_PX)))
    deviation = np.concatenate([own.share[own.used] for own in samples]) - ndtr(across / blur_px)
    weights, coefficients = np.ones(len(deviation)), np.zeros(basis.shape[1])
    for _ in range(_ITERATIONS):
        weighted = basis * weights[:, None]
        normal_matrix = weighted.T @ basis + RIDGE * np.eye(len(coefficients))
        coefficients = np.linalg.solve(normal_matrix, weighted.T @ deviation)
        residual = deviation - basis @ coefficients
        weights = huber_weights(residual, max(ROBUST_SIGMAS * robust_std(residual), 1e-12))
    return edge_profile(blur_px, coefficients)


def edge_profile(blur_px: float, coefficients: Float64[Array, "knot"] = _GAUSSIAN) -> EdgeProfile:
    """The error function of a Gaussian blur, plus a spline with these coefficients."""
    density = np.exp(-0.5 * (_TABLE_PX / blur_px) ** 2) / (np.sqrt(2 * np.pi) * blur_px)
    splines, slopes = _tabulated_splines(len(coefficients))
    return EdgeProfile(
        blur_px=blur_px,
        shares=ndtr(_TABLE_PX / blur_px) + splines @ coefficients,
        slopes=density + slopes @ coefficients,
    )


@cache
def _tabulated_splines(knots: int) -> tuple[Float64[Array, "sample knot"], Float64[Array, "sample knot"]]:
    """The splines and their derivatives at the tabulated distances."""
    return _odd(_spline, _TABLE_PX, knots), _odd(_spline_slope, _TABLE_PX, knots) / KNOT_PX


def _odd(
    spline: Callable[[Float64[Array, "n knot"]], Float64[Array, "n knot"]], across: Float64[Array, "n"], knots: int
) -> Float64[Array, "n knot"]:
    """A function centred at each knot minus its mirror image: odd functions keep the profile 0.5 at the edge."""
    x, knot = across[..., None] / KNOT_PX, np.arange(1.0, knots + 1)
    return spline(x - knot) - spline(x + knot)


def _spline(x: Float64[Array, "n knot"]) -> Float64[Array, "n knot"]:
    """Cubic B-spline with integer knots, centred at zero."""
    outer, inner = np.maximum(2.0 - np.abs(x), 0.0), np.maximum(1.0 - np.abs(x), 0.0)
    return (outer * outer * outer - 4.0 * inner * inner * inner) / 6.0


def _spline_slope(x: Float64[Array, "n knot"]) -> Float64[Array, "n knot"]:
    """Derivative of the cubic B-spline `_spline`."""
    outer, inner = np.maximum(2.0 - np.abs(x), 0.0), np.maximum(1.0 - np.abs(x), 0.0)
    return -np.sign(x) * (outer * outer - 4.0 * inner * inner) / 2.0
