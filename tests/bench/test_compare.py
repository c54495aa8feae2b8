"""Two results: what is called better or worse, and how often by chance."""

from itertools import product

import numpy as np
import pytest
import scipy

from ringpose.bench.compare import (
    COMPARED,
    RowVerdict,
    bootstrap_interval,
    compare,
    pairs,
    permutation_p_value,
    shot_spread,
    shots_needed,
)
from ringpose.bench.compare_report import newly_wrong, nothing_changed
from ringpose.bench.score import Judgement, Outcome, Score

RMSE = COMPARED["grasp_m"].loss


def scored(
    shot: str, *, method: str = "ml", status: str = "ok", groups=None, latency_s=None, wrong=(), **errors
) -> Score:
    judgements = {"center": Judgement.CORRECT} | dict.fromkeys(wrong, Judgement.WRONG)
    return Score(
        shot=shot,
        method=method,
        outcome=Outcome.OK,
        status=status,
        groups=groups or {},
        errors=errors,
        judgements=judgements if status in ("ok", "degraded") else {},
        latency_s=latency_s,
    )


def result(rng: np.random.Generator, shots: int = 60, scale: float = 1.0, shared=None, by: int = 2) -> list[Score]:
    """Scores of one run: errors that a part of 80 % of the variance, the shot itself, has in common with other runs."""
    own = rng.normal(size=(shots, 8))
    error = scale * (own if shared is None else np.sqrt(0.8) * shared + np.sqrt(0.2) * own)
    return [
        scored(
            str(n),
            groups={"distance_m": n % by},
            center_m=float(np.linalg.norm(error[n, :3])),
            normal_rad=float(np.linalg.norm(error[n, 3:5])),
            grasp_m=float(abs(error[n, 5])),
            radius_inner_m=float(error[n, 6]),
            radius_outer_m=float(error[n, 7]),
            center_nees=float(np.sum(error[n, :3] ** 2) / 3),
            normal_nees=float(np.sum(error[n, 3:5] ** 2) / 2),
            status="ok" if rng.random() < 0.9 else "degraded",
            latency_s=float(np.exp(rng.normal())),
        )
        for n in range(shots)
    ]


def row_of(rows, quantity, **group):
    return next(row for row in rows if row.quantity == quantity and row.group == group)


def rmse_of_exchanges(a, b, exchanged):
    """The difference in RMSE for each way of exchanging the results within shots, a row of booleans each."""
    ours, theirs = np.where(exchanged, b, a), np.where(exchanged, a, b)
    return np.sqrt(theirs.mean(axis=1)) - np.sqrt(ours.mean(axis=1))


def test_the_p_value_of_few_shots_is_the_share_of_exchanges_with_as_large_a_difference(rng):
    a, b = rng.normal(size=(2, 8)) ** 2 * [[1], [2]]

    every = rmse_of_exchanges(a, b, np.array(list(product((False, True), repeat=8))))

    assert permutation_p_value(a, b, RMSE) == pytest.approx(np.mean(abs(every) >= abs(every[0]) - 1e-12), abs=1e-12)


def test_the_p_value_of_many_shots_is_that_of_random_exchanges(rng):
    a, b = rng.normal(size=(2, 40)) ** 2 * [[1], [2]]

    drawn = rmse_of_exchanges(a, b, rng.random((20_000, 40)) < 0.5)
    observed = rmse_of_exchanges(a, b, np.zeros((1, 40), dtype=bool))

    assert permutation_p_value(a, b, RMSE) == pytest.approx(np.mean(abs(drawn) >= abs(observed)), abs=0.02)


@pytest.mark.parametrize("shots", [40, pytest.param(10, marks=pytest.mark.slow)])
@pytest.mark.parametrize("quantity", ["grasp_m", "center_nees", pytest.param("available", marks=pytest.mark.slow)])
def test_a_row_of_two_equal_results_is_significant_no_more_often_than_it_may_be(rng, shots, quantity):
    draws = 300
    loss = COMPARED[quantity].loss
    scores = rng.random((draws, 2, shots)) < 0.8 if quantity == "available" else rng.chisquare(1, (draws, 2, shots))

    alarms = sum(permutation_p_value(*map(np.asarray, pair), loss, permutations=99) <= 0.05 for pair in scores * 1.0)

    assert alarms <= scipy.stats.binom.ppf(0.999, draws, 0.05)
    if quantity != "available":
        assert alarms >= scipy.stats.binom.ppf(0.001, draws, 0.05)


@pytest.mark.slow
def test_two_equal_results_raise_a_false_alarm_in_no_more_than_5_percent_of_comparisons(rng):
    draws, alarms = 200, 0
    for _ in range(draws):
        shared = rng.normal(size=(60, 8))
        paired = pairs(result(rng, shared=shared), result(rng, shared=shared))
        rows = [row for row in compare(paired, ["distance_m"], 0.0, resamples=0) if row.quantity != "latency_s"]
        alarms += any(row.verdict in (RowVerdict.BETTER, RowVerdict.WORSE) for row in rows)

    assert len(rows) == 3 * 13
    assert alarms <= scipy.stats.binom.ppf(0.99, draws, 0.05)


def test_errors_that_grew_by_10_percent_are_worse_beyond_2_percent_and_not_beyond_20(rng):
    shared = rng.normal(size=(200, 8))
    a, b = result(rng, 200, shared=shared), result(rng, 200, scale=1.1, shared=shared)

    rows, tolerant = (compare(pairs(a, b), [], *options) for options in ((0.02, 99), (0.2, 0)))

    center = row_of(rows, "center_m")
    assert (center.verdict, center.beyond_tolerance) == (RowVerdict.WORSE, True)
    assert center.change == pytest.approx(0.1, abs=0.04)
    assert center.interval[0] < center.difference < center.interval[1]
    assert row_of(tolerant, "center_m").verdict is RowVerdict.WORSE
    assert not row_of(tolerant, "center_m").beyond_tolerance
    assert row_of(compare(pairs(b, a), [], 0.02, resamples=0), "center_m").verdict is RowVerdict.BETTER


