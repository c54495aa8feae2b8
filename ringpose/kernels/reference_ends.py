"""Readable NumPy twin of the kernel that finds where stripes end: the oracle of its tests."""

import math
from dataclasses import dataclass

import numpy as np

from ringpose.kernels.reference_profile import (
    Image,
    Line,
    Profile,
    distorted_line,
    parabola,
    profile_along,
    reached_x,
    section_sigma,
)
from ringpose.kernels.ring import EndRules, Lens
from ringpose.types.arrays import Array, Float64

STEPS = np.linspace(-4.0, 4.0, 801)
NORMAL_CDF = np.array([0.5 * (1 + math.erf(step / math.sqrt(2))) for step in STEPS])
NOT_FOUND = (math.nan,) * 9
WIDTHS = (0.3, 0.4, 0.55, 0.75, 1.0, 1.4, 2.0)
SHARP = 5
MIDDLE = 3
COARSE = np.arange(-12, 7) * 1.0
FINE = np.arange(-5, 6) * 0.15


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Columns:
    """The columns about an end, outwards."""

    along: Float64[Array, "n"]
    amplitude: Float64[Array, "n"]
    headroom: Float64[Array, "n"]
    texture: Float64[Array, "n"]
    saturated: Float64[Array, "n"]
    level: float
    """Of the face's stripe."""
    contrast: float
    """Its relative spread (speckle)."""
    noise: float
    """Beyond the end."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Fit:
    """The edge that fits best, for each width."""

    cost: Float64[Array, "width"]
    position: Float64[Array, "width"]
    outside: Float64[Array, "width"]


def stripe_ends(
    lit: Image, dark: Image | None, lines: Float64[Array, "track column=5"], lens: Lens, rules: EndRules
) -> Float64[Array, "track end=2 column=10"]:
    """Twin of `ringpose.kernels.ring.stripe_ends`."""
    ends = np.full((len(lines), 2, 10), np.nan)
    fits: dict[tuple[int, int], tuple[Line, float, float, tuple[Columns, Fit]]] = {}
    for number, track in enumerate(lines):
        line = distorted_line(track, lens, lit.shape[1], rules)
        face = line.x[line.on_face]
        if len(face) < 2:
            continue
        sigma = section_sigma(lit, dark, line, rules.saturation_dn)
        profile = profile_along(lit, dark, line, sigma, rules)
        for side, (near_x, outward) in enumerate(((face[0], -1), (face[-1], 1))):
            near = reached_x(profile, float(near_x), outward, rules)
            columns = _columns(profile, near, outward, rules)
            ends[number, side, 7], ends[number, side, 9] = sigma, profile.beneath
            if columns is not None:
                fits[number, side] = line, near, sigma, (columns, _fit(columns, sigma))
    blur = _blur([fit for *_, (_, fit) in fits.values()], rules)
    for (number, side), (line, near, sigma, fitted) in fits.items():
        ends[number, side, :9] = _end(line, near, ((-1, 1)[side], sigma), fitted, blur, rules)
    return ends


def _columns(profile: Profile, near_x: float, outward: int, rules: EndRules) -> Columns | None:
    """What an end is fitted to; None if that is too little or dark."""
    along = (profile.x - near_x) * outward
    used = (along > -rules.inside_columns) & (along < rules.outside_columns)
    along = along[used]
    if np.count_nonzero(along < -2) < 4 or np.count_nonzero(along > 1) < 3:
        return None
    amplitude, headroom = profile.amplitude[used], profile.headroom[used]
    full = amplitude[along < -2] / np.maximum(headroom[along < -2], rules.least_headroom)
    level = float(np.median(full))
    if level <= 0:
        return None
    beyond = amplitude[along > 2]
    noise = 1.4826 * float(np.median(np.abs(beyond - np.median(beyond)))) if len(beyond) else 0.0
    return Columns(
        along=along,
        amplitude=amplitude,
        headroom=headroom,
        texture=profile.texture[used],
        saturated=profile.saturated[used].astype(np.float64),
        level=level,
        contrast=max(1.4826 * float(np.median(np.abs(full - level))) / level, profile.noise / level, 0.002),
        noise=max(noise, profile.noise, 0.002 * level),
    )


def _fit(columns: Columns, sigma: float) -> Fit:
    """A coarse search at one width, then all widths around what it found, each from where the last one ended."""
    start = _coarse_position(columns, 0.8 * sigma)
    costs, positions, outsides = (np.empty(len(WIDTHS)) for _ in range(3))
    steps = dict.fromkeys(range(len(WIDTHS)), len(FINE) // 2)
    for s in (MIDDLE, *range(MIDDLE - 1, -1, -1), *range(MIDDLE + 1, len(WIDTHS))):
        from_step = steps[s + (s < MIDDLE) - (s > MIDDLE)]
        costs[s], positions[s], outsides[s], steps[s] = _descended(columns, WIDTHS[s] * sigma, start, from_step)
    return Fit(cost=costs, position=positions, outside=outsides)


def _coarse_position(columns: Columns, width: float) -> float:
    """Where the edge lies to half a column: the best of whole columns, and the halves beside it."""
    best = COARSE[int(np.argmin([_cost(columns, at, width)[0] for at in COARSE]))]
    beside = best + np.array([0.0, -0.5, 0.5])
    return float(beside[int(np.argmin([_cost(columns, at, width)[0] for at in beside]))])


def _descended(columns: Columns, width: float, start: float, k: int) -> tuple[float, float, float, int]:
    """Cost, position, level outside and step of the lowest place downhill from step `k`, then a parabola."""
    found = [_cost(columns, float(start + shift), width) for shift in FINE]
    cost = [each[0] for each in found]
    while (lowest := min((k, k - 1, k + 1), key=lambda j: cost[j] if 0 <= j < len(cost) else math.inf)) != k:
        k = lowest
    shift = parabola(cost[k - 1 : k + 2]) if 0 < k < len(FINE) - 1 else 0.0
    return cost[k], float(start + FINE[k] + 0.15 * shift), found[k][1], k


def _cost(columns: Columns, position: float, width: float) -> tuple[float, float]:
    """Minus log likelihood of an edge with its best levels, and the outside level's share of the inside."""
    edge = _edge(columns.along, position, width)
    inside, outside = edge * columns.headroom, 1 - edge
    variance = _variance(columns, inside)
    a, b, c = (float(np.sum(u * v / variance)) for u, v in ((inside, inside), (inside, outside), (outside, outside)))
    p, q = (float(np.sum(u * columns.amplitude / variance)) for u in (inside, outside))
    determinant = max(a * c - b * b, 1e-30)
    within = max((c * p - b * q) / determinant, 1e-6)
    beyond = min(max((a * q - b * p) / determinant, 0.0), within)
    residual = columns.amplitude - within * inside - beyond * outside
    return float(0.5 * np.sum(residual**2 / variance + np.log(variance))), beyond / within


