"""Integrity, realism of covariances, and static errors of scores."""

import math

import numpy as np
import pytest
from scipy.stats import beta

from ringpose.bench.integrity import (
    CONFIDENCE,
    Integrity,
    clopper_pearson,
    integrity_of_scores,
    integrity_table,
    occurring,
    occurring_lines,
    realism_table,
    static_error_table,
)
from ringpose.bench.score import PROTECTED, Level, Outcome, Score


def score(**changes) -> Score:
    return Score(**({"shot": "a", "method": "ml", "outcome": Outcome.OK, "status": "ok"} | changes))


def levels(error: float = 0.001, level: float = 0.002, **others: Level) -> dict[str, Level]:
    return {name: Level(error=error, level=level) for name in PROTECTED} | others


def test_an_error_beyond_its_level_is_misleading_and_a_large_level_unavailable():
    counts = Integrity()

    counts.add(levels())
    counts.add(levels(grasp_radial_m=Level(error=0.003, level=0.002)))
    counts.add(levels(grasp_normal_m=Level(error=0.001, level=0.006)))
    counts.add(levels(normal_rad=Level(error=0.5, level=math.inf)))
    counts.add({})  # a line without a pose

    assert (counts.lines, counts.available, counts.misled) == (5, 2, 1)
    assert counts.misleading["grasp_radial_m"] == 1
    assert (counts.leveled["normal_rad"], counts.leveled["grasp_normal_m"]) == (3, 4)


def test_a_pose_where_there_is_no_ring_is_misleading():
    (counts,) = integrity_of_scores([score(has_target=False, levels=levels(error=math.inf))]).values()

    assert counts.misled == 1


@pytest.mark.parametrize(("events", "trials"), [(0, 300), (3, 50), (7, 7)])
def test_bounds_are_those_of_clopper_and_pearson(events, trials):
    low, high = clopper_pearson(events, trials)

    assert low == pytest.approx(beta.ppf(0.025, events, trials - events + 1) if events else 0.0)
    assert high == pytest.approx(beta.ppf(0.975, events + 1, trials - events) if events < trials else 1.0)


def test_nothing_is_known_about_a_share_without_trials():
    assert clopper_pearson(0, 0) == (0.0, 1.0)
    (row,) = integrity_table({("ml", "all"): Integrity(lines=1)}).rows
    assert row[-2:] == ["0/0", "0.0e+00 to 1.0e+00"]


@pytest.mark.parametrize(("misled", "lines"), [(0, 3000), (2, 400), (19, 300_000)])
def test_the_bound_of_a_single_kind_is_that_of_clopper_and_pearson(misled, lines):
    found = occurring({"none": integrity(lines, misled)}, {})

    assert found.share == misled / lines
    assert found.upper == pytest.approx(beta.ppf(CONFIDENCE, misled + 1, lines - misled), rel=0.01)
    assert found.uncounted == 0.0


def test_kinds_count_as_often_as_they_occur():
    counts = {
        "none": integrity(900, 0),
        "tails": integrity(100, 1),
        "end": integrity(200, 4),
        "end+plane": integrity(10, 5),
    }

    found = occurring(counts, {"end": 0.1, "plane": 0.01})

    assert (found.lines, found.misled) == (1210, 10)
    assert found.share == pytest.approx(0.9 * 0.99 * 0.001 + 0.1 * 0.99 * 0.02 + 0.1 * 0.01 * 0.5)
    assert found.upper > found.share
    assert found.uncounted == pytest.approx(0.9 * 0.01)  # a plane alone


def test_the_bound_of_a_sum_is_exceeded_by_the_true_share_as_seldom_as_stated(rng):
    lines, share, occurrence = {"none": 2000, "end": 100}, {"none": 0.001, "end": 0.05}, {"end": 0.02}
    true = 0.98 * share["none"] + 0.02 * share["end"]

    drawn = [
        {kind: integrity(lines[kind], int(rng.binomial(lines[kind], share[kind]))) for kind in lines}
        for _ in range(400)
    ]
    exceeded = sum(true > occurring(counts, occurrence).upper for counts in drawn)

    assert 0 < exceeded <= 400 * (1.0 - CONFIDENCE) + 3 * math.sqrt(400 * CONFIDENCE * (1.0 - CONFIDENCE))


def test_nothing_is_known_about_what_occurs_without_lines():
    assert occurring({}, {"end": 0.1}).upper == 1.0
    (line,) = occurring_lines({("ml", "end"): integrity(10, 0)}, {"end": 0.1})
    assert "by 0 of 10" in line
    assert line.endswith("9.0e-01")


def integrity(lines: int, misled: int) -> Integrity:
    return Integrity(lines=lines, misled=misled)


@pytest.mark.parametrize(
    ("factor", "count", "verdict"),
    [(1.0, 600, "realistic"), (1.3, 600, "optimistic"), (0.7, 600, "pessimistic"), (1.0, 20, "too few samples")],
)
def test_covariances_are_realistic_if_distances_are_those_of_chi_squared(rng, factor, count, verdict):
    distances = factor * np.sqrt(rng.chisquare(3, count))

    (row,) = realism_table([score(distances={"center": float(distance)}) for distance in distances]).rows

    assert row[-1] == verdict


def test_static_errors_have_their_quantiles_in_millimetres():
    scores = [score(errors={"center_m": 0.001 * number}) for number in range(1, 101)]

    (row,) = static_error_table(scores).rows

    assert row[1:] == ["position (mm)", "100", "50.5", "29.0", "50.5", "95.0", "99.7", "100"]