def test_the_same_result_twice_or_changed_in_the_last_digits_changes_nothing(rng):
    a = result(rng)
    rounded = [scored(s.shot, status=s.status, **{k: v * (1 + 1e-9) for k, v in s.errors.items()}) for s in a]

    rows = compare(pairs(a, a), ["distance_m"], 0.0)

    assert nothing_changed(rows)
    unchanged = {(row.difference, row.interval, row.p_adjusted, row.shots_needed) for row in rows}
    assert unchanged == {(0.0, (0.0, 0.0), 1.0, None)}
    assert nothing_changed(compare(pairs(a, rounded), [], 0.0, resamples=0))


def test_too_few_shots_are_undecided_with_the_number_that_is_needed(rng):
    a = [scored(str(n), grasp_m=1.0 + 0.1 * n) for n in range(5)]
    b = [scored(str(n), grasp_m=1.3 + 0.1 * n) for n in range(5)]

    row = row_of(compare(pairs(a, b), [], 0.02), "grasp_m")

    assert (row.verdict, row.p_adjusted, row.beyond_tolerance) == (RowVerdict.CANNOT_TELL, 1.0, False)
    assert 6 <= row.shots_needed <= 10


def test_as_many_shots_as_are_stated_show_the_difference_four_times_in_five(rng):
    a, b = rng.normal(size=(2, 4000)) ** 2 * [[1], [1.5]]
    needed = shots_needed(shot_spread(a, b, RMSE), RMSE(1.5) - RMSE(1.0), rows=1)

    drawn = rng.normal(size=(200, 2, needed)) ** 2 * [[1], [1.5]]
    shown = np.mean([permutation_p_value(*pair, RMSE, permutations=199) < 0.05 for pair in drawn])

    assert 0.7 < shown < 0.9


@pytest.mark.parametrize("b", [[2.0, 2.0, 2.0, 2.0], [1.0, 1.0, 1.0, 2.0], [1.0, 2.0]])
def test_degenerate_scores_have_a_finite_interval(b):
    low, high = bootstrap_interval(np.ones(len(b)), np.array(b), RMSE, 199)

    assert 0 <= low <= high < 1


@pytest.mark.slow
def test_the_interval_covers_the_true_difference_in_95_percent_of_results(rng):
    draws = rng.normal(size=(100, 2, 40)) ** 2 * [[1.0], [1.44]]

    intervals = [bootstrap_interval(a, b, RMSE, 199) for a, b in draws]

    assert sum(low <= 0.2 <= high for low, high in intervals) >= scipy.stats.binom.ppf(0.001, 100, 0.92)


def test_a_nees_of_one_half_is_as_bad_as_one_of_two():
    loss = COMPARED["center_nees"].loss

    assert loss(0.5) == pytest.approx(loss(2.0))
    assert loss(1.0) == 0


def test_methods_that_both_results_have_are_compared_each_by_itself(rng):
    a = [scored("a", method="ml"), scored("a", method="paper")]
    b = [scored("a", method="paper"), scored("a", method="ml"), scored("a", method="other")]

    assert [method for method, _ in pairs(a, b)] == ["ml", "paper"]
    assert [method for method, _ in pairs(a[:1], b[:1])] == ["ml -> paper"]


def test_a_line_that_only_b_lost_counts_as_no_pose_and_one_that_both_lost_not_at_all():
    a = [scored(str(n)) for n in range(8)] + [scored("x", status="lost")]
    b = [scored(str(n), status="lost") for n in range(8)] + [scored("x", status="lost")]

    rows = compare(pairs(a, b), [], 0.02, resamples=0)

    assert [(row_of(rows, name).shots, row_of(rows, name).verdict) for name in ("available", "no_pose")] == [
        (8, RowVerdict.WORSE),
        (8, RowVerdict.WORSE),
    ]


def test_a_slower_result_is_reported_and_is_no_failure():
    a = [scored(str(n), latency_s=1.0 + 0.01 * n) for n in range(20)]
    b = [scored(str(n), latency_s=2.0 + 0.01 * n) for n in range(20)]

    rows = compare(pairs(a, b), [], 0.02)

    time = row_of(rows, "latency_s")
    assert (time.verdict, time.beyond_tolerance) == (RowVerdict.WORSE, False)
    assert nothing_changed(rows)


def test_quantities_that_only_b_has_wrong_are_named():
    a = [scored("a", wrong=("center",)), scored("b")]
    b = [scored("a", wrong=("center", "normal")), scored("b", wrong=("grasp",))]

    assert newly_wrong(pairs(a, b)) == [("ml", "a", "normal"), ("ml", "b", "grasp")]


def test_nees_that_passes_from_below_one_to_above_is_neither_better_nor_worse():
    rng = np.random.default_rng(7)
    common = rng.chisquare(3, size=300)
    common /= common.mean()
    before = [scored(str(n), center_nees=float(0.87 * common[n])) for n in range(300)]
    after = [scored(str(n), center_nees=float(1.08 * common[n])) for n in range(300)]

    (row,) = [row for row in compare(pairs(before, after), [], 0.02) if row.quantity == "center_nees"]

    assert (row.verdict, row.p_value < 0.001) == (RowVerdict.CANNOT_TELL, True)
