"""Two results on the same shots -> paired differences with intervals, p-values and verdicts.

Every compared figure is a function of a mean over shots, such as the RMSE, the root of the mean squared error. Its
*badness* is zero at best and grows as the result gets worse; the difference of two results is that of their badness,
so that a positive difference is always worse.

The p-value is that of the exchange test (paired permutation test): if both results are equally good, then in each shot
it does not matter which of its two scores belongs to which result, so each of the 2^n ways of exchanging them is as
likely as the one that was seen. This makes the rate of false alarms exact at any number of shots, also at the ten of
a group, where an inverted bootstrap distribution is too narrow. Benjamini-Hochberg then corrects for the number of
rows; rows in which so few shots changed that no exchange could be significant do not count (Tarone 1990, Gilbert
2005). The bootstrap interval shows how large a difference is. It decides only for NEES, whose badness falls and rises
with the mean: there the exchange test shows that something changed, and the interval whether for better or worse.
"""

import math
import warnings
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from functools import lru_cache
from typing import Any

import numpy as np

from ringpose.bench.score import Score
from ringpose.bench.summary import group_key, sortable
from ringpose.types.arrays import Array, Bool, Float64, UInt8

FALSE_DISCOVERY_RATE = 0.05
"""Of the rows that are called better or worse at most this share is so by chance, on average."""

CONFIDENCE = 0.95
POWER = 0.8
"""Probability with which the number of shots that is stated as needed would show the difference."""

EXCHANGES = 9999
"""Random exchanges for the p-value where there are too many to try them all."""

MAX_EXHAUSTIVE = 12
"""Shots with differences up to which all exchanges are tried."""

RESAMPLES = 1999
"""Of the bootstrap."""

ROUNDING = 1e-6
"""Differences of a shot's score below this share of the mean score are rounding: nothing changed."""

MIN_ERROR = 1e-12
"""Smaller errors are zero (metres, radians)."""

SEED = 20240613


class Verdict(StrEnum):
    """What a row says about B, beside A."""

    BETTER = "better"
    WORSE = "worse"
    CANNOT_TELL = "cannot tell"
    SAME = "same"
    """No score of any shot changed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Quantity:
    """What is compared: a score for each shot, and the figure and badness of their mean."""

    score: Callable[[Score], float | None]
    """None where a shot has none."""
    figure: Callable[[Any], Any]
    """What is shown of a mean score; scalars or arrays."""
    badness: Callable[[Any], Any]
    relative: bool = True
    """Whether the tolerance is a share of A's badness; otherwise it is a difference of badness."""
    judged: bool = True
    """Whether a worse row is a failure."""
    monotone: bool = True
    """Whether badness always grows with the mean score; otherwise the interval has to exclude zero as well."""


def _squared_error(name: str) -> Quantity:
    def score(shot: Score) -> float | None:
        return shot.errors[name] ** 2 if name in shot.errors else None

    return Quantity(score=score, figure=_root, badness=_root)


def _typical_error(name: str) -> Quantity:
    def score(shot: Score) -> float | None:
        return math.log(max(shot.errors[name], MIN_ERROR)) if name in shot.errors else None

    return Quantity(score=score, figure=np.exp, badness=np.exp)


def _nees(name: str) -> Quantity:
    def score(shot: Score) -> float | None:
        return shot.errors.get(name)

    return Quantity(score=score, figure=_itself, badness=_log_ratio_to_1, relative=False, monotone=False)


def _root(mean: Any) -> Any:
    return np.sqrt(np.maximum(mean, 0.0))


def _itself(mean: Any) -> Any:
    return mean


def _log_ratio_to_1(mean: Any) -> Any:
    """A NEES of 2 is as bad as one of 1/2; one of less than a millionth, as of an exact pose, counts as that."""
    return np.abs(np.log(np.maximum(mean, 1e-6)))


