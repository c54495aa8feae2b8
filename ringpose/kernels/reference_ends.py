"""Readable NumPy twin of the kernel that finds where stripes end: the oracle of its tests."""

import math
from typing import NamedTuple

import numpy as np

from ringpose.kernels.reference_end_levels import (
    Columns,
    Levels,
    columns_about,
    columns_alike,
    share_levels,
    share_shown,
    variance_of,
)
from ringpose.kernels.reference_end_places import PLACES, open_steps, variance_over_places
from ringpose.kernels.reference_end_sigmas import edge_variance, lit_share
from ringpose.kernels.reference_end_widths import (
    SHARP,
    WIDTHS,
    Edge,
    Fit,
    Width,
    common_width,
    edge_of_width,
    own_width,
    settled_width,
)
from ringpose.kernels.reference_profile import (
    Image,
    Line,
    distorted_line,
    parabola,
    profile_along,
    reached_x,
    section_sigma,
)
from ringpose.kernels.ring import EndRules, Lens
from ringpose.types.arrays import Array, Float64

MIDDLE = 3
FINE = np.arange(-10, 11) * 0.15


class Draft(NamedTuple):
    """One end in the making."""

    place: tuple[int, int]
    """Numbers of the line and of the side."""
    line: Line
    near_x: float
    sigma: float
    columns: Columns


class Usual(NamedTuple):
    """What all ends of an image say."""

    likeness: float
    width: Width
    bluntness: float


def stripe_ends(
    lit: Image, dark: Image | None, lines: Float64[Array, "track column=5"], lens: Lens, rules: EndRules
) -> Float64[Array, "track end=2 column=10"]:
    """Twin of `ringpose.kernels.ring.stripe_ends`."""
    ends = np.full((len(lines), 2, 10), np.nan)
    drafts: list[Draft] = []
    for number, track in enumerate(lines):
        line = distorted_line(track, lens, lit.shape[1], rules)
        face = line.x[line.on_face]
        if len(face) < 2:
            continue
        sigma = section_sigma(lit, dark, line, rules.saturation_dn)
        profile = profile_along(lit, dark, line, sigma, rules)
        for side, (near_x, outward) in enumerate(((face[0], -1), (face[-1], 1))):
            near = reached_x(profile, float(near_x), outward, rules)
            columns = columns_about(profile, near, outward, sigma, rules)
            ends[number, side, 7], ends[number, side, 9] = sigma, profile.beneath
            if columns is not None:
                drafts.append(Draft((number, side), line, near, sigma, columns))
    levels, likeness = share_levels([draft.columns for draft in drafts], rules)
    fits = [_fit(draft, own) for draft, own in zip(drafts, levels, strict=True)]
    usual = _usual(drafts, levels, fits, likeness, rules)
    for draft, own, fit in zip(drafts, levels, fits, strict=True):
        ends[(*draft.place, slice(9))] = _end(draft, own, fit, usual, rules)
    return ends


