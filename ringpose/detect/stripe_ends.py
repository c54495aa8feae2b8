"""Where a stripe on the face ends: an edge blurred by the optics, fitted to the stripe's brightness along itself.

Along the stripe the brightness falls from the face's level to what lies beyond (nothing, the weak continuation
on a wall, a leak of the stripe on the body behind) as an error function; speckle multiplies it.
"""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, UInt

from ringpose.types.arrays import Array

_STEPS = np.linspace(-4.0, 4.0, 801)
_NORMAL_CDF = np.array([0.5 * (1 + math.erf(step / math.sqrt(2))) for step in _STEPS])

INSIDE_COLUMNS = 24
"""Columns of the face that set its level before the edge."""

OUTSIDE_COLUMNS = 12
"""Columns beyond the edge that set the level there."""

SEARCH_COLUMNS = 6.0
"""How far the edge may lie from where the stripe's last centre was found."""

SEARCH_STEP = 0.05
"""Spacing of the positions tried, in columns; a parabola goes between them."""

EDGE_WIDTHS = (0.45, 0.6, 0.8, 1.0)
"""Blur of the edge in sigmas of the stripe: the optics blur both, the sheet's own thickness only the stripe."""

SPECKLE_COLUMNS = 2.0
"""Columns that share a grain: so much fewer are independent.

The grain at the edge itself moves the edge's half level by about its contrast times the edge's width, and no
number of columns averages that."""

GRAIN_FACTOR = 1.5
"""The last grain before the edge moves the edge's half level by its contrast times the edge's width; the optics,
which average over about twice that width, let the columns show less contrast than one grain has."""

SHAPE_SIGMA = 0.02
"""Columns by which a real edge's position depends on how its blur is modelled; adds to what noise explains."""

FLANK_SIGMAS = 3.0
"""Rows on both sides of the line that are looked at, in sigmas of the stripe."""

MEDIAN_COLUMNS = 5
"""Columns whose median says whether the stripe still goes on."""

UNDIMMED_LEVEL = 0.6
"""Share of the face's level above which it does; a wall beyond a kink has less."""

LEAST_HEADROOM = 0.05
"""Columns that saturation leaves less of than this say nothing about the stripe's level."""

SATURATED_SHARE = 0.2
"""Share of the last columns with a saturated pixel above which an end is flagged."""

HIDDEN_SPECKLE = 0.15
"""Contrast of the speckle that saturation hides: what rough metal shows through a lens of f/4 or so."""

FLANKS_SHARE = 0.6
"""Share of columns with a saturated pixel above which a stripe is read by its flanks; they see less light."""

KINK_LEVEL = 0.25
"""A level beyond the edge of this share of the face's means that the stripe runs on: a wall."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Line:
    """Whole columns x and where the stripe's line runs in them, in distorted pixels."""

    x: Float64[Array, "n"]
    y: Float64[Array, "n"]
    on_face: Bool[Array, "n"]
    """Between the ends of the track; the others lie some way beyond."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Profile:
    """Brightness of the stripe along its line, one value a column."""

    x: Float64[Array, "n"]
    amplitude: Float64[Array, "n"]
    """Peak of the Gaussian cross-section that fits each column best."""
    headroom: Float64[Array, "n"]
    """Share of a full cross-section that ambient light leaves below saturation."""
    saturated: Bool[Array, "n"]


@dataclass(frozen=True, slots=True, kw_only=True)
class StripeEnd:
    """An end of the stripe along x."""

    x: float
    sigma: float
    outside: float
    """Level beyond the end, as a share of the face's."""
    saturated: bool


def stripe_sigma(signal: Float64[Array, "row column"], x: Array, y: Float64[Array, "n"]) -> float:
    """Sigma of the stripe's cross-section, from its mean over the columns x with the centres y."""
    reach = 6
    rows = np.rint(y).astype(np.int64)[:, None] + np.arange(-reach, reach + 1)
    inside = np.all((rows >= 0) & (rows < signal.shape[0]), axis=1)
    if not inside.any():
        return 1.5
    offset = (rows - y[:, None])[inside]
    value = signal[rows[inside], x[inside][:, None]]
    value = np.maximum(value - np.median(value[np.abs(offset) > 4.5]), 0)
    weight = value * (np.abs(offset) < 4.5)
    return float(np.clip(np.sqrt(np.sum(weight * offset**2) / max(weight.sum(), 1e-9)), 0.7, 4.0))


