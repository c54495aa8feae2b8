"""Verdicts in the terms of others: integrity, realism of covariances, and static errors as of ASTM E2919.

Integrity is the term of satellite navigation: an error beyond its protection level is *misleading*, a level beyond the
alert limit, or none, makes a line *unavailable* (ringpose-method(7), section 15). Covariances are realistic if the mean
of d^2 / k, d the Mahalanobis distance with k degrees of freedom, and the coverage of their 95 % regions are near 1 and
0.95 (section 10).
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ringpose.bench.score import AXES, JUDGED, PROTECTED, Level, Score
from ringpose.bench.table import number
from ringpose.types.study import Row
from ringpose.types.table import Table

ALERT_LIMIT_M, ALERT_LIMIT_RAD = 0.005, math.radians(3.0)
"""Alert limits of the grasp point and of the normal, as in `examples/controller.py`; the centre has none."""

CONFIDENCE = 0.95

MIN_REALISM, REALISTIC = 30, (0.8, 1.25)
"""Samples from which the mean of d^2 / k is judged, and its bounds ..."""

MIN_COVERAGE, COVERED, REGION = 500, (0.93, 0.97), 0.95
"""... and those from which the coverage of the 95 % region is."""


@dataclass(slots=True, kw_only=True)
class Integrity:
    """Counts of the lines of one kind."""

    lines: int = 0
    """With a ring in view, or with a pose where there is none."""
    available: int = 0
    """With levels of the grasp point and the normal below the alert limits."""
    leveled: dict[str, int] = field(default_factory=lambda: dict.fromkeys(PROTECTED, 0))
    """With a level, by quantity."""
    misleading: dict[str, int] = field(default_factory=lambda: dict.fromkeys(PROTECTED, 0))
    """With an error beyond it."""
    misled: int = 0
    """With any of these."""

    def add(self, levels: Mapping[str, Level]) -> None:
        """Include a line; one without a pose has no levels."""
        self.lines += 1
        limits = dict(zip(PROTECTED[:3], (ALERT_LIMIT_M, ALERT_LIMIT_M, ALERT_LIMIT_RAD), strict=True))
        self.available += all(name in levels and levels[name].level <= limit for name, limit in limits.items())
        for name, each in levels.items():
            self.leveled[name] += math.isfinite(each.level)
            self.misleading[name] += each.is_misleading
        self.misled += any(each.is_misleading for each in levels.values())


def clopper_pearson(events: int, trials: int) -> tuple[float, float]:
    """The exact two-sided 95 % bounds of a probability (Clopper and Pearson 1934); 0 to 1 without trials."""
    from scipy.stats import binomtest

    if not trials:
        return 0.0, 1.0
    bounds = binomtest(events, trials).proportion_ci(CONFIDENCE, method="exact")
    return float(bounds.low), float(bounds.high)


def levels_in(row: Row) -> dict[str, Level]:
    """The levels of a study's row."""
    return {
        name: Level(error=float(error), level=math.inf if (level := row[f"level_{name}"]) is None else float(level))
        for name in PROTECTED
        if (error := row.get(f"error_{name}")) is not None
    }


def integrity_of_scores(scores: Iterable[Score]) -> dict[tuple[str, str], Integrity]:
    """The counts of all scores of each method."""
    counts: dict[tuple[str, str], Integrity] = {}
    for score in scores:
        if score.has_target or score.levels:
            counts.setdefault((score.method, "all"), Integrity()).add(score.levels)
    return counts


@dataclass(frozen=True, slots=True, kw_only=True)
class Occurring:
    """The share of misleading lines where faults occur as often as outside of a study."""

    lines: int
    misled: int
    share: float
    upper: float
    """Its upper bound, one-sided, with the confidence `CONFIDENCE`."""
    uncounted: float
    """Probability of the combinations of faults of which there is no line."""


def occurring(counts: Mapping[str, Integrity], occurrence: Mapping[str, float]) -> Occurring:
    """The sum over the kinds of lines of their probability times their share of misleading ones, and its upper bound.

    A kind is a combination of faults, joined by `+`; faults that `occurrence` does not have count as none. The bound is
    that of directly standardised rates by the gamma distribution (Fay and Feuer, Statistics in Medicine 16, 1997),
    which is that of Clopper and Pearson for a single rare kind.
    """
    from scipy.stats import chi2

    lines: dict[frozenset[str], int] = {}
    misled: dict[frozenset[str], int] = {}
    for kind, each in counts.items():
        faults = frozenset(kind.split("+")) & frozenset(occurrence)
        lines[faults] = lines.get(faults, 0) + each.lines
        misled[faults] = misled.get(faults, 0) + each.misled
    probability = {
        faults: math.prod(p if name in faults else 1.0 - p for name, p in occurrence.items()) for faults in lines
    }
    weights = {faults: probability[faults] / number for faults, number in lines.items() if number}
    largest = max(weights.values(), default=0.0)
    share = math.fsum(weight * misled[faults] for faults, weight in weights.items())
    variance = math.fsum(weight**2 * misled[faults] for faults, weight in weights.items())
    upper = 1.0
    if largest > 0.0:
        mean, spread = share + largest, variance + largest**2
        upper = float(0.5 * spread / mean * chi2.ppf(CONFIDENCE, 2.0 * mean**2 / spread))
    return Occurring(
        lines=sum(lines.values()),
        misled=sum(misled.values()),
        share=share,
        upper=min(upper, 1.0),
        uncounted=max(1.0 - math.fsum(probability[faults] for faults in weights), 0.0),
    )


