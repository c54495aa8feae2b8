"""Verdicts in files and in lines."""

import math
from dataclasses import replace

from ringpose.calibrate.acceptance import verdict_lines, verdict_values
from ringpose.types.calibration import Check, Verdict

POOR = Check(
    name="held_out_rms_m", value=4e-4, pass_limit=2e-4, fail_limit=1e-3, advice="add a view at 1 m", place="left"
)
GOOD = Check(name="rms_px", value=0.1, pass_limit=0.3, fail_limit=1.0, advice="focus")


def test_lines_name_the_value_that_is_not_good_and_the_advice():
    assert verdict_lines(Verdict(findings=(GOOD, POOR))) == [
        "verdict: can be improved: left held_out_rms_m 0.0004 (limit 0.0002)",
        "advice: add a view at 1 m",
    ]
    assert verdict_lines(Verdict(findings=(GOOD,))) == ["verdict: good: every number is within its limit"]


def test_a_value_and_its_limit_have_as_many_digits_as_tell_them_apart():
    near = Check(name="distance_ratio", value=1.199996, pass_limit=1.2, fail_limit=-math.inf)
    beyond = Check(name="rms_px", value=1.00003, pass_limit=0.3, fail_limit=1.0)

    (line,) = verdict_lines(Verdict(findings=(near, beyond)))

    assert line == "verdict: redo: rms_px 1.00003 (redo beyond 1); distance_ratio 1.199996 (limit 1.2)"


def test_numbers_that_cause_redo_come_first_with_their_own_limit_then_those_nearest_to_it():
    findings = [
        Check(name="rms_px", value=0.4, pass_limit=0.3, fail_limit=1.0, advice="focus"),
        Check(name="shift_px", value=9.0, pass_limit=1.0, fail_limit=math.inf, advice="add views"),
        replace(POOR, value=9e-4),
        Check(name="views", value=1.0, pass_limit=5.0, fail_limit=2.0, advice="take more views"),
        replace(POOR, place="right", value=3e-3, advice="see the right stripe"),
        Check(name="sd_m", value=math.nan, pass_limit=1.0, fail_limit=2.0, advice="add a third view"),
    ]

    verdict, *advice = verdict_lines(Verdict(findings=tuple(findings)))

    assert verdict == (
        "verdict: redo: right held_out_rms_m 0.003 (redo beyond 0.001); views 1 (redo below 2); "
        "left held_out_rms_m 0.0009 (limit 0.0002); sd_m unknown (limit 1); rms_px 0.4 (limit 0.3); "
        "shift_px 9 (limit 1)"
    )
    assert [line.removeprefix("advice: ") for line in advice] == [
        "see the right stripe", "take more views", "add a view at 1 m", "add a third view", "focus", "add views"
    ]  # fmt: skip


def test_the_file_has_every_value_with_its_limits():
    values = verdict_values(Verdict(findings=(GOOD, POOR)))

    assert values["grade"] == "can be improved"
    assert values["advice"] == ["add a view at 1 m"]
    assert values["findings"][1] == {
        "place": "left",
        "name": "held_out_rms_m",
        "value": 4e-4,
        "good_limit": 2e-4,
        "redo_limit": 1e-3,
        "grade": "can be improved",
    }
