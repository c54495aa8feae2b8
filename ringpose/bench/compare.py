"""Comparison of two results on the same shots: paired differences with confidence intervals, p-values and verdicts.

Each compared statistic is a function of a mean over shots, such as the RMSE, the root of the mean squared error. Its
loss is zero at best and increases as the result gets worse; the difference between two results is that of their
losses, so that a positive difference is always worse.

The p-value is that of the paired permutation test: if both results are equally good, the two scores of each shot can be
exchanged, so that each of the 2^n ways of exchanging them is as likely as the observed one. The rate of false alarms is
therefore exact for any number of shots, also for the ten of a group, where an inverted bootstrap distribution is too
narrow. Benjamini-Hochberg then corrects for the number of
rows; rows in which so few shots changed that no permutation could be significant do not count (Tarone 1990, Gilbert
2005). The bootstrap interval shows how large a difference is. It decides only for NEES, whose loss falls and rises
with the mean: there the permutation test shows that something changed, and the interval whether it is better or worse.
"""

import math
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import StrEnum
from typing import Any, NamedTuple

import numpy as np

from ringpose.bench.score import Score, Value
from ringpose.bench.summary import grouped
from ringpose.types.arrays import Array, Float64

FALSE_DISCOVERY_RATE = 0.05
"""Maximum expected share of false positives among the rows that are reported as better or worse."""

CONFIDENCE = 0.95
POWER = 0.8
"""Probability that the stated number of needed shots shows the difference."""

PERMUTATIONS = 9999
"""Random permutations for the p-value if there are too many to evaluate all."""

MAX_EXHAUSTIVE = 12
"""Maximum number of changed shots for which all permutations are evaluated."""

RESAMPLES = 1999
"""Resamples of the bootstrap."""

ROUNDING = 1e-6
"""Differences of a score below this share of the mean score are rounding errors and count as unchanged."""

MIN_ERROR = 1e-12
"""Smaller errors are zero (metres, radians)."""

SEED = 20240613


class RowVerdict(StrEnum):
    """Result of comparing B with A in one row."""

    BETTER = "better"
    WORSE = "worse"
    CANNOT_TELL = "cannot tell"
    SAME = "same"
    """No score of any shot changed."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Quantity:
    """A compared quantity: the score of each shot, and the printed statistic and the loss of the mean score."""

    score: Callable[[Score], float | None]
    """None if a shot has none."""
    figure: Callable[[Any], Any]
    """The statistic that is printed, of a mean score; scalars or arrays."""
    loss: Callable[[Any], Any]
    relative: bool = True
    """Whether the tolerance is a share of A's loss; otherwise it is a difference of loss."""
    judged: bool = True
    """Whether a worse row is a failure."""
    monotone: bool = True
    """Whether the loss always increases with the mean score; otherwise the interval must exclude zero as well."""


def _root(mean: Any) -> Any:
    return np.sqrt(np.maximum(mean, 0.0))


def _itself(mean: Any) -> Any:
    return mean


def _squared_error(name: str) -> Quantity:
    return Quantity(
        score=lambda shot: shot.errors[name] ** 2 if name in shot.errors else None, figure=_root, loss=_root
    )


def _typical_error(name: str) -> Quantity:
    return Quantity(
        score=lambda shot: math.log(max(shot.errors[name], MIN_ERROR)) if name in shot.errors else None,
        figure=np.exp,
        loss=np.exp,
    )


def _nees(name: str) -> Quantity:
    """NEES of the errors `name`, compared by the loss |ln NEES|: 2 is as bad as 1/2.

    NEES below 1e-6, as of exact poses, counts as 1e-6.
    """
    return Quantity(
        score=lambda shot: shot.errors.get(name),
        figure=_itself,
        loss=lambda mean: np.abs(np.log(np.maximum(mean, 1e-6))),
        relative=False,
        monotone=False,
    )


ERRORS = ("center_m", "normal_rad", "grasp_m", "radius_inner_m", "radius_outer_m", "velocity_m_s", "rate_rad_s")