def _fit(draft: Draft, levels: Levels) -> Fit:
    """A coarse search at one width, then all widths around what it found, each from where the last one ended."""
    columns, sigma = draft.columns, draft.sigma
    first = np.array([_cost(columns, levels, at, 0.8 * sigma)[0] for at in PLACES])
    start = _coarse_position(columns, levels, 0.8 * sigma, float(PLACES[int(np.argmin(first))]))
    costs, positions, outsides = (np.empty(len(WIDTHS)) for _ in range(3))
    steps = dict.fromkeys(range(len(WIDTHS)), len(FINE) // 2)
    for s in (MIDDLE, *range(MIDDLE - 1, -1, -1), *range(MIDDLE + 1, len(WIDTHS))):
        from_step = steps[s + (s < MIDDLE) - (s > MIDDLE)]
        found = _descended(columns, levels, WIDTHS[s] * sigma, start, from_step)
        costs[s], positions[s], outsides[s], steps[s] = found
    return Fit(cost=costs, position=positions, outside=outsides, first=first)


def _coarse_position(columns: Columns, levels: Levels, width: float, best: float) -> float:
    """Where the edge lies to half a column: the best of whole columns, and the halves beside it."""
    beside = best + np.array([0.0, -0.5, 0.5])
    return float(beside[int(np.argmin([_cost(columns, levels, at, width)[0] for at in beside]))])


def _descended(columns: Columns, levels: Levels, width: float, start: float, k: int) -> tuple[float, float, float, int]:
    """Cost, position, level outside and step of the lowest place downhill from step `k`, then a parabola."""
    found = [_cost(columns, levels, float(start + shift), width) for shift in FINE]
    cost = [each[0] for each in found]
    while (lowest := min((k, k - 1, k + 1), key=lambda j: cost[j] if 0 <= j < len(cost) else math.inf)) != k:
        k = lowest
    shift = parabola(cost[k - 1 : k + 2]) if 0 < k < len(FINE) - 1 else 0.0
    return cost[k], float(start + FINE[k] + 0.15 * shift), found[k][1], k


def _cost(columns: Columns, levels: Levels, position: float, width: float) -> tuple[float, float]:
    """Minus log likelihood of an edge with its best levels, and the outside level's share of the inside."""
    lit = lit_share((position - columns.along) / width)
    inside, outside = share_shown(columns, lit), 1 - lit
    variance = variance_of(columns, levels, inside)
    a, b, c = (float(np.sum(u * v / variance)) for u, v in ((inside, inside), (inside, outside), (outside, outside)))
    p, q = (float(np.sum(u * columns.amplitude / variance)) for u in (inside, outside))
    determinant = max(a * c - b * b, 1e-30)
    within = max((c * p - b * q) / determinant, 1e-6)
    beyond = min(max((a * q - b * p) / determinant, 0.0), within)
    residual = columns.amplitude - within * inside - beyond * outside
    return float(0.5 * np.sum(residual**2 / variance + np.log(variance))), beyond / within


def _excess(columns: Columns, levels: Levels, edge: Edge, fit: Fit) -> dict[float, float]:
    """Minus log likelihoods of an edge elsewhere over that of its place, by steps from it."""
    here = _cost(columns, levels, edge.position, edge.width)[0]
    steps = open_steps(edge, fit.first).tolist()
    return {step: _cost(columns, levels, edge.position + step, edge.width)[0] - here for step in steps}


def _usual(drafts: list[Draft], levels: list[Levels], fits: list[Fit], likeness: float, rules: EndRules) -> Usual:
    """What all ends of an image say of their blur."""
    if not drafts:
        return Usual(likeness, Width(0.0, 0.0), 0.0)
    each = list(zip(drafts, levels, fits, strict=True))
    widths = [own_width(own, fit, draft.sigma, likeness) for draft, own, fit in each]
    gain = sum(float(fit.cost[:SHARP].min() - fit.cost.min()) / columns_alike(own, likeness) for _, own, fit in each)
    return Usual(likeness, common_width(widths, rules), gain)


def _end(draft: Draft, levels: Levels, fit: Fit, usual: Usual, rules: EndRules) -> tuple[float, ...]:
    """x, y, slope, sigma, level outside, share of saturated columns, width, section's sigma, whether blunt."""
    columns, sigma = draft.columns, draft.sigma
    width = settled_width(own_width(levels, fit, sigma, usual.likeness), usual.width, rules)
    edge = edge_of_width(fit, sigma, math.exp(width.logarithm))
    k = int(np.argmin(fit.cost))
    blunt = usual.bluntness > rules.blunt_gain and k >= SHARP - 1
    if blunt:
        edge = Edge(float(fit.position[k]), float(WIDTHS[k] * sigma), float(fit.outside[k]), 0.0)
    square = edge_variance(columns, levels, edge, usual.likeness, width.information, rules)
    square = variance_over_places(columns, levels, edge, square, usual.likeness, _excess(columns, levels, edge, fit))
    if blunt:
        square += edge.width**2
    last = columns.saturated[(columns.along > edge.position - 6) & (columns.along < edge.position)]
    saturated = float(np.mean(last)) if len(last) else 0.0
    x = draft.near_x + (-1, 1)[draft.place[1]] * edge.position
    y, left, right = np.interp([x, x - 0.5, x + 0.5], draft.line.x, draft.line.y)
    place = (x, float(y), float(right - left), math.sqrt(square))
    return (*place, edge.outside, saturated, edge.width, sigma, float(blunt))