COMPARED: Mapping[str, Quantity] = {
    "center_m": _squared_error("center_m"),
    "normal_rad": _squared_error("normal_rad"),
    "grasp_m": _squared_error("grasp_m"),
    "radius_inner_m": _squared_error("radius_inner_m"),
    "radius_outer_m": _squared_error("radius_outer_m"),
    "center_typical_m": _typical_error("center_m"),
    "normal_typical_rad": _typical_error("normal_rad"),
    "grasp_typical_m": _typical_error("grasp_m"),
    "center_nees": _nees("center_nees"),
    "normal_nees": _nees("normal_nees"),
    "available": Quantity(
        score=lambda shot: float(shot.status == "ok") if shot.has_target else None,
        figure=_itself,
        badness=lambda mean: 1.0 - mean,
        relative=False,
    ),
    "no_pose": Quantity(
        score=lambda shot: float(shot.status in ("none", "lost")) if shot.has_target else None,
        figure=_itself,
        badness=_itself,
        relative=False,
    ),
    "wrong": Quantity(
        score=lambda shot: float(len(shot.wrong)) if shot.judgements else None,
        figure=_itself,
        badness=_itself,
        relative=False,
    ),
    "latency_s": Quantity(
        score=lambda shot: math.log(shot.latency_s) if shot.latency_s else None,
        figure=np.exp,
        badness=np.exp,
        judged=False,
    ),
}
"""RMSE of the errors, which the largest decide; their geometric mean, which all shots decide alike, near and far;
mean NEES, by how far its logarithm is from 0; share of the shots with a ring whose status is ok,
and of those without a pose; wrong quantities a shot; geometric mean of the time, which only one run on one machine can
compare."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One quantity in one group of shots: A beside B, paired by shot."""

    method: str
    """`a -> b` where the methods differ."""
    group: Mapping[str, str | float | int | bool]
    """Empty for all shots."""
    quantity: str
    shots: int
    """Those in which both results have this quantity."""
    changed: int
    """Of these the ones in which it is not the same."""
    a: float
    b: float
    """The figures, in metres, radians, seconds, shares."""
    difference: float
    """Badness of B less that of A: positive is worse."""
    change: float | None
    """The difference that the tolerance applies to: as a share of A's badness (None where that is zero and B's is
    not), or as it is."""
    interval: tuple[float, float] | None
    """95 % of the difference, None for a single shot."""
    p_value: float
    p_adjusted: float
    verdict: Verdict
    spread: float
    """Standard deviation of one shot's contribution to the difference."""
    shots_needed: int | None
    """Of `cannot tell`: shots that would show the tolerance, or the observed difference if that is larger; None where
    the shots say nothing about that."""
    beyond_tolerance: bool
    """Worse by more than the tolerance, in a quantity that is judged."""


Pair = tuple[Score, Score]


def pairs(scores_a: Sequence[Score], scores_b: Sequence[Score]) -> list[tuple[str, list[Pair]]]:
    """Scores of the same shots by method, in the order of A, without shots that both results lost.

    If each result has one method and they differ, these two are compared; otherwise methods that only one result has
    are left out.
    """
    by_method_a, by_method_b = _by_method(scores_a), _by_method(scores_b)
    if len(by_method_a) == len(by_method_b) == 1:
        (a, of_a), (b, of_b) = *by_method_a.items(), *by_method_b.items()
        return [(a if a == b else f"{a or '-'} -> {b or '-'}", _joined(of_a, of_b))]
    return [
        (method, _joined(by_method_a[method], by_method_b[method])) for method in by_method_a if method in by_method_b
    ]


def _by_method(scores: Iterable[Score]) -> dict[str, dict[str, Score]]:
    found: dict[str, dict[str, Score]] = {}
    for score in scores:
        found.setdefault(score.method, {})[score.shot] = score
    return found


def _joined(scores_a: Mapping[str, Score], scores_b: Mapping[str, Score]) -> list[Pair]:
    both = [(scores_a[shot], scores_b[shot]) for shot in scores_a if shot in scores_b]
    return [(a, b) for a, b in both if not a.status == b.status == "lost"]


def compare(
    paired: Sequence[tuple[str, Sequence[Pair]]], by: Sequence[str], tolerance: float, resamples: int = RESAMPLES
) -> list[Row]:
    """A row for each method, group (and all shots) and quantity that two results have in common.

    `tolerance` is a share of A's badness, or of quantities without a scale (NEES as the logarithm, shares of shots,
    wrong quantities a shot) the difference itself. With `resamples` 0 the rows have no intervals.
    """
    samples = [
        _Sample(method=method, group=group, name=name, a=scores[0], b=scores[1])
        for method, members in paired
        for group, of_group in _groups(members, by)
        for name, quantity in COMPARED.items()
        if len((scores := paired_scores(of_group, quantity))[0])
    ]
    rows: list[Row] = []
    for decides in (True, False):
        family = [sample for sample in samples if COMPARED[sample.name].judged is decides]
        p_values = np.array([exchange_p_value(sample.a, sample.b, COMPARED[sample.name].badness) for sample in family])
        testable = np.array([testable_shots(int(np.sum(sample.a != sample.b))) for sample in family], dtype=bool)
        adjusted = _adjusted(p_values, testable)
        rows += [
            _row(sample, float(p), float(p_adjusted), max(1, int(testable.sum())), tolerance, resamples)
            for sample, p, p_adjusted in zip(family, p_values, adjusted, strict=True)
        ]
    return rows


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Sample:
    """The scores of one row."""

    method: str
    group: Mapping[str, str | float | int | bool]
    name: str
    a: Float64[Array, "n"]
    b: Float64[Array, "n"]