COMPARED: Mapping[str, Quantity] = {
    **{name: _squared_error(name) for name in ERRORS},
    "center_typical_m": _typical_error("center_m"),
    "normal_typical_rad": _typical_error("normal_rad"),
    "grasp_typical_m": _typical_error("grasp_m"),
    **{name: _nees(name) for name in ("center_nees", "normal_nees", "velocity_nees")},
    "available": Quantity(
        score=lambda shot: float(shot.status == "ok") if shot.has_target else None,
        figure=_itself,
        loss=lambda mean: 1.0 - mean,
        relative=False,
    ),
    "no_pose": Quantity(
        score=lambda shot: float(shot.status in ("none", "lost")) if shot.has_target else None,
        figure=_itself,
        loss=_itself,
        relative=False,
    ),
    "wrong": Quantity(
        score=lambda shot: float(len(shot.wrong)) if shot.judgements else None,
        figure=_itself,
        loss=_itself,
        relative=False,
    ),
    "latency_s": Quantity(
        score=lambda shot: math.log(shot.latency_s) if shot.latency_s else None,
        figure=np.exp,
        loss=np.exp,
        judged=False,
    ),
}
"""RMSE of the errors, which the largest errors dominate; their geometric mean, to which all shots contribute equally;
mean NEES; shares of the shots with a ring whose status is ok, and of those without a pose; wrong quantities per shot;
geometric mean of the latency, which is comparable only within one run on one machine."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One quantity in one group of shots: A and B, paired by shot."""

    method: str
    """`a -> b` where the methods differ."""
    group: Mapping[str, Value]
    """Empty for all shots."""
    quantity: str
    shots: int
    """Shots in which both results have this quantity."""
    changed: int
    """Shots in which the quantity differs."""
    a: float
    b: float
    """The statistics, in metres, radians, seconds, shares."""
    difference: float
    """Loss of B minus that of A: positive is worse."""
    change: float | None
    """The difference to which the tolerance applies: a share of A's loss (None if only that is zero), or as it is."""
    interval: tuple[float, float] | None
    """95 % confidence interval of the difference, None for a single shot."""
    p_value: float
    p_adjusted: float
    verdict: RowVerdict
    spread: float
    """Standard deviation of one shot's contribution to the difference."""
    shots_needed: int | None
    """For `cannot tell`: number of shots that would show the tolerance, or the observed difference if that is larger;
    None if it cannot be estimated."""
    beyond_tolerance: bool
    """Whether a judged quantity is worse by more than the tolerance."""


Pair = tuple[Score, Score]


def pairs(scores_a: Sequence[Score], scores_b: Sequence[Score]) -> list[tuple[str, list[Pair]]]:
    """Scores of the same shots by method, in the order of A, without shots that are `lost` in both results.

    If each result has one method and they differ, these two are compared; otherwise methods that only one result has
    are left out.
    """
    methods_a, methods_b = ({score.method: None for score in scores} for scores in (scores_a, scores_b))
    compared = {method: (method, method) for method in methods_a if method in methods_b}
    if len(methods_a) == len(methods_b) == 1 and not compared:
        (a,), (b,) = methods_a, methods_b
        compared = {f"{a or '-'} -> {b or '-'}": (a, b)}
    paired = []
    for name, (method_a, method_b) in compared.items():
        of_a = {score.shot: score for score in scores_a if score.method == method_a}
        of_b = {score.shot: score for score in scores_b if score.method == method_b}
        both = [(of_a[shot], of_b[shot]) for shot in of_a if shot in of_b]
        paired.append((name, [(a, b) for a, b in both if not a.status == b.status == "lost"]))
    return paired


def compare(
    paired: Sequence[tuple[str, Sequence[Pair]]], by: Sequence[str], tolerance: float, resamples: int = RESAMPLES
) -> list[Row]:
    """A row for each method, group (and all shots) and quantity that two results have in common.

    `tolerance` is a share of A's loss; for quantities without a scale (logarithm of NEES, shares of shots, wrong
    quantities per shot) it is a difference. With `resamples` 0 the rows have no intervals.
    """
    from scipy.stats import false_discovery_control

    samples = [
        _Sample(method, group, name, *scores)
        for method, members in paired
        for group, of_group in grouped(members, by, lambda pair: pair[0])
        for name, quantity in COMPARED.items()
        if len((scores := paired_scores(of_group, quantity))[0])
    ]
    rows: list[Row] = []
    for decides in (True, False):
        family = [sample for sample in samples if COMPARED[sample.quantity].judged is decides]
        p_values = np.array(
            [permutation_p_value(sample.a, sample.b, COMPARED[sample.quantity].loss) for sample in family]
        )
        testable = np.array([testable_shots(int(np.sum(sample.a != sample.b))) for sample in family], dtype=bool)
        adjusted = np.ones(len(family))
        if testable.any():  # rows of the same shots are positively dependent, for which Benjamini-Hochberg is valid
            adjusted[testable] = false_discovery_control(p_values[testable])
        rows += [
            _row(sample, float(p), float(p_adjusted), max(1, int(testable.sum())), tolerance, resamples)
            for sample, p, p_adjusted in zip(family, p_values, adjusted, strict=True)
        ]
    return rows


class _Sample(NamedTuple):
    """The scores of one row."""

    method: str
    group: Mapping[str, Value]
    quantity: str
    a: Float64[Array, "n"]
    b: Float64[Array, "n"]


def paired_scores(members: Iterable[Pair], quantity: Quantity) -> tuple[Float64[Array, "n"], Float64[Array, "n"]]:
    """The scores of A and B in the shots in which both have one, without differences that are rounding errors."""
    compared = [(quantity.score(a), quantity.score(b)) for a, b in members]
    both = np.array([pair for pair in compared if None not in pair], dtype=np.float64).reshape(-1, 2)
    a, b = both[:, 0], both[:, 1]
    scale = float(np.abs(both).mean()) if len(both) else 0.0
    return a, np.where(np.abs(b - a) <= ROUNDING * scale + MIN_ERROR**2, a, b)


def testable_shots(changed: int) -> bool:
    """Whether this number of changed shots can be significant: the smallest possible p-value is 2^(1 - changed)."""
    return 2.0 ** (1 - changed) <= FALSE_DISCOVERY_RATE


