"""Readable NumPy twin of the kernel that reads a stripe's brightness along its line: the oracle of its tests."""

import math
from dataclasses import dataclass

import numpy as np

from ringpose.kernels.ring import EndRules, Lens
from ringpose.types.arrays import Array, Bool, Float64, UInt

CURVE_POINTS = 64
SECTION_ROWS = 10
SECTION_COLUMNS = 64
SECTION_SIGMAS = 0.7 * (4 / 0.7) ** (np.arange(17) / 16)
NO_SECTION = 1.5
LIT = (0.1, 0.5, 1.0)
NEAR = (2, 9)
LOW_TO_MEAN = 1.4
Image = UInt[Array, "row column"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Line:
    """Whole columns x and where the stripe's line runs in them, in distorted pixels."""

    x: Float64[Array, "n"]
    y: Float64[Array, "n"]
    on_face: Bool[Array, "n"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Profile:
    """Brightness of the stripe along its line; the share of it that ambient light leaves below saturation."""

    x: Float64[Array, "n"]
    amplitude: Float64[Array, "n"]
    room: Float64[Array, "lit=3 n"]
    """How much of the stripe saturation leaves visible where so much of it is lit (`LIT`)."""
    clipped: bool
    rough: Float64[Array, "n"]
    """Variance that a section leaves unexplained."""
    texture: Float64[Array, "n"]
    """Variance that what lies beneath the stripe adds to the amplitude."""
    saturated: Bool[Array, "n"]
    gain: float
    """Share of a pixel's variance that reaches the amplitude."""
    beneath: float
    """Relative variance of the face's peaks by what clearly lies beneath: four times the usual, more than grains do."""


def distorted_line(track: Float64[Array, "5"], lens: Lens, width: int, rules: EndRules) -> Line:
    """The line y = middle_y + slope (x - middle_x) of undistorted pixels, from x_start to x_end and some way beyond."""
    middle_x, middle_y, slope, x_start, x_end = track
    straight_x = np.linspace(x_start - rules.beyond_columns, x_end + rules.beyond_columns, CURVE_POINTS)
    bent = distorted(np.stack([straight_x, middle_y + slope * (straight_x - middle_x)], axis=-1), lens)
    x = np.arange(max(np.ceil(bent[0, 0]), 0), min(np.floor(bent[-1, 0]), width - 1) + 1)
    start, end = np.interp([x_start, x_end], straight_x, bent[:, 0])
    return Line(x=x, y=np.interp(x, bent[:, 0], bent[:, 1]), on_face=(x > start - 0.5) & (x < end + 0.5))


def distorted(points: Float64[Array, "n xy=2"], lens: Lens) -> Float64[Array, "n xy=2"]:
    """OpenCV's distortion of pixels."""
    x, y = ((points - (lens.cx, lens.cy)) / (lens.fx, lens.fy)).T
    square = x**2 + y**2
    radial = 1 + square * (lens.k1 + square * (lens.k2 + square * lens.k3))
    radial /= 1 + square * (lens.k4 + square * (lens.k5 + square * lens.k6))
    bent_x = x * radial + 2 * lens.p1 * x * y + lens.p2 * (square + 2 * x**2)
    bent_y = y * radial + lens.p1 * (square + 2 * y**2) + 2 * lens.p2 * x * y
    bent: Float64[Array, "n xy=2"] = np.stack([bent_x, bent_y], axis=-1) * (lens.fx, lens.fy) + (lens.cx, lens.cy)
    return bent


def section_sigma(lit: Image, dark: Image | None, line: Line, saturation_dn: float) -> float:
    """Sigma of the stripe's cross-section: the Gaussian nearest to its medians over the face, where not saturated."""
    x, y = line.x[line.on_face], line.y[line.on_face]
    count = min(len(x), SECTION_COLUMNS)
    some = np.arange(count) * len(x) // count
    offset = np.arange(-SECTION_ROWS, SECTION_ROWS + 1)
    rows = np.rint(y[some]).astype(np.int64)[:, None] + offset
    inside = np.all((rows >= 0) & (rows < lit.shape[0]), axis=1)
    if not inside.any():
        return NO_SECTION
    at = rows[inside], x[some][inside].astype(np.int64)[:, None]
    bright = lit[at].astype(np.float64)
    used = np.median(bright, axis=0) < saturation_dn
    value = np.median(bright - (0.0 if dark is None else dark[at].astype(np.float64)), axis=0)[used]
    cost = [_section_cost(offset[used], value, sigma) for sigma in SECTION_SIGMAS]
    k = int(np.argmin(cost))
    if not math.isfinite(cost[k]):
        return NO_SECTION
    shift = parabola(cost[k - 1 : k + 2]) if 0 < k < len(cost) - 1 else 0.0
    return float(0.7 * (4 / 0.7) ** ((k + shift) / 16))


def _section_cost(offset: Array, value: Float64[Array, "row"], sigma: float) -> float:
    """Squares that a Gaussian on a level leaves of a section; infinite if it would be a dark one.

    Rows are rounded to whole pixels from the line, which adds a variance of 1/12.
    """
    if len(value) < 6:
        return math.inf
    shape = np.exp(-0.5 * offset**2 / (sigma**2 + 1 / 12))
    shape, value = shape - shape.mean(), value - value.mean()
    amplitude = float(shape @ value / max(shape @ shape, 1e-12))
    return float(np.sum((value - amplitude * shape) ** 2)) if amplitude > 0 else math.inf


def parabola(cost: list[float]) -> float:
    """The minimum between three equidistant values, in their distance, from the middle one; 0 if there is none."""
    bend = cost[0] - 2 * cost[1] + cost[2]
    return float(np.clip(0.5 * (cost[0] - cost[2]) / bend, -1, 1)) if 0 < bend < math.inf else 0.0


def profile_along(lit: Image, dark: Image | None, line: Line, sigma: float, rules: EndRules) -> Profile:
    """The stripe's brightness in the columns of its line.

    Where the stripe's middle is saturated, its flanks alone speak, the same rows in every column.
    """
    reach = math.ceil(rules.flank_sigmas * sigma) + 1
    rows = np.clip(np.rint(line.y).astype(np.int64)[:, None] + np.arange(-reach, reach + 1), 0, lit.shape[0] - 1)
    at = rows, line.x.astype(np.int64)[:, None]
    offset = np.abs(rows - line.y[:, None])
    bright = lit[at].astype(np.float64)
    darker = np.broadcast_to(np.minimum(bright[:, :1], bright[:, -1:]), bright.shape)
    ambient = darker if dark is None else dark[at].astype(np.float64)
    full = bright >= rules.saturation_dn
    clipped = _clipped_to(np.where(full & (ambient < rules.saturation_dn / 2), offset, 0.0), line.on_face, sigma, rules)
    flank = max(2 * sigma, clipped + 1) if dark is None else math.inf
    shape = np.exp(-0.5 * (offset / sigma) ** 2)
    core, beside = (offset > clipped) & (offset <= flank), offset > flank
    amplitude, rough, gain = _fitted(bright if dark is None else bright - ambient, shape, core, beside)
    expected = max(float(np.median(amplitude[line.on_face])), 1.0)
    clips = bool(expected + ambient.max() > rules.saturation_dn)
    left = np.maximum(rules.saturation_dn - ambient, 0.0)
    shown = [_fitted(np.minimum(share * expected * shape, left), shape, core, beside)[0] for share in LIT if clips]
    room = np.stack(shown) / (expected * np.array(LIT)[:, None]) if clips else np.ones((len(LIT), len(amplitude)))
    texture, own = _texture(amplitude, rough, expected, line.on_face, rules)
    return Profile(
        x=line.x,
        amplitude=amplitude,
        room=room,
        clipped=clips,
        rough=rough,
        texture=texture,
        saturated=full.any(axis=1),
        gain=float(gain[0]),
        beneath=float(np.maximum(texture - 2 * own, 0)[line.on_face].mean()) / expected**2,
    )


def _fitted(
    value: Float64[Array, "n row"],
    shape: Float64[Array, "n row"],
    core: Bool[Array, "n row"],
    beside: Bool[Array, "n row"],
) -> tuple[Float64[Array, "n"], Float64[Array, "n"], Float64[Array, "n"]]:
    """Peak of the Gaussian section on the level of the rows beside it, variance about both, and a gain, by column.

    The gain is how much of a pixel's variance reaches the peak.
    """
    count = np.maximum(beside.sum(axis=1), 1)
    level, under = (np.sum(beside * each, axis=1) / count for each in (value, shape))
    weight = core * shape
    norm = np.maximum(np.sum(weight * (shape - under[:, None]), axis=1), 1e-9)
    peak = np.sum(weight * (value - level[:, None]), axis=1) / norm
    residual = (core | beside) * (value - level[:, None] - peak[:, None] * (shape - under[:, None]))
    gain = (np.sum(weight**2, axis=1) + np.sum(weight, axis=1) ** 2 / count * beside.any(axis=1)) / norm**2
    return peak, np.sum(residual**2, axis=1) / np.maximum((core | beside).sum(axis=1) - 2, 1), gain


def _texture(
    peak: Float64[Array, "n"], rough: Float64[Array, "n"], expected: float, on_face: Bool[Array, "n"], rules: EndRules
) -> tuple[Float64[Array, "n"], Float64[Array, "n"]]:
    """Variance of the peaks by what a section leaves unexplained beyond noise and its share on the face; that share."""
    white = _unlit_roughness(rough, on_face)
    share = float(np.median(np.maximum(rough[on_face] - white, 0) / np.maximum(peak[on_face], 1) ** 2))
    own, factor = share * np.abs(peak) * np.maximum(np.abs(peak), expected), rules.texture_factor**2
    return factor * np.maximum(rough - 2 * (white + own), 0), factor * own


def _unlit_roughness(rough: Float64[Array, "n"], on_face: Bool[Array, "n"]) -> float:
    """What a section leaves where it is dark, on the side beyond the face where that is less; else little of it."""
    first, last = np.flatnonzero(on_face)[[0, -1]]
    left = rough[max(first - NEAR[1], 0) : max(first - NEAR[0] + 1, 0)]
    right = rough[last + NEAR[0] : last + NEAR[1] + 1]
    enough = [low_roughness(side) for side in (left, right) if len(side) > (NEAR[1] - NEAR[0]) // 2]
    return min(enough) if enough else low_roughness(rough)


def low_roughness(rough: Float64[Array, "n"]) -> float:
    """The mean of what sections leave where only noise is, from the lowest of some that may show more."""
    return LOW_TO_MEAN * float(np.sort(rough)[(len(rough) - 1) // 4])


def _clipped_to(saturated: Float64[Array, "n row"], on_face: Bool[Array, "n"], sigma: float, rules: EndRules) -> float:
    """Distance from the line up to which the stripe is saturated in most columns; -1 if it hardly is."""
    half_width = np.sort(np.max(saturated, axis=1)[on_face])
    widest = float(half_width[int((1 - rules.flanks_share) * (len(half_width) - 1))])
    return min(widest + 0.5, rules.flank_sigmas * sigma - 1) if widest else -1.0


def reached_x(profile: Profile, near_x: float, outward: int, rules: EndRules) -> float:
    """The last column to which the stripe goes on undimmed beyond the last centre that was found.

    Where ambient light nearly saturates, the stripe is too weak for single columns, not for a median of five.
    """
    along = ((profile.x - near_x) * outward)[::outward]
    full = (profile.amplitude / np.maximum(profile.room[-1], rules.least_headroom))[::outward]
    level = np.median(full[(along > -rules.inside_columns) & (along < 0)]) if np.any(along < 0) else 0.0
    beyond = full[along > 0]
    if level <= 0 or len(beyond) < 5:
        return near_x
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(beyond, 5), axis=-1)
    undimmed = int(np.argmin(np.append(smooth > rules.undimmed_level * level, False)))
    return near_x + outward * (undimmed + 2 if undimmed else 0)
