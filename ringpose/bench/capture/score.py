"""The score of runs in which a gripper was guided to the ring: outcomes, shares with their bounds, and claims."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from enum import StrEnum
from math import degrees, hypot, nan

import numpy as np

from ringpose.bench.table import number
from ringpose.geometry.rotations import angle_between
from ringpose.types.capture import CaptureLine
from ringpose.types.study import CAPTURE_LIMITS
from ringpose.types.table import Table

CONFIDENCE = 0.95
"""Confidence of the lower bounds of success shares, one-sided."""

CLAIMED, CLAIM_TEST = 0.95, 0.99
"""Capture probability from which a closing claims to succeed, and confidence with which more misses refute that."""


class CaptureOutcome(StrEnum):
    """What became of a run."""

    SUCCESS = "success"
    MISS = "miss"
    """The gripper closed, but the band was not within its window."""
    NO_CLOSING = "no closing"
    ERROR = "error"
    """The run could not be computed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureScore:
    """Outcome and errors of one run; NaN if the gripper did not close."""

    outcome: CaptureOutcome
    radial_m: float = nan
    tilt_rad: float = nan


def outcome_of(line: CaptureLine) -> CaptureScore:
    """Whether the true ring was within the gripper's window when it closed.

    The error is the distance of the middle between the fingers from the circle in the middle of the true band, and the
    angle between the approach and the opposite of the true normal. Where along the ring it closes does not matter.
    """
    if line.gripper is None or line.ring is None:
        return CaptureScore(outcome=CaptureOutcome.NO_CLOSING)
    gripper, ring = line.gripper, line.ring
    off_m = gripper.grasp_m - ring.center_m
    height_m = float(off_m @ ring.normal)
    across_m = float(np.linalg.norm(off_m - height_m * ring.normal)) - 0.5 * (ring.radius_inner_m + ring.radius_outer_m)
    radial_m, tilt_rad = hypot(across_m, height_m), float(angle_between(-gripper.approach, ring.normal))
    is_within = radial_m <= gripper.radial_m and tilt_rad <= gripper.tilt_rad
    outcome = CaptureOutcome.SUCCESS if is_within else CaptureOutcome.MISS
    return CaptureScore(outcome=outcome, radial_m=radial_m, tilt_rad=tilt_rad)


@dataclass(slots=True)
class CaptureStatistics:
    """Counts and errors of the runs of one cell."""

    outcomes: list[CaptureOutcome] = field(default_factory=list)
    radial_m: list[float] = field(default_factory=list)
    tilt_rad: list[float] = field(default_factory=list)
    closed_s: list[float] = field(default_factory=list)
    claims: list[float] = field(default_factory=list)
    """Capture probabilities above `CLAIMED` ..."""
    claimed_misses: int = 0
    """... and misses among these closings."""

    def add(self, line: CaptureLine) -> None:
        """Count a run."""
        scored = outcome_of(line)
        self.outcomes.append(scored.outcome)
        if scored.outcome is CaptureOutcome.NO_CLOSING:
            return
        self.radial_m.append(scored.radial_m)
        self.tilt_rad.append(scored.tilt_rad)
        self.closed_s.append(line.closed_s)
        if line.capture_probability is not None and line.capture_probability > CLAIMED:
            self.claims.append(line.capture_probability)
            self.claimed_misses += scored.outcome is CaptureOutcome.MISS

    def count(self, outcome: CaptureOutcome) -> int:
        """Number of runs with an outcome."""
        return self.outcomes.count(outcome)

    def share(self, outcome: CaptureOutcome) -> float:
        """Share of the runs with an outcome."""
        return self.count(outcome) / len(self.outcomes) if self.outcomes else nan

    @property
    def success_bound(self) -> float:
        """Lower bound of the share of successes (Clopper and Pearson, 1934), with the confidence `CONFIDENCE`."""
        from scipy.stats import binomtest

        if not self.outcomes:
            return nan
        test = binomtest(self.count(CaptureOutcome.SUCCESS), len(self.outcomes), alternative="greater")
        return float(test.proportion_ci(confidence_level=CONFIDENCE, method="exact").low)

    @property
    def most_misses(self) -> int:
        """Misses among the claimed closings that chance allows: the 99 % quantile for the mean of their claims.

        With the mean of unequal probabilities the binomial is a little wider than the distribution of their sum.
        """
        from scipy.stats import binom

        if not self.claims:
            return 0
        return int(binom.ppf(CLAIM_TEST, len(self.claims), 1.0 - float(np.mean(self.claims))))