def _groups(
    members: Sequence[Pair], by: Sequence[str]
) -> Iterator[tuple[Mapping[str, str | float | int | bool], Sequence[Pair]]]:
    """The pairs of each group, sorted, then all of them."""
    keys = sorted({group_key(a, by) for a, _ in members}, key=sortable) if by else []
    for key in keys:
        yield dict(zip(by, key, strict=True)), [pair for pair in members if group_key(pair[0], by) == key]
    yield {}, members


def paired_scores(members: Iterable[Pair], quantity: Quantity) -> tuple[Float64[Array, "n"], Float64[Array, "n"]]:
    """The scores of A and B in the shots in which both have one; differences that are rounding are removed."""
    found = [(quantity.score(a), quantity.score(b)) for a, b in members]
    both = np.array([pair for pair in found if None not in pair], dtype=np.float64).reshape(-1, 2)
    a, b = both[:, 0], both[:, 1]
    scale = float(np.abs(both).mean()) if len(both) else 0.0
    return a, np.where(np.abs(b - a) <= ROUNDING * scale + MIN_ERROR**2, a, b)


def testable_shots(changed: int) -> bool:
    """Whether so many shots that changed can give a significant p-value: the least there is is 2^(1 - changed)."""
    return 2.0 ** (1 - changed) <= FALSE_DISCOVERY_RATE


def _adjusted(p_values: Float64[Array, "row"], testable: Bool[Array, "row"]) -> Float64[Array, "row"]:
    """Benjamini-Hochberg's p-values, 1 in rows that cannot be significant.

    Rows that share shots depend on each other positively, which the procedure allows.
    """
    from scipy.stats import false_discovery_control

    adjusted = np.ones(len(p_values))
    if testable.any():
        adjusted[testable] = false_discovery_control(p_values[testable])
    return adjusted


