"""Integrity, realism of covariances, and static errors of scores."""

import math

import numpy as np
import pytest
from scipy.stats import beta

from ringpose.bench.integrity import (
    Integrity,
    clopper_pearson,
    integrity_of_scores,
    integrity_table,
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