Cell = tuple[str, ...]


def statistics_of(lines: Iterable[CaptureLine], by: Sequence[str] = ()) -> dict[tuple[str, Cell], CaptureStatistics]:
    """The statistics by method, and by the texts of some groups."""
    cells: dict[tuple[str, Cell], CaptureStatistics] = {}
    for line in lines:
        key = line.method, tuple(group_text(name, line.groups) for name in by)
        cells.setdefault(key, CaptureStatistics()).add(line)
    return cells


def group_text(name: str, groups: Mapping[str, str | float | int | bool]) -> str:
    """A group's value for a heading."""
    from ringpose.bench.study.table import value_text

    return value_text(name, groups[name]) if name in groups else "-"


HEADINGS = (
    "runs", "success", "miss", "no closing", "success %", "at least %", "error mm", "95 %", "tilt deg", "95 %",
    "time s", "claimed", "missed",
)  # fmt: skip


def capture_table(cells: Mapping[tuple[str, Cell], CaptureStatistics], by: Sequence[str]) -> Table:
    """The table of all cells: median and 95 % quantile of the errors of all closings, lower 95 % bound of success.

    `claimed` are closings with a capture probability above 0.95, `missed` the misses among them.
    """
    rows = []
    for (method, key), each in cells.items():
        success, closed = CaptureOutcome.SUCCESS, bool(each.radial_m)
        rows.append([
            *key, method, str(len(each.outcomes)), str(each.count(success)), str(each.count(CaptureOutcome.MISS)),
            str(each.count(CaptureOutcome.NO_CLOSING)), number(100.0 * each.share(success)),
            number(100.0 * each.success_bound),
            *(number(1e3 * float(np.quantile(each.radial_m, share))) if closed else "-" for share in (0.5, 0.95)),
            *(number(degrees(np.quantile(each.tilt_rad, share))) if closed else "-" for share in (0.5, 0.95)),
            number(float(np.median(each.closed_s))) if closed else "-",
            str(len(each.claims)), f"{each.claimed_misses} of {each.most_misses}",
        ])  # fmt: skip
    return Table(headings=[*by, "method", *HEADINGS], rows=rows)


def captures_text(lines: Sequence[CaptureLine], by: Sequence[str]) -> str:
    """The table by method and groups, and where there are groups that of each method alone."""
    tables = [capture_table(statistics_of(lines, by), by)]
    if by:
        tables.append(capture_table(statistics_of(lines), ()))
    return "\n\n".join("\n".join(table.lines(left=len(by) + 1)) for table in tables) + "\n"


def missed_limits(
    limits: Mapping[str, float | Mapping[str, float]], method: str, lines: Iterable[CaptureLine], by: Sequence[str]
) -> list[str]:
    """A message for each cell in which a method misses one of `CAPTURE_LIMITS`; without any run, all are missed."""
    cells = {key: each for (of, key), each in statistics_of(lines, by).items() if of == method}
    missed = [] if cells else [f"no run of {method} was computed"]
    for key, each in cells.items():
        place = ", ".join(f"{name} {text}" for name, text in zip(by, key, strict=True)) or "all runs"
        for name, outcome in CAPTURE_LIMITS.items():
            limit, share = limits.get(name), each.share(CaptureOutcome(outcome))
            if not isinstance(limit, float):
                continue
            if share < limit if name.startswith("min_") else share > limit:
                relation = "is below" if name.startswith("min_") else "exceeds"
                missed.append(f"{name}: {outcome} {share:.4g} of {place} ({method}) {relation} {limit:.4g}")
    return missed


def refuted_claims(lines: Iterable[CaptureLine]) -> list[str]:
    """For each method whose claimed closings miss more often than chance allows, a message."""
    return [
        f"{method}: {each.claimed_misses} of {len(each.claims)} closings with a capture probability above {CLAIMED:g} "
        f"missed, at most {each.most_misses} may"
        for (method, _), each in statistics_of(lines).items()
        if each.claimed_misses > each.most_misses
    ]