def occurring_lines(counts: Mapping[tuple[str, str], Integrity], occurrence: Mapping[str, float]) -> list[str]:
    """A sentence for each method."""
    lines = []
    for method in dict.fromkeys(method for method, _ in counts):
        found = occurring({kind: each for (of, kind), each in counts.items() if of == method}, occurrence)
        lines.append(
            f"{method}: {found.share:.1e} of the lines misleading where faults occur as stated, at most "
            f"{found.upper:.1e} ({100 * CONFIDENCE:.0f} %), by {found.misled} of {found.lines}; other combinations of "
            f"faults: {found.uncounted:.1e}"
        )
    return lines


HEADINGS = ("along normal", "radial", "normal", "x", "y", "z")


def integrity_table(counts: Mapping[tuple[str, str], Integrity], heading: str = "lines of") -> Table:
    """For each kind of lines: how many are available, and misleading ones of those with a level, with their bounds."""
    rows = []
    for (method, kind), each in counts.items():
        trials = max(each.leveled.values())
        low, high = clopper_pearson(each.misled, trials)
        rows.append(
            [
                *(method, kind, str(each.lines)),
                f"{100 * each.available / each.lines:.1f}",
                *(f"{each.misleading[name]}/{each.leveled[name]}" for name in PROTECTED),
                f"{each.misled}/{trials}",
                f"{low:.1e} to {high:.1e}",
            ]
        )
    shown = ("method", heading, "lines", "available %", *HEADINGS, "misleading", "95 % bounds")
    return Table(headings=shown, rows=rows)


def realism_table(scores: Sequence[Score]) -> Table:
    """For each method, quantity and axis: the mean of d^2 / k, the coverage of the 95 % region, and the verdict."""
    from scipy.stats import chi2

    rows = []
    freedom = {**JUDGED, **{f"{name}_{axis}": 1 for name, axes in AXES.items() for axis in axes}}
    for method in dict.fromkeys(score.method for score in scores):
        for name, degrees_of_freedom in freedom.items():
            squared = np.array(
                [score.distances[name] ** 2 for score in scores if score.method == method and name in score.distances]
            )
            if not len(squared):
                continue
            mean = float(squared.mean()) / degrees_of_freedom
            coverage = float((squared <= chi2.ppf(REGION, degrees_of_freedom)).mean())
            rows.append(
                [
                    *(method, name, str(len(squared)), f"{mean:.2f}", f"{100 * coverage:.1f}"),
                    _realism(len(squared), mean, coverage),
                ]
            )
    return Table(headings=("method", "quantity", "samples", "d2/k", "in 95 % region", "verdict"), rows=rows)


def _realism(samples: int, mean: float, coverage: float) -> str:
    if samples < MIN_REALISM:
        return "too few samples"
    is_covered = samples < MIN_COVERAGE or COVERED[0] <= coverage <= COVERED[1]
    if REALISTIC[0] <= mean <= REALISTIC[1] and is_covered:
        return "realistic"
    return "pessimistic" if mean < 1.0 else "optimistic"


def verdicts_text(scores: Sequence[Score]) -> str:
    """The tables of integrity, of realistic covariances, and of static errors."""
    tables = {
        "integrity: errors beyond their protection levels, of those with a level": integrity_table(
            integrity_of_scores(scores)
        ),
        "covariance realism": realism_table(scores),
        "static errors, in the terms of ASTM E2919": static_error_table(scores),
    }
    return "\n".join("\n".join([title, *table.lines(left=2), ""]) for title, table in tables.items() if table.rows)


STATIC = {
    "center_m": ("position", "mm", 1e3),
    "grasp_m": ("grasp point", "mm", 1e3),
    "normal_rad": ("orientation", "deg", math.degrees(1.0)),
}
"""Quantities of the table of static errors, with name, unit and factor."""


def static_error_table(scores: Sequence[Score]) -> Table:
    """Errors of static poses in the terms of ASTM E2919-22: mean, standard deviation, percentiles, and maximum.

    Position is that of the ring's centre, orientation that of its normal: the rotation about it is not determined. The
    text of the standard was not at hand; these statistics are those that abstracts and users of it report.
    """
    rows = []
    for method in dict.fromkeys(score.method for score in scores):
        for name, (quantity, unit, factor) in STATIC.items():
            errors = np.array(
                [score.errors[name] for score in scores if score.method == method and name in score.errors]
            )
            if not len(errors):
                continue
            sizes = factor * np.abs(errors)
            spread = float(sizes.std(ddof=1)) if len(sizes) > 1 else math.nan
            figures = (
                float(sizes.mean()),
                spread,
                *np.quantile(sizes, [0.5, 0.95, 0.997]).tolist(),
                float(sizes.max()),
            )
            rows.append([method, f"{quantity} ({unit})", str(len(sizes)), *map(number, figures)])
    headings = ("method", "error of", "samples", "mean", "sd", "50 %", "95 %", "99.7 %", "max")
    return Table(headings=headings, rows=rows)
