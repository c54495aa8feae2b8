"""Limits that are held, and limits that are missed."""

import math

import pytest

from ringpose.bench.score import Judgement, Outcome, Score
from ringpose.bench.summary import error_limits, exceeded_count_limits, exceeded_error_limits, summaries


def scored(light: str, grasp_m: float | None) -> Score:
    return Score(
        shot=light,
        method="paper",
        outcome=Outcome.MISSED if grasp_m is None else Outcome.OK,
        status="none" if grasp_m is None else "ok",
        groups={"light": light},
        errors={} if grasp_m is None else {"grasp_m": grasp_m},
    )


LINES = summaries([scored("dim", 0.001), scored("sun", 0.003), scored("none", None)], ["light"])


@pytest.mark.parametrize(
    ("limits", "messages"),
    [
        ({"grasp_m": 0.0031}, []),
        ({"grasp_m": 0.0025}, ["grasp_m: RMSE 0.003 of light sun (paper) exceeds 0.0025"]),
        ({"normal_rad": 1.0}, ["normal_rad: no shot has such an error, limit 1"]),
    ],
)
def test_each_group_whose_error_exceeds_a_limit_is_named(limits, messages):
    assert exceeded_error_limits(LINES, limits) == messages


def test_missed_shots_are_counted_over_all_groups():
    assert exceeded_count_limits(LINES, missed=1, wrong=0) == []
    assert exceeded_count_limits(LINES, missed=0, wrong=None) == [
        "missed and lost: 1 shots of all shots (paper) exceed 0"
    ]


def test_limits_in_millimetres_and_degrees_are_converted_to_metres_and_radians():
    limits = error_limits(center_mm=2.0, normal_deg=180.0, radius_mm=None, grasp_mm=0.5)

    assert limits == pytest.approx({"center_m": 0.002, "normal_rad": math.pi, "grasp_m": 0.0005})
    assert set(error_limits(None, None, 1.0, None)) == {"radius_inner_m", "radius_outer_m"}


def test_too_many_wrong_quantities_are_counted_over_all_groups():
    wrong = [
        Score(
            shot=shot, method="ml", outcome=Outcome.WRONG, status="ok", judgements=dict.fromkeys(names, Judgement.WRONG)
        )
        for shot, names in {"a": ("center", "normal"), "b": ("grasp",)}.items()
    ]
    lines = summaries(wrong, [])

    assert exceeded_count_limits(lines, missed=None, wrong=3) == []
    assert exceeded_count_limits(lines, missed=None, wrong=2) == ["wrong: 3 quantities of all shots (ml) exceed 2"]
