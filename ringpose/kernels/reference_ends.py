"""Readable NumPy twin of the kernel that finds where stripes end: the oracle of its tests."""

import math
from dataclasses import dataclass

import numpy as np

from ringpose.kernels.ring import EndRules, Lens
from ringpose.types.arrays import Array, Bool, Float64, UInt

CURVE_POINTS = 64
SECTION_ROWS = 6
STEPS = np.linspace(-4.0, 4.0, 801)
NORMAL_CDF = np.array([0.5 * (1 + math.erf(step / math.sqrt(2))) for step in STEPS])
NOT_FOUND = (math.nan,) * 7
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
    headroom: Float64[Array, "n"]
    saturated: Bool[Array, "n"]


def stripe_ends(
    lit: Image, dark: Image | None, lines: Float64[Array, "track column=5"], lens: Lens, rules: EndRules
) -> Float64[Array, "track end=2 column=8"]:
    """Twin of `ringpose.kernels.ring.stripe_ends`."""
    ends = np.empty((len(lines), 2, 8))
    for number, track in enumerate(lines):
        line = distorted_line(track, lens, lit.shape[1], rules)
        face = line.x[line.on_face]
        if len(face) < 2:
            ends[number] = np.nan
            continue
        sigma = section_sigma(lit, dark, face.astype(np.int64), line.y[line.on_face])
        profile = profile_along(lit, dark, line, sigma, rules)
        for side, (near_x, outward) in enumerate(((face[0], -1), (face[-1], 1))):
            near = reached_x(profile, float(near_x), outward, rules)
            ends[number, side] = (*_end(profile, line, near, outward, sigma, rules), sigma)
    return ends


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


def section_sigma(lit: Image, dark: Image | None, x: Array, y: Float64[Array, "n"]) -> float:
    """Sigma of the stripe's cross-section, from all columns whose section lies in the image; 1.5 without any."""
    rows = np.rint(y).astype(np.int64)[:, None] + np.arange(-SECTION_ROWS, SECTION_ROWS + 1)
    inside = np.all((rows >= 0) & (rows < lit.shape[0]), axis=1)
    if not inside.any():
        return 1.5
    offset = (rows - y[:, None])[inside]
    at = rows[inside], x[inside][:, None]
    value = lit[at].astype(np.float64) - (0.0 if dark is None else dark[at].astype(np.float64))
    middle = np.abs(offset) < SECTION_ROWS - 1.5
    value = np.where(middle, np.maximum(value - np.median(value[~middle]), 0), 0)
    return float(np.clip(np.sqrt(np.sum(value * offset**2) / max(value.sum(), 1e-9)), 0.7, 4.0))


def profile_along(lit: Image, dark: Image | None, line: Line, sigma: float, rules: EndRules) -> Profile:
    """The stripe's brightness in the columns of its line.

    Where the stripe's middle is saturated, its flanks alone speak, the same rows in every column.
    """
    reach = math.ceil(rules.flank_sigmas * sigma) + 1
    rows = np.clip(np.rint(line.y).astype(np.int64)[:, None] + np.arange(-reach, reach + 1), 0, lit.shape[0] - 1)
    at = rows, line.x.astype(np.int64)[:, None]
    offset = np.abs(rows - line.y[:, None])
    bright = lit[at].astype(np.float64)
    ambient = np.broadcast_to(np.minimum(bright[:, :1], bright[:, -1:]), bright.shape)
    if dark is not None:
        ambient = dark[at].astype(np.float64)
    full = bright >= rules.saturation_dn
    clipped = _clipped_to(np.where(full & (ambient < rules.saturation_dn / 2), offset, 0.0), line.on_face, sigma, rules)

    shape = np.exp(-0.5 * (offset / sigma) ** 2)
    weight = np.where(offset > clipped, shape, 0)
    norm = np.maximum(np.sum(weight * shape, axis=1), 1e-9)
    amplitude = np.sum(weight * (bright - ambient), axis=1) / norm
    expected = max(float(np.median(amplitude[line.on_face])), 1.0)
    room = np.minimum(expected * shape, np.maximum(rules.saturation_dn - ambient, 0.0))
    headroom = np.sum(weight * room, axis=1) / norm / expected
    return Profile(x=line.x, amplitude=amplitude, headroom=headroom, saturated=full.any(axis=1))


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
    full = (profile.amplitude / np.maximum(profile.headroom, rules.least_headroom))[::outward]
    level = np.median(full[(along > -rules.inside_columns) & (along < 0)]) if np.any(along < 0) else 0.0
    beyond = full[along > 0]
    if level <= 0 or len(beyond) < 5:
        return near_x
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(beyond, 5), axis=-1)
    undimmed = int(np.argmin(np.append(smooth > rules.undimmed_level * level, False)))
    return near_x + outward * (undimmed + 2 if undimmed else 0)


