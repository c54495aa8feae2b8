"""Groups of scores."""

import pytest
import scipy

from ringpose.bench.score import JUDGED, Judgement, Outcome, Score
from ringpose.bench.summary import (
    ABSENT,
    WrongQuantities,
    error_statistics,
    exceeded_error_limits,
    summaries,
)


def scored(
    shot: str, error_m: float | None = None, *, method: str = "paper", **groups: str | float | int | bool
) -> Score:
    return Score(
        shot=shot,
        method=method,
        outcome=Outcome.MISSED if error_m is None else Outcome.OK,
        status="none" if error_m is None else "ok",
        groups=groups,
        errors={} if error_m is None else {"center_x_m": error_m},
    )


def test_the_spread_of_errors_of_both_signs():
    found = error_statistics([3.0, -4.0, 0.0, 12.0])

    assert found.count == 4
    assert found.rmse == 6.5
    assert found.median == 3.5
    assert found.max == 12.0


def test_groups_come_sorted_by_size_and_all_shots_come_last():
    lines = summaries([scored(str(at), 1.0, distance_m=at) for at in (10, 2.5, 0.5, 2.5)], ["distance_m"])

    assert [(line.group.get("distance_m"), line.shots) for line in lines] == [(0.5, 1), (2.5, 2), (10, 1), (None, 4)]


def test_a_group_that_a_truth_does_not_name_is_a_dash():
    shots = [scored("a", 1.0, light="dim"), scored("b", 1.0)]

    assert [line.group.get("light") for line in summaries(shots, ["light"])] == [ABSENT, "dim", None]


def test_failures_do_not_enter_the_errors_and_available_are_the_shots_with_a_ring_that_are_ok():
    common = {"method": "paper", "outcome": Outcome.OK}
    shots = [
        scored("a", 3.0),
        scored("b"),
        scored("c", -3.0),
        Score(shot="d", status="degraded", errors={"center_nees": 0.5}, **common),
        Score(shot="e", status="none", has_target=False, errors={"center_nees": 1.7}, **common),
    ]

    (line,) = summaries(shots, [])

    assert sum(line.outcomes.values()) == line.shots == 5
    assert (line.outcomes[Outcome.OK], line.outcomes[Outcome.MISSED], line.outcomes[Outcome.LOST]) == (4, 1, 0)
    assert (line.available, line.targets) == (2, 4)
    assert {name: (each.count, each.rmse) for name, each in line.errors.items()} == {"center_x_m": (2, 3.0)}
    assert line.nees["center_nees"] == pytest.approx(1.1)  # a mean, not a root


def judged(name: str, correct: int, wrong: int, gross: int = 0) -> list[Score]:
    of = Judgement
    common = {"method": "ml", "outcome": Outcome.OK, "status": "ok"}
    return (
        [Score(shot=f"c{n}", judgements={name: of.CORRECT}, **common) for n in range(correct)]
        + [Score(shot=f"w{n}", judgements={name: of.WRONG}, **common) for n in range(wrong)]
        + [Score(shot=f"g{n}", judgements={name: of.WRONG}, gross=(name,), **common) for n in range(gross)]
    )


def test_quantities_are_counted_by_name_and_judgement():
    (line,) = summaries([*judged("center", 3, 1, 1), *judged("grasp", 2, 0)], [])

    assert (line.wrong.counts["center"][Judgement.WRONG], line.wrong.judged, line.wrong.gross) == (2, 7, 1)


@pytest.mark.parametrize(
    ("name", "n", "allowed"),
    [
        ("center", 600, 0),
        ("center", 700, 1),
        ("center", 100_000, 5),
        ("radius_inner", 17_000, 0),
        ("normal", 100_000, 2),
    ],
)
def test_the_allowance_is_the_binomials_99_percent(name, n, allowed):
    chance = scipy.stats.chi2.sf(25, {"center": 3, "normal": 2, "radius_inner": 1}[name])
    counts = {judged_name: dict.fromkeys(Judgement, 0) for judged_name in JUDGED}
    counts[name][Judgement.CORRECT] = n

    assert WrongQuantities(counts=counts, gross=0).allowed == allowed == scipy.stats.binom.ppf(0.99, n, chance)


def test_none_is_wrong_if_chance_allows_it_and_none_is_gross():
    verdicts = [
        summaries(judged("center", 1000, wrong, gross), [])[0].wrong.none_wrong
        for wrong, gross in [(0, 0), (1, 0), (2, 0), (0, 1)]
    ]

    assert verdicts == [True, True, False, False]


def test_a_limit_to_which_no_shot_has_an_error_is_missed():
    lines = summaries([scored("a", 1.0)], [])

    assert exceeded_error_limits(lines, {"center_x_m": 1.0}) == []
    assert exceeded_error_limits(lines, {"normal_rad": 1.0}) == ["normal_rad: no shot has such an error, limit 1"]
