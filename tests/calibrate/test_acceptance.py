"""Verdicts in files and in lines."""

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
