"""Scores -> one line a group: how many of each outcome, how large the errors, how many quantities are wrong."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ringpose.bench.score import JUDGED, QUANTITIES, WRONG_SIGMAS, Judgement, Outcome, Score

GroupKey = tuple[str | float | int | bool, ...]

ABSENT = "-"
"""Stands for a group that a shot's truth does not name."""

ALLOWANCE = 0.99
"""Share of runs with correct covariances that have no more wrong quantities than allowed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """The size of many errors."""

    count: int
    rmse: float
    median: float
    """Of the sizes."""
    max: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Wrong:
    """The reported quantities of a group of shots, each judged by itself, by the names of `JUDGED`."""

    counts: Mapping[str, Mapping[Judgement, int]]
    gross: int
    """Wrong ones that chance does not explain: beyond 6 standard deviations, a grasp point off the ring, a pose of
    nothing."""

    def count(self, judgement: Judgement) -> int:
        """How many quantities were judged so."""
        return sum(counts[judgement] for counts in self.counts.values())

    @property
    def judged(self) -> int:
        """Quantities that were judged: those with a covariance (of grasp points also those without) and no flag."""
        return self.count(Judgement.CORRECT) + self.count(Judgement.WRONG)

    @property
    def allowed(self) -> int:
        """So many wrong quantities or fewer come by chance, in 99 % of such runs, where all covariances are correct.

        Each of n quantities with k degrees of freedom is wrong by chance with the probability that chi-squared of k
        degrees of freedom exceeds 25: 5.7e-7, 3.7e-6 and 1.5e-5 for 1, 2 and 3. The sum of these binomial counts is
        nearly Poisson, and this is its 99 % quantile.
        """
        from scipy.special import chdtrc, pdtr

        mean = sum(
            (counts[Judgement.CORRECT] + counts[Judgement.WRONG]) * float(chdtrc(JUDGED[name], WRONG_SIGMAS**2))
            for name, counts in self.counts.items()
        )
        allowed = 0
        while pdtr(allowed, mean) < ALLOWANCE:
            allowed += 1
        return allowed

    @property
    def none_wrong(self) -> bool:
        """No more wrong ones than chance allows, and none beyond 6 standard deviations."""
        return self.gross == 0 and self.count(Judgement.WRONG) <= self.allowed


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """One group of shots, or all of them, of one method."""

    method: str
    group: Mapping[str, str | float | int | bool]
    """Empty for all shots."""
    shots: int
    outcomes: Mapping[Outcome, int]
    targets: int
    """Shots in which there is a ring."""
    available: int
    """Of these the ones whose status is `ok`."""
    wrong: Wrong
    errors: Mapping[str, Spread]
    """By the names of `QUANTITIES`; for the two NEES see `nees`."""
    nees: Mapping[str, float]
    """Mean NEES of centre and normal by degree of freedom, 1 where the covariance is honest."""


def summaries(scores: Sequence[Score], by: Sequence[str]) -> list[Summary]:
    """One for each method and group, sorted, and last for each method one for all its shots."""
    lines = []
    for method in dict.fromkeys(score.method for score in scores):
        own = [score for score in scores if score.method == method]
        keys = sorted({group_key(score, by) for score in own}, key=sortable)
        if by:
            lines += [_summary(method, dict(zip(by, key, strict=True)), _members(own, by, key)) for key in keys]
        lines.append(_summary(method, {}, own))
    return lines


def unknown_groups(scores: Sequence[Score], by: Sequence[str]) -> list[str]:
    """Names that no shot's truth has a group of."""
    known = {name for score in scores for name in score.groups}
    return [name for name in by if name not in known]


def spread(errors: Iterable[float]) -> Spread:
    """Root mean square, median and maximum of the sizes of at least one error."""
    sizes = np.abs(np.array(list(errors), dtype=np.float64))
    return Spread(
        count=len(sizes),
        rmse=float(np.sqrt(np.mean(sizes**2))),
        median=float(np.median(sizes)),
        max=float(sizes.max()),
    )


def _summary(method: str, group: Mapping[str, str | float | int | bool], scores: Sequence[Score]) -> Summary:
    outcomes = Counter(score.outcome for score in scores)
    errors = {name: [s.errors[name] for s in scores if name in s.errors] for name in QUANTITIES}
    return Summary(
        method=method,
        group=group,
        shots=len(scores),
        outcomes={outcome: outcomes[outcome] for outcome in Outcome},
        targets=sum(score.has_target for score in scores),
        available=sum(score.has_target and score.status == "ok" for score in scores),
        wrong=wrong_quantities(scores),
        errors={name: spread(all_) for name, all_ in errors.items() if all_ and not name.endswith("_nees")},
        nees={name: float(np.mean(all_)) for name, all_ in errors.items() if all_ and name.endswith("_nees")},
    )


def wrong_quantities(scores: Sequence[Score]) -> Wrong:
    """The judgements of all reported quantities, counted."""
    counts = {name: Counter(s.judgements[name] for s in scores if name in s.judgements) for name in JUDGED}
    return Wrong(
        counts={name: {judgement: counted[judgement] for judgement in Judgement} for name, counted in counts.items()},
        gross=sum(len(score.gross) for score in scores),
    )


def _members(scores: Iterable[Score], by: Sequence[str], key: GroupKey) -> list[Score]:
    return [score for score in scores if group_key(score, by) == key]


def group_key(score: Score, by: Sequence[str]) -> GroupKey:
    """The group of a shot, by the names of groups in its truth."""
    return tuple(_scalar(score.groups.get(name, ABSENT)) for name in by)


def _scalar(value: object) -> str | float | int | bool:
    return value if isinstance(value, str | float | int) else str(value)


def sortable(key: GroupKey) -> tuple[tuple[bool, float, str], ...]:
    """Numbers by size, before texts by letter."""
    return tuple((isinstance(part, str), 0.0 if isinstance(part, str) else float(part), str(part)) for part in key)
