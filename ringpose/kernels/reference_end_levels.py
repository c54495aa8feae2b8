"""Readable NumPy twin of what a stripe's brightness about its ends varies by: oracle of the kernel's tests.

N, S and C^2 of ringpose-method(7), section 3, are `Levels.noise`, `Levels.shot` and `Levels.speckle`.
"""

import math
from dataclasses import dataclass

import numpy as np

from ringpose.kernels.reference_profile import Profile, low_roughness
from ringpose.kernels.ring import EndRules
from ringpose.types.arrays import Array, Float64

WINSORISED = 2.5
CLUTTER = 2.5
LEAST_RELATIVE_NOISE = 1e-6
LEAST_SPECKLE = 1e-9
LEAST_ALIKE = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Columns:
    """The columns about an end, outwards; variances are those of amplitudes."""

    along: Float64[Array, "n"]
    amplitude: Float64[Array, "n"]
    room: Float64[Array, "lit=3 n"]
    clipped: bool
    texture: Float64[Array, "n"]
    facet: float
    """How alike what lies beneath neighbouring columns is."""
    saturated: Float64[Array, "n"]
    level: float
    """Of the face's stripe."""
    scatter: float
    """Relative variance of its columns."""
    step: float
    """Half that of their differences."""
    within: float
    """Variance by pixels' noise in the stripe."""
    beyond: float
    """The same beyond the end."""
    clutter: float
    """Variance of the columns beyond."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Levels:
    """What columns vary by."""

    noise: float
    """Beyond the end."""
    shot: float
    """What grows with the light, at the level."""
    speckle: float
    """What grows with its square, at the level."""
    least: float
    """No column weighs as if it had less than this."""

    @property
    def speckle_share(self) -> float:
        """Of what a column on the face weighs by."""
        return self.speckle / (self.speckle + self.shot + self.least)


def columns_about(profile: Profile, near_x: float, outward: int, sigma: float, rules: EndRules) -> Columns | None:
    """What an end is fitted to; None if that is too little or dark."""
    along = (profile.x - near_x) * outward
    used = np.flatnonzero((along > -rules.inside_columns) & (along < rules.outside_columns))[::outward]
    along = along[used]
    if np.count_nonzero(along < -3) < 4 or np.count_nonzero(along > 1) < 3:
        return None
    amplitude, room, rough = profile.amplitude[used], profile.room[:, used], profile.rough[used]
    full = amplitude[along < -2] / np.maximum(room[-1][along < -2], rules.least_headroom)
    level = float(np.median(full))
    if level <= 0:
        return None
    near = rough[(along > 1) & (along <= rules.near_columns)]
    clear = amplitude[(along > 2) & ~(profile.texture[used] > 0)]
    scatter, step = _scatter(full / level - 1)
    return Columns(
        along=along,
        amplitude=amplitude,
        room=room,
        clipped=profile.clipped,
        texture=profile.texture[used],
        facet=math.exp(-2 / (rules.facet_sigmas * sigma)),
        saturated=profile.saturated[used].astype(np.float64),
        level=level,
        scatter=scatter,
        step=step,
        within=profile.gain * float(np.median(rough[along < -3])),
        beyond=max(profile.gain * low_roughness(near), LEAST_RELATIVE_NOISE * level**2),
        clutter=_deviation(clear) ** 2 if len(clear) >= 4 else 0.0,
    )


def _deviation(values: Float64[Array, "n"]) -> float:
    return 1.4826 * float(np.median(np.abs(values - np.median(values))))


def _scatter(full: Float64[Array, "n"]) -> tuple[float, float]:
    """Variance of winsorised values, and half that of their differences."""
    limit = WINSORISED * _deviation(full)
    kept = np.clip(full, -limit, limit)
    return float(np.var(kept, ddof=1)), 0.5 * float(np.mean(np.diff(kept) ** 2))


def share_levels(columns: list[Columns], rules: EndRules) -> tuple[list[Levels], float]:
    """What the columns about each end of an image vary by; how alike neighbours' speckle is."""
    if not columns:
        return [], 0.0
    scatter = float(np.mean([math.log(_relative_scatter(each)) for each in columns]))
    noise = float(np.mean([math.log(each.beyond) for each in columns]))
    levels = [_levels(each, scatter, noise, rules) for each in columns]
    white = [(part.noise + part.shot) / each.level**2 for each, part in zip(columns, levels, strict=True)]
    alike = sum(each.scatter - each.step for each in columns)
    rest = sum(max(each.scatter - own, LEAST_SPECKLE) for each, own in zip(columns, white, strict=True))
    return levels, min(max(alike / rest, 0.0), 0.9)


def _relative_scatter(columns: Columns) -> float:
    return max(columns.scatter, columns.beyond / columns.level**2)


def _levels(columns: Columns, usual_scatter: float, usual_noise: float, rules: EndRules) -> Levels:
    scatter = math.exp(0.5 * (math.log(_relative_scatter(columns)) + usual_scatter)) * columns.level**2
    noise = math.exp(0.5 * (math.log(columns.beyond) + usual_noise))
    noise = columns.clutter if columns.clutter > CLUTTER * noise else noise
    more = max(scatter - noise, 0.0)
    shot = min(more, max(columns.within - noise, 0.0))
    least = max(noise, (rules.least_noise * columns.level) ** 2)
    return Levels(noise=noise, shot=shot, speckle=more - shot, least=least)


def columns_alike(levels: Levels, likeness: float) -> float:
    """Columns that count as one for the light of many, where speckle is so much alike."""
    return 1 + 2 * levels.speckle_share * (likeness + likeness**4 + likeness**9)


def columns_alike_for_width(levels: Levels, likeness: float, width: float) -> float:
    """The same for an edge's width in columns: it changes with that like the derivative of a Gaussian."""
    lag = np.arange(1, 4)
    apart = lag**2 / (4 * width**2)
    alike = float(np.sum(likeness ** (lag**2) * (1 - 2 * apart) * np.exp(-apart)))
    return max(1 + 2 * levels.speckle_share * alike, LEAST_ALIKE)


def share_shown(columns: Columns, lit: Float64[Array, "n"]) -> Float64[Array, "n"]:
    """How much of the stripe columns show, where so much of it is lit; saturation takes little of a faint edge."""
    faint, half, full = columns.room
    rises = np.where(lit < 0.5, faint + (half - faint) * 2 * lit, half + (full - half) * (2 * lit - 1))
    return lit * rises if columns.clipped else lit


def variance_of(columns: Columns, levels: Levels, shown: Float64[Array, "n"]) -> Float64[Array, "n"]:
    """Variance of columns that show so much of the stripe, by which they weigh."""
    return levels.least + columns.texture + shown * (levels.shot + levels.speckle * shown)