def exchange_p_value(
    a: Float64[Array, "n"], b: Float64[Array, "n"], badness: Callable[[Any], Any], exchanges: int = EXCHANGES
) -> float:
    """Two-sided p-value of the difference in badness under exchange of A and B within shots (paired permutation test).

    All exchanges are tried where few shots differ; otherwise random ones, with the one that was seen counted among
    them, so that the p-value is never too small.
    """
    changed = (b - a)[a != b]
    few = len(changed) <= MAX_EXHAUSTIVE
    packed = _every_exchange(len(changed)) if few else _random_exchanges(len(changed), exchanges)
    parts = np.array_split(packed, len(packed) // 1000 + 1)
    moved = np.concatenate([np.unpackbits(part, axis=1, count=len(changed)) @ changed for part in parts]) / len(a)
    differences = np.abs(badness(b.mean() - moved) - badness(a.mean() + moved))
    observed = float(np.abs(badness(b.mean()) - badness(a.mean())))
    as_large = np.count_nonzero(differences >= observed * (1 - 1e-9) - MIN_ERROR**2)
    return as_large / len(differences) if few else (as_large + 1) / (len(differences) + 1)


def _every_exchange(shots: int) -> UInt8[Array, "exchange byte"]:
    """Which shots are exchanged, a bit each, in each of the 2^n ways."""
    ways = (np.arange(2**shots)[:, None] >> np.arange(shots)) & 1
    return np.packbits(ways.astype(np.uint8), axis=1)


@lru_cache(maxsize=16)
def _random_exchanges(shots: int, exchanges: int) -> UInt8[Array, "exchange byte"]:
    """Rows of one number of shots are exchanged alike; a bit for each shot, 25 MB of 20,000 shots."""
    return np.random.default_rng(SEED).integers(0, 256, size=(exchanges, -(-shots // 8)), dtype=np.uint8)


def _row(sample: _Sample, p_value: float, adjusted: float, rows: int, tolerance: float, resamples: int) -> Row:
    quantity, a, b = COMPARED[sample.name], sample.a, sample.b
    badness_a, badness_b = float(quantity.badness(a.mean())), float(quantity.badness(b.mean()))
    difference, scale = badness_b - badness_a, badness_a if quantity.relative else 1.0
    interval = bootstrap_interval(a, b, quantity.badness, resamples) if resamples and len(a) > 1 else None
    directed = quantity.monotone or interval is None or interval[0] > 0 or interval[1] < 0
    verdict = _verdict(bool((a != b).any()), adjusted if directed else 1.0, difference)
    change = difference / scale if scale > 0 else 0.0 if difference == 0 else None
    spread = shot_spread(a, b, quantity.badness)
    return Row(
        method=sample.method,
        group=sample.group,
        quantity=sample.name,
        shots=len(a),
        changed=int(np.sum(a != b)),
        a=float(quantity.figure(a.mean())),
        b=float(quantity.figure(b.mean())),
        difference=difference,
        change=change,
        interval=interval,
        p_value=p_value,
        p_adjusted=adjusted,
        verdict=verdict,
        spread=spread,
        shots_needed=shots_needed(spread, max(abs(difference), tolerance * scale), rows)
        if verdict is Verdict.CANNOT_TELL
        else None,
        beyond_tolerance=quantity.judged and verdict is Verdict.WORSE and (change is None or change > tolerance),
    )


def _verdict(changed: bool, p_adjusted: float, difference: float) -> Verdict:
    if not changed:
        return Verdict.SAME
    if p_adjusted >= FALSE_DISCOVERY_RATE or difference == 0:
        return Verdict.CANNOT_TELL
    return Verdict.WORSE if difference > 0 else Verdict.BETTER


def bootstrap_interval(
    a: Float64[Array, "n"], b: Float64[Array, "n"], badness: Callable[[Any], Any], resamples: int
) -> tuple[float, float]:
    """95 % bootstrap interval of the difference in badness, resampling shots: BCa, or percentiles where that fails.

    BCa has no value where the scores are degenerate: all differences alike, or all resamples on one side.
    """
    from scipy.stats import bootstrap

    if not (a != b).any():
        return 0.0, 0.0

    def difference(a: Float64[Array, "*shape n"], b: Float64[Array, "*shape n"], axis: int = -1) -> Any:
        return badness(b.mean(axis=axis)) - badness(a.mean(axis=axis))

    for method in ("BCa", "percentile"):
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            found = bootstrap(
                (a, b),
                difference,
                paired=True,
                vectorized=True,
                method=method,
                confidence_level=CONFIDENCE,
                n_resamples=resamples,
                batch=max(1, 4_000_000 // len(a)),
                random_state=np.random.default_rng(SEED),
            ).confidence_interval
        low, high = float(found.low), float(found.high)
        if math.isfinite(low) and math.isfinite(high):
            break
    return low, high


def shot_spread(a: Float64[Array, "n"], b: Float64[Array, "n"], badness: Callable[[Any], Any]) -> float:
    """Standard deviation of what one shot contributes to the difference in badness (the jackknife's pseudo-values).

    Divided by the root of the number of shots it is the standard error of the difference.
    """
    n = len(a)
    if n < 2:
        return 0.0
    left_out = badness((b.sum() - b) / (n - 1)) - badness((a.sum() - a) / (n - 1))
    return float((n - 1) * np.std(left_out, ddof=1))


def shots_needed(spread: float, difference: float, rows: int) -> int | None:
    """Shots that show a difference with 80 % probability among so many rows; None if the spread is zero or unknown.

    n = ((z(1 - q / 2) + z(0.8)) spread / difference)^2 with q = 0.05 / rows, which is on the safe side of
    Benjamini-Hochberg; and no fewer than let an exchange test reach q at all, 2^(1 - n) <= q.
    """
    from scipy.special import ndtri

    if spread == 0 or difference == 0:
        return None
    level = FALSE_DISCOVERY_RATE / rows
    wanted = ((ndtri(1 - level / 2) + ndtri(POWER)) * spread / difference) ** 2
    return max(math.ceil(wanted), math.ceil(1 - math.log2(level)))