def _end(profile: Profile, line: Line, near_x: float, outward: int, sigma: float, rules: EndRules) -> tuple[float, ...]:
    """x, y, slope, sigma, level outside, share of saturated columns, width of the edge; NaN if no edge fits."""
    along = (profile.x - near_x) * outward
    used = (along > -rules.inside_columns) & (along < rules.outside_columns)
    along, amplitude, headroom = along[used], profile.amplitude[used], profile.headroom[used]
    if np.count_nonzero(along < -2) < 4 or np.count_nonzero(along > 1) < 3:
        return NOT_FOUND
    level, contrast, noise = spread = _spread(along, amplitude, headroom, rules)
    if level <= 0:
        return NOT_FOUND

    position, width, outside = _best_edge(along, amplitude, headroom, spread, sigma, rules)
    slope = level * np.exp(-0.5 * ((position - along) / width) ** 2) / (width * math.sqrt(2 * math.pi)) * headroom
    variance = noise**2 + (contrast * level * headroom * _edge(along, position, width)) ** 2
    speckle = math.sqrt(max(contrast**2 - (noise / level) ** 2, 0.0))
    alike = 1 + (rules.speckle_columns - 1) * (speckle / contrast) ** 2
    information = float(np.sum(slope**2 * (1 - outside) ** 2 / variance)) / alike
    if information <= 0:
        return NOT_FOUND
    last = profile.saturated[used][(along > position - 6) & (along < position)]
    saturated = float(np.mean(last)) if len(last) else 0.0
    if saturated > rules.saturated_share:
        speckle = max(speckle, rules.hidden_speckle)
    along_sigma = math.sqrt(1 / information + (rules.grain_factor * speckle * width) ** 2 + rules.shape_sigma**2)
    x = near_x + outward * position
    y, left, right = np.interp([x, x - 0.5, x + 0.5], line.x, line.y)
    return x, float(y), float(right - left), along_sigma, outside, saturated, width


def _spread(
    along: Float64[Array, "n"], amplitude: Float64[Array, "n"], headroom: Float64[Array, "n"], rules: EndRules
) -> tuple[float, float, float]:
    """Level of the face's stripe, its relative spread (speckle), and the noise beyond its end."""
    inner = along < -2
    full = amplitude[inner] / np.maximum(headroom[inner], rules.least_headroom)
    level = float(np.median(full))
    contrast = 1.4826 * float(np.median(np.abs(full - level))) / max(level, 1e-9)
    beyond = amplitude[along > 2]
    noise = 1.4826 * float(np.median(np.abs(beyond - np.median(beyond)))) if len(beyond) else 0.0
    return level, max(contrast, 0.01), max(noise, 0.01 * level)


def _edge(along: Float64[Array, "n"], position: float, width: float) -> Float64[Array, "n"]:
    """One inside, nothing outside, an error function between."""
    edge: Float64[Array, "n"] = np.interp((position - along) / width, STEPS, NORMAL_CDF, left=0.0, right=1.0)
    return edge


def _best_edge(
    along: Float64[Array, "n"],
    amplitude: Float64[Array, "n"],
    headroom: Float64[Array, "n"],
    spread: tuple[float, float, float],
    sigma: float,
    rules: EndRules,
) -> tuple[float, float, float]:
    """Position, width and outside level (as a share of the inside's) of the edge that fits best.

    A coarse search at one width, then all widths around what it found, then a parabola.
    """
    coarse = np.arange(-12, 13) * 0.5
    cost = [_cost(along, amplitude, headroom, spread, at, 0.8 * sigma)[0] for at in coarse]
    fine = coarse[int(np.argmin(cost))] + np.arange(-7, 8) * 0.1
    least, best = math.inf, (0.0, sigma, 0.0)
    for share in (0.45, 0.6, 0.8, 1.0):
        found = [_cost(along, amplitude, headroom, spread, at, share * sigma) for at in fine]
        k = int(np.argmin([each[0] for each in found]))
        if found[k][0] < least:
            shift = _parabola([found[j][0] for j in (k - 1, k, k + 1)]) if 0 < k < len(fine) - 1 else 0.0
            least, best = found[k][0], (float(fine[k] + 0.1 * shift), share * sigma, found[k][1])
    return best


def _cost(
    along: Float64[Array, "n"],
    amplitude: Float64[Array, "n"],
    headroom: Float64[Array, "n"],
    spread: tuple[float, float, float],
    position: float,
    width: float,
) -> tuple[float, float]:
    """Minus log likelihood of an edge with its best levels, and the outside level's share of the inside."""
    level, contrast, noise = spread
    edge = _edge(along, position, width)
    inside, outside = edge * headroom, 1 - edge
    variance = noise**2 + (contrast * level * inside) ** 2
    a, b, c = (float(np.sum(u * v / variance)) for u, v in ((inside, inside), (inside, outside), (outside, outside)))
    p, q = float(np.sum(inside * amplitude / variance)), float(np.sum(outside * amplitude / variance))
    determinant = max(a * c - b * b, 1e-30)
    within = max((c * p - b * q) / determinant, 1e-6)
    beyond = min(max((a * q - b * p) / determinant, 0.0), within)
    residual = amplitude - within * inside - beyond * outside
    return float(0.5 * np.sum(residual**2 / variance + np.log(variance))), beyond / within


def _parabola(cost: list[float]) -> float:
    """The minimum between three equidistant values, in their distance, from the middle one."""
    bend = cost[0] - 2 * cost[1] + cost[2]
    return float(np.clip(0.5 * (cost[0] - cost[2]) / bend, -1, 1)) if bend > 0 else 0.0
