"""`ringpose bench capture` and studies of captures: statuses, and what is refused."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ringpose.cli.main import main
from ringpose.errors import DataError
from ringpose.files.records import line_of
from ringpose.files.records.captures import RECORD
from ringpose.files.studies.specification import PRESETS, read_study
from ringpose.types.capture import CaptureLine, GripperState, TrueRing


def run(off_m=0.0, light="dark", probability=0.999):
    """A run whose gripper is off the band by this height."""
    ring = TrueRing(center_m=np.zeros(3), normal=np.array([0.0, 0.0, -1.0]), radius_inner_m=0.5, radius_outer_m=0.6)
    gripper = GripperState(grasp_m=np.array([0.55, 0.0, off_m]), approach=np.array([0.0, 0.0, 1.0]))
    return CaptureLine(run="r", method="other", groups={"light": light}, closed_s=9.0, gripper=gripper, ring=ring,
                       capture_probability=probability)  # fmt: skip


@pytest.fixture
def written(tmp_path):
    def write(*runs):
        file = tmp_path / "captures.jsonl"
        file.write_text("".join(line_of(RECORD.write(each)) for each in runs))
        return str(file)

    return write


def test_runs_of_another_program_are_scored_by_their_groups(written, capsys):
    file = written(*[run()] * 5, *[replace(run(0.01, "bright"), capture_probability=None)] * 5)

    assert main(["bench", "capture", file, "--by", "light"]) == 0
    rows = [line.split() for line in capsys.readouterr().out.splitlines()]
    assert ["dark", "other", "5", "5", "0", "0"] in [row[:6] for row in rows]
    assert ["bright", "other", "5", "0", "5", "0"] in [row[:6] for row in rows]


def test_missed_limits_and_refuted_claims_are_status_3(written, capsys):
    assert main(["bench", "capture", written(run(), run(0.01)), "--min-success", "0.9"]) == 3
    assert "min_success_share" in (told := capsys.readouterr().err)
    assert "capture probability above 0.95" in told


@pytest.mark.parametrize(
    ("text", "words", "status", "told"),
    [
        ("", [], 65, "has no run"),
        ("{}", [], 65, "schema"),
        (None, ["--by", "moon"], 2, "moon"),
    ],
)
def test_what_cannot_be_scored_is_refused(written, capsys, text, words, status, told):
    file = written(run())
    if text is not None:
        with open(file, "w") as stream:  # noqa: PTH123
            stream.write(text)

    assert main(["bench", "capture", file, *words]) == status
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        (lambda line: line.update(gripper=None), "gripper and ring"),
        (lambda line: line.update(closed_s=None), "gripper and ring"),
        (lambda line: line.update(closed_s=-3.0), "closed_s"),
        (lambda line: line["gripper"].update(radial_m=0.0), "radial_m"),
        (lambda line: line["ring"].update(radius_inner_m=0.7), "inner radius"),
    ],
)
def test_a_run_that_contradicts_itself_is_refused(written, capsys, changed, told):
    file = Path(written(run()))
    line = json.loads(file.read_text())
    changed(line)
    file.write_text(json.dumps(line))

    assert main(["bench", "capture", str(file)]) == 65
    assert told in capsys.readouterr().err


@pytest.mark.parametrize(
    ("old", "new", "told"),
    [
        ("capture: {gripper_m: [0.0, -0.025, 0.25]}", "", "is of captures"),
        ("  drift_m_s: 0.01", "  rate_sd_rad_s: 0.1", "is not of captures"),
        ("limits: {min_success_share: 0.86, max_miss_share: 0.01}", "limits: {max_center_m: 1}", "is not of captures"),
        ("capture: {gripper_m: [0.0, -0.025, 0.25]}", "capture: {arm: {delay_s: 0.001}}", "delay_s"),
    ],
)
def test_a_study_that_contradicts_itself_is_refused(tmp_path, old, new, told):
    text = (PRESETS / "capture.yaml").read_text()
    assert old in text
    file = tmp_path / "study.yaml"
    file.write_text(text.replace(old, new).replace("scene: ", f"scene: {PRESETS}/").replace("[track]", "[ml]"))

    with pytest.raises(DataError, match=told):
        read_study(file)


def test_a_scene_without_motion_or_mount_has_no_captures(tmp_path):
    text = (PRESETS / "capture-scene.yaml").read_text().replace("rig: ", f"rig: {PRESETS}/")
    (tmp_path / "still.yaml").write_text("".join(line for line in text.splitlines(True) if "motion" not in line))
    file = tmp_path / "study.yaml"
    file.write_text((PRESETS / "capture.yaml").read_text().replace("scene: capture-scene.yaml", "scene: still.yaml"))

    with pytest.raises(DataError, match="free motion"):
        read_study(file)


def test_a_study_of_captures_writes_its_runs_and_no_page(tmp_path, capsys):
    text = (PRESETS / "capture.yaml").read_text().replace("scene: ", f"scene: {PRESETS}/")
    text = text.replace("[0.005236, 0.017453, 0.052360, 0.139626]", "0.01").replace("0.25]}", "0.25], timeout_s: 1.0}")
    file = tmp_path / "study.yaml"
    file.write_text(text)
    words = ["bench", "study", str(file), "-o", str(tmp_path / "out"), "--count", "1", "--jobs", "1"]

    assert main([*words, "--report", str(tmp_path / "page.html")]) == 2
    assert main(words) == 3  # nothing closes within a second
    out, err = capsys.readouterr()
    assert "no closing" in out
    assert "min_success_share" in err
    assert main(["bench", "capture", str(tmp_path / "out" / "captures.jsonl")]) == 0
