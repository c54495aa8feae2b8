"""`import ringpose`: every name resolves, nothing heavy is imported before, and a notebook's cells run."""

import json
import subprocess
import sys
from inspect import getdoc, isfunction, signature
from pathlib import Path

import numpy as np
import pytest

import ringpose
from ringpose.cli.main import main

ROOT = Path(__file__).parents[1]
SHOTS = ROOT / "tests" / "data" / "rig_b"
NOTEBOOK = ROOT / "examples" / "first_pose.ipynb"
MANUAL = (ROOT / "man" / "ringpose-python.7").read_text()


def test_every_name_is_there_documented_and_in_the_manual():
    assert dir(ringpose) == sorted(ringpose.__all__)
    for name in ringpose.__all__:
        thing = getattr(ringpose, name)
        assert getdoc(thing), name
        assert name in MANUAL, name
        if isfunction(thing):
            assert all(each.annotation is not each.empty for each in signature(thing).parameters.values()), name


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="has no attribute 'nonsense'"):
        ringpose.nonsense  # noqa: B018


def test_nothing_heavy_is_imported_before_it_is_used():
    code = "import sys, ringpose, ringpose.errors; print(*{'numpy', 'cv2', 'ringpose.api'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout == "\n"


def test_a_ring_is_measured_as_the_command_measures_it(capsys):
    shot = min((SHOTS / "shots").iterdir())
    rig = ringpose.read_rig(SHOTS / "rig.yaml")
    line = ringpose.Stream(ringpose.Setup(rig=rig)).measure(ringpose.read_shot(str(shot))).line
    by_itself = ringpose.measure_ring(ringpose.detect_ring(ringpose.read_shot(shot), rig), rig)
    main(["pose", str(shot), "--rig", str(SHOTS / "rig.yaml"), "--no-times"])
    written = json.loads(capsys.readouterr().out)

    assert ringpose.record_of(line.without_times) == written
    assert ringpose.record_of(by_itself.without_times) == {**written, "rig_health": {}}  # that is what a stream shows


def test_lines_of_a_file_are_read_and_a_bad_one_names_its_place(capsys, tmp_path):
    file = tmp_path / "poses.jsonl"
    shot = min((SHOTS / "shots").iterdir())
    main(["pose", str(shot), "--rig", str(SHOTS / "rig.yaml")])
    file.write_text(capsys.readouterr().out + "{}\n")
    lines = ringpose.read_pose_lines(file)

    assert next(lines).shot == shot.stem
    with pytest.raises(ringpose.RingposeError, match=r"poses\.jsonl:2"):
        next(lines)


def test_the_cells_of_the_notebook_run_in_their_order(tmp_path, monkeypatch):
    monkeypatch.chdir(ROOT)
    cells = json.loads(NOTEBOOK.read_text())["cells"]
    assert {cell["cell_type"] for cell in cells} == {"markdown", "code"}
    space = {}
    for cell in cells:
        if cell["cell_type"] == "code":
            assert cell["outputs"] == []
            exec("".join(cell["source"]), space)

    assert space["line"].status == "ok"
    pose, truth = space["line"].pose, space["truth"]
    error_m = pose.center_m - truth.center_m
    assert error_m @ np.linalg.solve(pose.covariance_center_m2, error_m) < 25.0
    assert space["measured"].track.pose is not None