def profile_along(
    lit: UInt[Array, "row column"],
    dark: UInt[Array, "row column"] | None,
    line: Line,
    sigma: float,
    saturation_dn: int,
) -> Profile:
    """The stripe's brightness in the columns of its line.

    Where the stripe's middle is saturated, its flanks alone speak, the same rows in every column.
    """
    x, y = line.x, line.y
    columns = x.astype(np.int64)[:, None]
    reach = math.ceil(FLANK_SIGMAS * sigma) + 1
    rows = np.clip(np.rint(y).astype(np.int64)[:, None] + np.arange(-reach, reach + 1), 0, lit.shape[0] - 1)
    offset = np.abs(rows - y[:, None])
    bright = lit[rows, columns].astype(np.float64)
    ambient = _ambient(bright) if dark is None else dark[rows, columns].astype(np.float64)
    full = bright >= saturation_dn
    shape = np.exp(-0.5 * (offset / sigma) ** 2)
    weight = np.where(offset > _clipped_to(offset, full & (ambient < saturation_dn / 2), line.on_face, sigma), shape, 0)
    norm = np.maximum(np.sum(weight * shape, axis=1), 1e-9)
    amplitude = np.sum(weight * (bright - ambient), axis=1) / norm
    expected = max(float(np.median(amplitude[line.on_face])), 1.0)
    room = np.minimum(expected * shape, np.maximum(saturation_dn - ambient, 0.0))
    headroom = np.sum(weight * room, axis=1) / norm / expected
    return Profile(x=x, amplitude=amplitude, headroom=headroom, saturated=full.any(axis=1))


def _clipped_to(
    offset: Float64[Array, "n row"], full: Bool[Array, "n row"], on_face: Bool[Array, "n"], sigma: float
) -> float:
    """Distance from the line up to which the stripe is saturated in most columns; -1 if it hardly is."""
    half_width = np.max(np.where(full, offset, 0.0), axis=1)[on_face]
    widest = float(np.quantile(half_width, 1 - FLANKS_SHARE))
    return min(widest + 0.5, FLANK_SIGMAS * sigma - 1) if widest else -1.0


def _ambient(bright: Float64[Array, "n row"]) -> Float64[Array, "n row"]:
    """Without a dark frame: the darker of the values above and below the stripe."""
    return np.broadcast_to(np.minimum(bright[:, :1], bright[:, -1:]), bright.shape)


