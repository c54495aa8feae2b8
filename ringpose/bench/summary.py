"""Scores -> one line a group: how many of each outcome, how large the errors."""

from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ringpose.bench.score import QUANTITIES, Outcome, Score

GroupKey = tuple[str | float | int | bool, ...]

ABSENT = "-"
"""Stands for a group that a shot's truth does not name."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """The size of many errors."""

    count: int
    rmse: float
    median: float
    """Of the sizes."""
    max: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """One group of shots, or all of them, of one method."""

    method: str
    group: Mapping[str, str | float | int | bool]
    """Empty for all shots."""
    shots: int
    outcomes: Mapping[Outcome, int]
    errors: Mapping[str, Spread]
    """By the names of `QUANTITIES`; for the two NEES see `nees`."""
    nees: Mapping[str, float]
    """Mean NEES of centre and normal by degree of freedom, 1 where the covariance is honest."""


def summaries(scores: Sequence[Score], by: Sequence[str]) -> list[Summary]:
    """One for each method and group, sorted, and last for each method one for all its shots."""
    lines = []
    for method in dict.fromkeys(score.method for score in scores):
        own = [score for score in scores if score.method == method]
        keys = sorted({_key(score, by) for score in own}, key=_sortable)
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
        errors={name: spread(all_) for name, all_ in errors.items() if all_ and not name.endswith("_nees")},
        nees={name: float(np.mean(all_)) for name, all_ in errors.items() if all_ and name.endswith("_nees")},
    )


def _members(scores: Iterable[Score], by: Sequence[str], key: GroupKey) -> list[Score]:
    return [score for score in scores if _key(score, by) == key]


def _key(score: Score, by: Sequence[str]) -> GroupKey:
    return tuple(_scalar(score.groups.get(name, ABSENT)) for name in by)


def _scalar(value: object) -> str | float | int | bool:
    return value if isinstance(value, str | float | int) else str(value)


def _sortable(key: GroupKey) -> tuple[tuple[bool, float, str], ...]:
    """Numbers by size, before texts by letter."""
    return tuple((isinstance(part, str), 0.0 if isinstance(part, str) else float(part), str(part)) for part in key)