def _edge(along: Float64[Array, "n"], position: float, width: float) -> Float64[Array, "n"]:
    """One inside, nothing outside, an error function between."""
    edge: Float64[Array, "n"] = np.interp((position - along) / width, STEPS, NORMAL_CDF, left=0.0, right=1.0)
    return edge


def _variance(columns: Columns, inside: Float64[Array, "n"]) -> Float64[Array, "n"]:
    return columns.noise**2 + columns.texture + (columns.contrast * columns.level * inside) ** 2


def _blur(fits: list[Fit], rules: EndRules) -> tuple[int, float]:
    """What all ends of an image say: the number of the width that suits them best, and the gain by blunter ones."""
    if not fits:
        return 0, 0.0
    excess = [np.minimum(fit.cost[:SHARP] - fit.cost[:SHARP].min(), rules.most_excess) for fit in fits]
    gain = sum(float(fit.cost[:SHARP].min() - fit.cost.min()) for fit in fits)
    return int(np.argmin(np.sum(excess, axis=0))), gain


def _end(
    line: Line,
    near_x: float,
    side: tuple[int, float],
    fitted: tuple[Columns, Fit],
    blur: tuple[int, float],
    rules: EndRules,
) -> tuple[float, ...]:
    """x, y, slope, sigma, level outside, share of saturated columns, width, section's sigma, whether blunt."""
    columns, fit = fitted
    outward, sigma = side
    k = int(np.argmin(fit.cost))
    blunt = blur[1] > rules.blunt_gain and k >= SHARP - 1
    if not blunt:
        unlike = np.log(np.array(WIDTHS[:SHARP]) / WIDTHS[blur[0]]) / rules.width_spread
        k = int(np.argmin(fit.cost[:SHARP] + 0.5 * unlike**2))
    position, width, outside = float(fit.position[k]), WIDTHS[k] * sigma, float(fit.outside[k])
    last = columns.saturated[(columns.along > position - 6) & (columns.along < position)]
    saturated = float(np.mean(last)) if len(last) else 0.0
    hidden = rules.hidden_speckle if saturated > rules.saturated_share else 0.0
    square = _square(columns, position, width, outside, hidden, rules)
    if blunt:
        square += width**2
    x = near_x + outward * position
    y, left, right = np.interp([x, x - 0.5, x + 0.5], line.x, line.y)
    return x, float(y), float(right - left), math.sqrt(square), outside, saturated, width, sigma, float(blunt)


def _square(columns: Columns, position: float, width: float, outside: float, hidden: float, rules: EndRules) -> float:
    """Variance of an edge's position along the columns."""
    along, level = columns.along, columns.level
    inside = columns.headroom * _edge(along, position, width)
    slope = level * np.exp(-0.5 * ((position - along) / width) ** 2) / (width * math.sqrt(2 * math.pi))
    slope = slope * columns.headroom * (1 - outside)
    variance = _variance(columns, inside)
    speckle = max(columns.contrast**2 - (columns.noise / level) ** 2, 0.0)
    alike = 1 + (rules.speckle_columns - 1) * speckle / columns.contrast**2
    information = max(float(np.sum(slope**2 / variance)), 1e-12)
    beneath = float(np.sum(slope * np.sqrt(columns.texture) / variance)) / information
    full = columns.amplitude / np.maximum(columns.headroom, rules.least_headroom) / level
    beyond = (along > position + 3 * width) & (along < position + rules.near_columns)
    slow = max(speckle, _slow_variance(full[along < position - 3 * width], 1.0), hidden**2)
    slow += _slow_variance(columns.amplitude[beyond] / level, outside)
    return alike / information + beneath**2 + slow * (rules.grain_factor * width) ** 2 + rules.shape_sigma**2


def _slow_variance(values: Float64[Array, "n"], level: float) -> float:
    """Variance about a level of what neighbours share; what each column has of its own shows in their differences."""
    if len(values) < 3:
        return 0.0
    return max(float(np.mean((values - level) ** 2)) - 0.5 * float(np.mean(np.diff(values) ** 2)), 0.0)