def permutation_p_value(
    a: Float64[Array, "n"], b: Float64[Array, "n"], loss: Callable[[Any], Any], permutations: int = PERMUTATIONS
) -> float:
    """Two-sided p-value of the difference in loss by the paired permutation test: A and B are exchanged within shots.

    All permutations are evaluated if few shots differ; otherwise random ones and the observed one, so that the p-value
    is never too small: by `monte_carlo_test`, since `permutation_test` takes ten times as long to draw them.
    """
    from scipy.stats import monte_carlo_test, permutation_test

    middle, half = 0.5 * (a.mean() + b.mean()), 0.5 * (b - a)[a != b]
    if len(half) < 2:
        return 1.0

    def difference(half: Float64[Array, "*shape n"], axis: int = -1) -> Any:
        moved = half.sum(axis=axis) / len(a)  # to exchange A and B in a shot changes the sign of its half difference
        return np.abs(loss(middle + moved) - loss(middle - moved))

    if len(half) <= MAX_EXHAUSTIVE:
        exact = permutation_test(
            (half,), difference, permutation_type="samples", alternative="greater", vectorized=True
        )
        return float(exact.pvalue)
    generator = np.random.default_rng(SEED)
    test = monte_carlo_test(
        half,
        lambda size: half * generator.choice((-1.0, 1.0), size),
        difference,
        vectorized=True,
        n_resamples=permutations,
        batch=max(1, 4_000_000 // len(half)),
        alternative="greater",
    )
    return float(test.pvalue)


def _row(sample: _Sample, p_value: float, adjusted: float, rows: int, tolerance: float, resamples: int) -> Row:
    quantity, a, b = COMPARED[sample.quantity], sample.a, sample.b
    loss_a, loss_b = float(quantity.loss(a.mean())), float(quantity.loss(b.mean()))
    difference, scale = loss_b - loss_a, loss_a if quantity.relative else 1.0
    interval = bootstrap_interval(a, b, quantity.loss, resamples) if resamples and len(a) > 1 else None
    directed = quantity.monotone or interval is None or interval[0] > 0 or interval[1] < 0
    if not (a != b).any():
        verdict = RowVerdict.SAME
    elif not directed or adjusted >= FALSE_DISCOVERY_RATE or difference == 0:
        verdict = RowVerdict.CANNOT_TELL
    else:
        verdict = RowVerdict.WORSE if difference > 0 else RowVerdict.BETTER
    change = difference / scale if scale > 0 else 0.0 if difference == 0 else None
    spread = shot_spread(a, b, quantity.loss)
    return Row(
        method=sample.method,
        group=sample.group,
        quantity=sample.quantity,
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
        if verdict is RowVerdict.CANNOT_TELL
        else None,
        beyond_tolerance=quantity.judged and verdict is RowVerdict.WORSE and (change is None or change > tolerance),
    )


def bootstrap_interval(
    a: Float64[Array, "n"], b: Float64[Array, "n"], loss: Callable[[Any], Any], resamples: int
) -> tuple[float, float]:
    """95 % bootstrap interval of the difference in loss, resampling shots: BCa, or percentiles if that fails.

    BCa is undefined if all differences are equal, or if all resamples lie on one side.
    """
    from scipy.stats import bootstrap

    if not (a != b).any():
        return 0.0, 0.0

    def difference(a: Float64[Array, "*shape n"], b: Float64[Array, "*shape n"], axis: int = -1) -> Any:
        return loss(b.mean(axis=axis)) - loss(a.mean(axis=axis))

    for method in ("BCa", "percentile"):
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            resampled = bootstrap(
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
        low, high = float(resampled.low), float(resampled.high)
        if math.isfinite(low) and math.isfinite(high):
            break
    return low, high


def shot_spread(a: Float64[Array, "n"], b: Float64[Array, "n"], loss: Callable[[Any], Any]) -> float:
    """Standard deviation of the contribution of one shot to the difference in loss (jackknife pseudo-values).

    Divided by the root of the number of shots it is the standard error of the difference.
    """
    n = len(a)
    if n < 2:
        return 0.0
    left_out = loss((b.sum() - b) / (n - 1)) - loss((a.sum() - a) / (n - 1))
    return float((n - 1) * np.std(left_out, ddof=1))


def shots_needed(spread: float, difference: float, rows: int) -> int | None:
    """Number of shots that show a difference with 80 % probability among this number of rows; None if undetermined.

    n = ((z(1 - q / 2) + z(0.8)) spread / difference)^2 with q = 0.05 / rows, which is conservative
    relative to Benjamini-Hochberg; at least as many as a permutation test needs to reach q, 2^(1 - n) <= q.
    """
    from scipy.special import ndtri

    if spread == 0 or difference == 0:
        return None
    level = FALSE_DISCOVERY_RATE / rows
    wanted = ((ndtri(1 - level / 2) + ndtri(POWER)) * spread / difference) ** 2
    return max(math.ceil(wanted), math.ceil(1 - math.log2(level)))
