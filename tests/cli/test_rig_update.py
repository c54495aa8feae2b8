"""A rig checked by the records of a stream, and updated by them or by shots of a board."""

import json

import numpy as np
import pytest
import yaml
from plane_views import calibrated
from ring_scenes import make_scene
from ring_streams import measured_stream, moved, poses_before

from ringpose.cli.main import main
from ringpose.files.records import line_of
from ringpose.files.records.poses import pose_record
from ringpose.files.rigs import read_rig, write_rig
from ringpose.geometry.rotations import tilt_basis
from ringpose.types.rig import laser_parameters

TILT_RAD, SHIFT_M, SHOTS = (0.0, 0.004), 0.001, 14


def errors_in_sds(rig, true_rig):
    """Errors of tilts and distance of each light plane in their standard deviations by the rig's covariance."""
    sd = rig.covariance.standard_deviations
    found = []
    for laser, name in enumerate(rig.lasers.names):
        tilts = tilt_basis(rig.lasers.normal[laser]) @ true_rig.lasers.normal[laser]
        shift_m = true_rig.lasers.distance_m[laser] - rig.lasers.distance_m[laser]
        found.append(np.array([*tilts, shift_m]) / [sd[parameter] for parameter in laser_parameters([name])])
    return np.array(found)


@pytest.fixture
def real():
    """A rig whose right plane has moved since the calibration."""
    return moved(make_scene("B").rig, 2, TILT_RAD, SHIFT_M)


@pytest.fixture
def stream(tmp_path, monkeypatch, rng):
    """Writes rig.yaml, and stream.jsonl of shots that a real rig took; with `brief` records without evidence."""
    monkeypatch.chdir(tmp_path)
    write_rig(tmp_path / "rig.yaml", make_scene("B").rig)
    rig = read_rig(tmp_path / "rig.yaml")

    def written(real, shots=SHOTS, brief=False):
        lines, _ = measured_stream(rig, poses_before(real, rng, shots))
        text = "".join(line_of(pose_record(line, brief)) for line in lines)
        (tmp_path / "stream.jsonl").write_text(text)
        return tmp_path

    return written


@pytest.mark.slow
def test_a_recorded_stream_names_the_plane_that_has_moved(stream, real, capsys):
    stream(real)

    status = main(["calibrate-planes", "--check", "rig.yaml", "stream.jsonl"])

    assert status == 3
    contradicted = [text for text in capsys.readouterr().err.splitlines() if "does not hold" in text]
    assert len(contradicted) == 1
    assert "right: " in contradicted[0]


def test_a_recorded_stream_confirms_a_rig_that_holds(stream, capsys):
    stream(make_scene("B").rig)

    assert main(["calibrate-planes", "--check", "rig.yaml", "stream.jsonl"]) == 0
    assert "does not hold" not in capsys.readouterr().err
    assert main(["calibrate-planes", "--update", "rig.yaml", "--output", "new.yaml", "stream.jsonl"]) == 0
    assert "nothing to update" in capsys.readouterr().err


def test_a_plane_that_has_moved_is_estimated_from_a_stream_with_its_covariance(stream, real):
    folder = stream(real)
    records = (folder / "stream.jsonl").read_text().splitlines()
    corrected = [json.loads(text)["priors"]["rig"].get("moved") for text in records]
    assert corrected[0] is None
    assert corrected[-1] is not None  # the stream was measured with two rigs

    status = main(["calibrate-planes", "--update", "rig.yaml", "--output", "new.yaml", "stream.jsonl"])

    assert status == 0
    new = read_rig(folder / "new.yaml")
    assert np.abs(errors_in_sds(new, real)).max() < 4.0
    assert new.covariance.standard_deviations["right.tilt_1"] < 2e-3
    document = yaml.safe_load((folder / "new.yaml").read_text())
    assert {"rig.yaml", "stream.jsonl"} <= set(str(document["provenance"]).replace("'", " ").split())
    assert document["quality"]["updated"][0]["laser"] == "right"


def test_planes_that_have_moved_are_estimated_from_shots_of_a_board(plane_folder, capsys):
    true_rig = read_rig(plane_folder / "camera.yaml")
    write_rig(plane_folder / "moved.yaml", moved(moved(true_rig, 0, TILT_RAD), 2, shift_m=SHIFT_M))

    status = calibrated("--update", "moved.yaml", "--output", "new.yaml", "planes")

    assert status == 0
    updated = yaml.safe_load((plane_folder / "new.yaml").read_text())["quality"]["updated"]
    assert {entry["laser"] for entry in updated} == {"left", "right"}
    new = read_rig(plane_folder / "new.yaml")
    assert np.abs(errors_in_sds(new, true_rig)).max() < 4.0
    assert new.covariance.standard_deviations["left.tilt_1"] < 5e-4


@pytest.mark.parametrize(
    ("words", "status", "named"),
    [
        (["--check", "rig.yaml", "stream.jsonl"], 65, "--brief"),
        (["--check", "other.yaml", "stream.jsonl"], 65, "stream.jsonl:1: is of another rig"),
        (["--check", "rig.yaml", "shot.npz"], 2, "--board"),
        (["--update", "rig.yaml", "stream.jsonl"], 2, "--output"),
        (["--update", "rig.yaml", "--output", "new.yaml", "--camera", "c.yaml", "stream.jsonl"], 2, "--camera"),
        (["--update", "rig.yaml", "--output", "rig.yaml", "--force", "stream.jsonl"], 73, "rig.yaml"),
        (["--check", "rig.yaml", "absent.jsonl"], 66, "absent.jsonl"),
    ],
)
def test_what_a_rig_cannot_be_checked_or_updated_with_is_reported(stream, capsys, words, status, named):
    folder = stream(make_scene("B").rig, shots=1, brief=True)
    write_rig(folder / "other.yaml", make_scene("A").rig)
    (folder / "shot.npz").write_bytes(b"")

    assert main(["calibrate-planes", *words]) == status
    assert named in capsys.readouterr().err
