"""`ringpose bench` on data set folders, which it detects and poses itself."""

import json
import os
import shutil
from pathlib import Path

import pytest

from ringpose.cli.main import main

pytestmark = pytest.mark.usefixtures("empty_folder")


@pytest.fixture
def data_set(carried_data) -> Path:
    """Two shots of the carried data."""
    folder = Path("data_set")
    (folder / "shots").mkdir(parents=True)
    shutil.copy(carried_data / "rig_b" / "rig.yaml", folder)
    lines = (carried_data / "rig_b" / "truth.jsonl").read_text().splitlines(keepends=True)
    wanted = [line for line in lines if json.loads(line)["shot"] in ("B_z0500_p01_dim", "V03_occl_B500_dim")]
    (folder / "truth.jsonl").write_text("".join(wanted))
    for line in wanted:
        shutil.copy(carried_data / "rig_b" / "shots" / f"{json.loads(line)['shot']}.npz", folder / "shots")
    return folder


def test_a_data_set_is_measured_by_every_method(data_set, capsys):
    status = main(["bench", str(data_set), "--json", "-"])

    report = json.loads(capsys.readouterr().out)
    assert status == 0
    assert {(shot["method"], shot["shot"], shot["outcome"]) for shot in report["shots"]} == {
        ("ml", "B_z0500_p01_dim", "ok"),
        ("ml", "V03_occl_B500_dim", "partial"),
        ("paper", "B_z0500_p01_dim", "wrong"),
        ("paper", "V03_occl_B500_dim", "wrong"),
        ("paper-detector", "B_z0500_p01_dim", "wrong"),
        ("paper-detector", "V03_occl_B500_dim", "partial_none"),
        ("paper-constrained", "B_z0500_p01_dim", "ok"),
        ("paper-constrained", "V03_occl_B500_dim", "partial"),
    }


def test_a_shot_that_the_data_set_lacks_is_named_and_lost(data_set, capsys):
    (data_set / "shots" / "B_z0500_p01_dim.npz").unlink()

    status = main(["bench", str(data_set), "--method", "paper-constrained", "--json", "-"])

    streams = capsys.readouterr()
    assert status == 66
    assert "B_z0500_p01_dim.npz: does not exist" in streams.err
    shots = json.loads(streams.out)["shots"]
    assert [(shot["method"], shot["outcome"]) for shot in shots] == [
        ("paper-constrained", "lost"),
        ("paper-constrained", "partial"),
    ]


def test_with_another_rig_the_poses_are_worse(data_set, capsys):
    rig = (data_set / "rig.yaml").read_text()
    Path("other.yaml").write_text(rig.replace("-0.070047993855", "-0.0701"))

    figures = []
    for words in ([], ["--rig", "other.yaml"]):
        main(["bench", str(data_set), "--method", "paper-constrained", "--json", "-", *words])
        figures.append(json.loads(capsys.readouterr().out)["groups"][-1]["errors"]["grasp_m"]["rmse"])

    assert figures[1] > 2 * figures[0]


def test_of_a_growing_data_set_only_shots_written_since_a_time_are_measured(data_set, capsys):
    old = data_set / "shots" / "B_z0500_p01_dim.npz"
    os.utime(old, (1e9, 1e9))
    with (data_set / "truth.jsonl").open("a") as stream:
        stream.write(json.dumps({"shot": "not_written_yet", "expect": "no_target"}) + "\n")

    main(["bench", str(data_set), "--method", "ml", "--since", "1h", "--json", "-"])

    assert [shot["shot"] for shot in json.loads(capsys.readouterr().out)["shots"]] == ["V03_occl_B500_dim"]


@pytest.mark.parametrize("name", ["compare", "design", "study"])
def test_a_folder_that_is_called_as_a_command_is_given_with_its_path(name, capsys):
    Path(name).mkdir()

    status = main(["bench", f"./{name}"])

    assert status == 66
    assert f"{name}: is not a data set" in capsys.readouterr().err