def reached_x(profile: Profile, near_x: float, outward: int) -> float:
    """The last column to which the stripe goes on undimmed beyond the last centre that was found.

    Where ambient light nearly saturates, the stripe is too weak for single columns, not for a median of five.
    """
    along = (profile.x - near_x) * outward
    order = np.argsort(along, kind="stable")
    along = along[order]
    full = (profile.amplitude / np.maximum(profile.headroom, LEAST_HEADROOM))[order]
    level = np.median(full[(along > -INSIDE_COLUMNS) & (along < 0)]) if np.any(along < 0) else 0.0
    beyond = full[along > 0]
    if level <= 0 or len(beyond) < MEDIAN_COLUMNS:
        return near_x
    smooth = np.median(np.lib.stride_tricks.sliding_window_view(beyond, MEDIAN_COLUMNS), axis=-1)
    undimmed = int(np.argmin(np.append(smooth > UNDIMMED_LEVEL * level, False)))
    return near_x + outward * (undimmed + MEDIAN_COLUMNS // 2 if undimmed else 0)


def stripe_end(profile: Profile, near_x: float, outward: int, sigma: float) -> StripeEnd | None:
    """The end of the stripe near a column, going outward (+1 to the right, -1 to the left); None if none fits.

    For each position and width of the edge the two levels follow by weighted least squares; the position with the
    least residual wins, and the curvature of the residual there gives its standard deviation.
    """
    along = (profile.x - near_x) * outward
    used = (along > -INSIDE_COLUMNS) & (along < OUTSIDE_COLUMNS)
    if np.count_nonzero(used & (along < -2)) < 4 or np.count_nonzero(used & (along > 1)) < 3:
        return None
    along, amplitude, headroom = along[used], profile.amplitude[used], profile.headroom[used]
    level, contrast, noise = spread = _spread(along, amplitude, headroom)
    if level <= 0:
        return None

    position, width, outside = _best_edge(along, amplitude, headroom, spread, sigma)
    slope = level * np.exp(-0.5 * ((position - along) / width) ** 2) / (width * math.sqrt(2 * math.pi)) * headroom
    variance = noise**2 + (contrast * level * headroom * _edge(along, position, width)) ** 2
    information = float(np.sum(slope**2 * (1 - outside) ** 2 / variance)) / SPECKLE_COLUMNS
    if information <= 0:
        return None
    speckle = math.sqrt(max(contrast**2 - (noise / level) ** 2, 0.0))
    last = profile.saturated[used][(along > position - 6) & (along < position)]
    saturated = bool(len(last) and np.mean(last) > SATURATED_SHARE)
    if saturated:
        speckle = max(speckle, HIDDEN_SPECKLE)
    return StripeEnd(
        x=near_x + outward * position,
        sigma=math.hypot(1 / math.sqrt(information), GRAIN_FACTOR * speckle * width, SHAPE_SIGMA),
        outside=outside,
        saturated=saturated,
    )


def _spread(
    along: Float64[Array, "n"], amplitude: Float64[Array, "n"], headroom: Float64[Array, "n"]
) -> tuple[float, float, float]:
    """Level of the face's stripe, its relative spread (speckle), and the noise beyond its end."""
    inner = along < -2
    full = amplitude[inner] / np.maximum(headroom[inner], LEAST_HEADROOM)
    level = float(np.median(full))
    contrast = 1.4826 * float(np.median(np.abs(full - level))) / max(level, 1e-9)
    beyond = amplitude[along > 2]
    noise = 1.4826 * float(np.median(np.abs(beyond - np.median(beyond)))) if len(beyond) else 0.0
    return level, max(contrast, 0.01), max(noise, 0.01 * level)


def _edge(along: Float64[Array, "n"], position: float, width: float) -> Float64[Array, "n"]:
    """One inside, nothing outside, an error function between."""
    edge: Float64[Array, "n"] = np.interp((position - along) / width, _STEPS, _NORMAL_CDF)
    return edge


def _best_edge(
    along: Float64[Array, "n"],
    amplitude: Float64[Array, "n"],
    headroom: Float64[Array, "n"],
    spread: tuple[float, float, float],
    sigma: float,
) -> tuple[float, float, float]:
    """Position, width and outside level (as a share of the inside's) of the edge that fits best."""
    positions = np.arange(-SEARCH_COLUMNS, SEARCH_COLUMNS + SEARCH_STEP / 2, SEARCH_STEP)
    least, best = math.inf, (0.0, sigma, 0.0)
    for share in EDGE_WIDTHS:
        width = share * sigma
        edge = np.interp((positions[:, None] - along) / width, _STEPS, _NORMAL_CDF)
        cost, outside = _level_costs(edge, amplitude, headroom, spread)
        k = int(np.argmin(cost))
        if cost[k] < least:
            least, best = float(cost[k]), (_parabola(positions, cost, k), width, float(outside[k]))
    return best


def _level_costs(
    edge: Float64[Array, "position n"],
    amplitude: Float64[Array, "n"],
    headroom: Float64[Array, "n"],
    spread: tuple[float, float, float],
) -> tuple[Float64[Array, "position"], Float64[Array, "position"]]:
    """Minus log likelihood of each edge position with its best levels, and the outside level's share of the inside."""
    start, contrast, noise = spread
    inside, outside = edge * headroom, 1 - edge
    level = np.full(len(edge), start)
    for _ in range(2):
        variance = noise**2 + (contrast * level[:, None] * inside) ** 2
        a = np.sum(inside * inside / variance, axis=-1)
        b = np.sum(inside * outside / variance, axis=-1)
        c = np.sum(outside * outside / variance, axis=-1)
        p = np.sum(inside * amplitude / variance, axis=-1)
        q = np.sum(outside * amplitude / variance, axis=-1)
        determinant = np.maximum(a * c - b * b, 1e-30)
        level = np.maximum((c * p - b * q) / determinant, 1e-6)
        beyond = np.clip((a * q - b * p) / determinant, 0.0, level)
    residual = amplitude - level[:, None] * inside - beyond[:, None] * outside
    cost = 0.5 * np.sum(residual**2 / variance + np.log(variance), axis=-1)
    return cost, beyond / level


def _parabola(positions: Float64[Array, "position"], cost: Float64[Array, "position"], k: int) -> float:
    """The minimum between the positions tried."""
    if not 0 < k < len(positions) - 1:
        return float(positions[k])
    left, middle, right = cost[k - 1 : k + 2]
    bend = left - 2 * middle + right
    shift = 0.5 * (left - right) / bend if bend > 0 else 0.0
    return float(positions[k] + np.clip(shift, -1, 1) * SEARCH_STEP)
