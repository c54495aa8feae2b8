"""Grades from numbers and limits."""

import math

import pytest

from ringpose.types.calibration import Check, Grade, Verdict


def finding(value: float, good: float = 1.0, redo: float = 2.0, advice: str = "") -> Check:
    return Check(name="rms_px", value=value, pass_limit=good, fail_limit=redo, advice=advice)


@pytest.mark.parametrize(
    ("value", "grade"), [(0.5, Grade.GOOD), (1.0, Grade.GOOD), (1.5, Grade.IMPROVABLE), (2.5, Grade.REDO)]
)
def test_less_is_better_where_the_limit_of_good_is_the_smaller(value, grade):
    assert finding(value, 1.0, 2.0).grade is grade


@pytest.mark.parametrize(
    ("value", "grade"), [(2.5, Grade.GOOD), (2.0, Grade.GOOD), (1.5, Grade.IMPROVABLE), (0.5, Grade.REDO)]
)
def test_more_is_better_where_the_limit_of_good_is_the_larger(value, grade):
    assert finding(value, 2.0, 1.0).grade is grade


@pytest.mark.parametrize("redo", [math.inf, -math.inf])
def test_a_number_without_second_limit_never_asks_for_a_new_calibration(redo):
    assert finding(-math.copysign(9e9, -redo), 0.0, redo).grade is Grade.IMPROVABLE


def test_an_unknown_value_is_improvable():
    assert finding(math.nan, 1.0, 2.0).grade is Grade.IMPROVABLE


def test_the_worst_finding_is_the_grade_of_the_whole():
    assert Verdict(findings=(finding(0.0), finding(3.0), finding(1.5))).grade is Grade.REDO


def test_advice_is_given_once_and_of_the_worst_first():
    verdict = Verdict(
        findings=(
            finding(1.5, advice="tilt"),
            finding(0.0, advice="nothing"),
            finding(3.0, advice="light"),
            finding(1.2, advice="tilt"),
        )
    )

    assert verdict.advice == ("light", "tilt")
