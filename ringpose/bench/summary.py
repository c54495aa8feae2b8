"""Statistics of the scores of each group of shots: outcomes, errors, wrong quantities; and limits on them."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Annotated, TypeVar

import numpy as np

from ringpose.bench.score import JUDGED, QUANTITIES, Judgement, Outcome, Score, Value
from ringpose.types.protection import WRONG_SIGMAS
from ringpose.types.record import Key

_Item = TypeVar("_Item")

Grouped = tuple[Mapping[str, Value], Sequence[_Item]]
"""The values that some items have in common, and these items."""

ABSENT = "-"
"""Printed for a missing value, and the group of a shot whose truth does not contain it."""

ALLOWANCE = 0.99
"""Probability of at most the allowed number of wrong quantities if all covariances are correct."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ErrorStatistics:
    """Statistics of the absolute values of errors."""

    count: Annotated[int, Key("Shots with such an error.", least=1)]
    rmse: Annotated[float, Key("Root mean square.", least=0)]
    median: Annotated[float, Key("Median.", least=0)]
    max: Annotated[float, Key("Largest.", least=0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class WrongQuantities:
    """Judgements of the reported quantities of a group of shots, by the names of `JUDGED`."""

    counts: Mapping[str, Mapping[Judgement, int]]
    gross: Annotated[int, Key("Wrong quantities that chance cannot explain.", least=0)]
    """The number of `Score.gross`."""

    def count(self, judgement: Judgement) -> int:
        """Number of quantities that have the given judgement."""
        return sum(counts[judgement] for counts in self.counts.values())

    @property
    def wrong(self) -> Annotated[int, Key("Number of wrong quantities.", name="count", least=0)]:
        """Number of wrong quantities."""
        return self.count(Judgement.WRONG)

    @property
    def judged(
        self,
    ) -> Annotated[int, Key("Number of quantities without a flag and with a covariance.", after="count", least=0)]:
        """Number of judged quantities: those without a flag and with a covariance (grasp points also without)."""
        return self.count(Judgement.CORRECT) + self.count(Judgement.WRONG)

    @property
    def allowed(
        self,
    ) -> Annotated[int, Key("Wrong quantities of 99 % of runs if all covariances are correct.", after="judged")]:
        """Maximum number of wrong quantities in 99 % of runs if all covariances are correct.

        A quantity with k degrees of freedom is wrong by chance with the probability that chi-squared with k degrees of
        freedom exceeds 25: 5.7e-7, 3.7e-6 and 1.5e-5 for k = 1, 2 and 3. The sum of these binomial counts is nearly
        Poisson-distributed; this is the 99 % quantile.
        """
        from scipy.stats import chi2, poisson

        mean = sum(
            (counts[Judgement.CORRECT] + counts[Judgement.WRONG]) * chi2.sf(WRONG_SIGMAS**2, JUDGED[name])
            for name, counts in self.counts.items()
        )
        return int(poisson.ppf(ALLOWANCE, mean))

    @property
    def none_wrong(
        self,
    ) -> Annotated[bool, Key("Whether there are at most these, and no gross one.", after="gross")]:
        """Whether there are at most the allowed wrong quantities, and no gross one."""
        return self.gross == 0 and self.count(Judgement.WRONG) <= self.allowed

    @property
    def verdict(self) -> str:
        """`none wrong`, `WRONG`, or `nothing judged` where no quantity could be right or wrong."""
        return "WRONG" if not self.none_wrong else "none wrong" if self.judged else "nothing judged"


@dataclass(frozen=True, slots=True, kw_only=True)
class Summary:
    """Figures of a group of shots, or of all of them, by one method."""

    method: Annotated[str, Key("The method; empty if no record names it.", blank=True)]
    group: Annotated[Mapping[str, Value], Key("What the shots have in common; empty for all shots.")]
    shots: Annotated[int, Key("Number of shots.", least=0)]
    outcomes: Annotated[Mapping[Outcome, int], Key("Number of shots by outcome.")]
    targets: Annotated[int, Key("Shots in which there is a ring.", least=0)]
    available: Annotated[int, Key("Shots in which there is a ring and whose status is `ok`.", least=0)]
    wrong: Annotated[WrongQuantities, Key("Quantities that were judged wrong.")]
    errors: Annotated[Mapping[str, ErrorStatistics], Key("Statistics of the absolute values of the errors.")]
    """By the names of `QUANTITIES`; for the NEES see `nees`."""
    nees: Annotated[
        Mapping[str, float],
        Key("Mean NEES divided by the degrees of freedom; 1 if the covariance is correct."),
    ]

    @property
    def quantities(
        self,
    ) -> Annotated[Mapping[str, Mapping[Judgement, int]], Key("Judgements of each quantity.", after="nees")]:
        """The judgements of each quantity that has any."""
        return {name: counts for name, counts in self.wrong.counts.items() if any(counts.values())}


def summaries(scores: Sequence[Score], by: Sequence[str]) -> list[Summary]:
    """For each method a summary of each group, sorted, and last one of all its shots."""
    return [
        _summary(method, group, members)
        for method in dict.fromkeys(score.method for score in scores)
        for group, members in grouped([score for score in scores if score.method == method], by, lambda score: score)
    ]


def grouped(items: Sequence[_Item], by: Sequence[str], score_of: Callable[[_Item], Score]) -> Iterator[Grouped[_Item]]:
    """The items whose scores have the same values of the fields `by`, such as `light`; last, all with an empty group.

    Groups are sorted: numbers by value, then texts. A shot whose truth lacks a field belongs to the group `ABSENT`.
    """
    members: dict[tuple[Value, ...], list[_Item]] = {}
    for item in items if by else ():
        values = (score_of(item).groups.get(name, ABSENT) for name in by)
        key = tuple(value if isinstance(value, str | float | int) else str(value) for value in values)
        members.setdefault(key, []).append(item)
    for key in sorted(members, key=lambda key: [(isinstance(part, str), part) for part in key]):
        yield dict(zip(by, key, strict=True)), members[key]
    yield {}, items


def error_statistics(errors: Iterable[float]) -> ErrorStatistics:
    """Statistics of at least one error."""
    sizes = np.abs(np.array(list(errors), dtype=np.float64))
    return ErrorStatistics(
        count=len(sizes),
        rmse=float(np.sqrt(np.mean(sizes**2))),
        median=float(np.median(sizes)),
        max=float(sizes.max()),
    )


def _summary(method: str, group: Mapping[str, Value], scores: Sequence[Score]) -> Summary:
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
        errors={name: error_statistics(all_) for name, all_ in errors.items() if all_ and not name.endswith("_nees")},
        nees={name: float(np.mean(all_)) for name, all_ in errors.items() if all_ and name.endswith("_nees")},
    )


def wrong_quantities(scores: Sequence[Score]) -> WrongQuantities:
    """Counts of the judgements of all reported quantities."""
    counts = {name: Counter(s.judgements[name] for s in scores if name in s.judgements) for name in JUDGED}
    return WrongQuantities(
        counts={name: {judgement: counted[judgement] for judgement in Judgement} for name, counted in counts.items()},
        gross=sum(len(score.gross) for score in scores),
    )


# Limits


def exceeded_error_limits(summaries: Sequence[Summary], limits: Mapping[str, float | None]) -> list[str]:
    """A message for each group whose RMSE exceeds a limit, and for each limit to which no group has an error.

    `limits`: by the names of `QUANTITIES`, in metres and radians; None for no limit.
    """
    sentences = []
    for name, limit in limits.items():
        if limit is None:
            continue
        held = [line for line in summaries if name in line.errors]
        if not held:
            sentences.append(f"{name}: no shot has such an error, limit {limit:.4g}")
        sentences += [
            f"{name}: RMSE {line.errors[name].rmse:.4g} of {_group(line)} exceeds {limit:.4g}"
            for line in held
            if line.errors[name].rmse > limit
        ]
    return sentences


def exceeded_count_limits(summaries: Sequence[Summary], missed: int | None, wrong: int | None) -> list[str]:
    """A message for each method with more missed and lost shots, or more wrong quantities, than the limits."""
    sentences = []
    for line in (line for line in summaries if not line.group):
        lost = line.outcomes[Outcome.MISSED] + line.outcomes[Outcome.LOST]
        if missed is not None and lost > missed:
            sentences.append(f"missed and lost: {lost} shots of {_group(line)} exceed {missed}")
        off = line.wrong.count(Judgement.WRONG)
        if wrong is not None and off > wrong:
            sentences.append(f"wrong: {off} quantities of {_group(line)} exceed {wrong}")
    return sentences


def _group(line: Summary) -> str:
    named = ", ".join(f"{key} {value}" for key, value in line.group.items()) or "all shots"
    return f"{named} ({line.method})" if line.method else named
