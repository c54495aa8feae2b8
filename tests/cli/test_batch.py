"""Results of a batch are in the order of its inputs for any number of processes."""

import json
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import typer
from study_work import reversed_name

from ringpose.cli.batch import Batch
from ringpose.cli.main import main
from ringpose.errors import DataError
from ringpose.files.inputs import Record
from ringpose.files.records import line_of
from ringpose.files.records.detections import detection_record
from ringpose.files.rigs import write_rig
from ringpose.files.scenes.scene import read_scene
from ringpose.geometry.rotations import tilted
from ringpose.simulate.features import drawn_features
from ringpose.types.scene import Approach


def names(count):
    return [Path(f"{number:02d}") for number in range(count)]


@pytest.mark.parametrize("jobs", [1, 3])
def test_results_are_in_order_and_bad_inputs_are_reported(jobs):
    batch = Batch()
    items = names(12)
    items[3], items[5] = Path("bad"), DataError("five", "is missing")

    found = list(batch.results(reversed_name, items, jobs))

    assert found == [item.name[::-1] for item in items if isinstance(item, Path) and item.name != "bad"]
    assert batch.status == 65
    assert len(found) == 10


def test_an_input_that_is_given_twice_is_named_and_processed_again(tmp_path, capsys):
    first, second = tmp_path / "0001.npz", tmp_path / "0002.npz"
    first.write_bytes(b"1")
    second.write_bytes(b"2")
    linked = tmp_path / "newest.npz"
    linked.symlink_to(first)
    batch = Batch()

    given = list(batch.valid_inputs([first, second, first, linked, Record("a.jsonl:1", {}), Record("a.jsonl:1", {})]))
    with pytest.raises(typer.Exit):
        batch.finish()

    assert len(given) == 6
    assert batch.status == 0
    named, counted = capsys.readouterr().err.splitlines()
    assert f"{first}: is given twice" in named
    assert "2 further inputs" in counted


def test_a_file_that_is_written_again_is_another_input(tmp_path, capsys):
    path = tmp_path / "newest.npz"

    def written():
        for number in range(3):
            path.write_bytes(bytes([number]))
            os.utime(path, ns=(number, number))
            yield path

    assert list(Batch().valid_inputs(written())) == [path] * 3
    assert capsys.readouterr().err == ""


@pytest.mark.slow
def test_the_first_result_does_not_wait_for_the_last_input():
    reading, writing = os.pipe()

    def slowly():
        yield from names(2)
        os.read(reading, 1)  # until the first result was seen
        yield from names(3)[2:]

    results = Batch().results(reversed_name, slowly(), 2)

    assert [next(results), next(results)] == ["00", "10"]
    os.write(writing, b"x")
    assert list(results) == ["20"]


def test_an_input_that_kills_its_process_is_reported_alone(capsys):
    batch = Batch()

    found = list(batch.results(reversed_name, [*names(3), Path("fatal"), Path("04")], 2))

    assert found == ["00", "10", "20", "40"]
    assert batch.status == 65
    assert "fatal" in capsys.readouterr().err


def test_an_error_of_the_source_of_inputs_is_raised():
    def broken():
        yield Path("00")
        raise DataError("standard input", "has a line of more than 32 MiB")

    with pytest.raises(DataError, match="32 MiB"):
        list(Batch().results(reversed_name, broken(), 2))


@pytest.mark.slow
def test_detections_by_several_processes_are_those_of_one(carried_data, tmp_path, capsys):
    shots = sorted(str(path) for path in (carried_data / "rig_b" / "shots").glob("*.npz"))[:6]
    lines = []
    for jobs in ("1", "3"):
        assert main(["detect", "--rig", str(carried_data / "rig_b" / "rig.yaml"), "--jobs", jobs, *shots]) in (0, 3)
        lines.append([json.loads(line) for line in capsys.readouterr().out.splitlines()])

    assert len(lines[0]) == len(shots)
    assert lines[0] == lines[1]


@pytest.mark.slow
def test_poses_by_several_processes_are_those_of_one_with_the_health_of_the_rig(tmp_path, capsys):
    scene = read_scene(Path(__file__).parents[2] / "examples" / "scene.yaml")
    approach = Approach(count=12, distances_m=(0.4,), name="s")
    scene = replace(scene, approaches=(approach,), views=(), camera_boards=None, plane_boards=None)
    lasers = scene.rig.lasers
    moved = lasers.normal.copy()
    moved[0] = tilted(moved[0], np.radians([0.3, 0.0]))
    turned = replace(scene, rig=replace(scene.rig, lasers=replace(lasers, normal=moved)))
    lines = [line_of(detection_record(shot.detection)) for shot in drawn_features(turned)]
    (tmp_path / "detections.jsonl").write_text("".join([*lines[:3], "{}\n", *lines[3:]]))
    write_rig(tmp_path / "rig.yaml", scene.rig)

    found = []
    for jobs in ("1", "3"):
        words = ["pose", "--rig", str(tmp_path / "rig.yaml"), "--still", "--jobs", jobs, "--quiet"]
        assert main([*words, str(tmp_path / "detections.jsonl")]) == 65
        out, error = capsys.readouterr()
        assert "detections.jsonl:4" in error
        records = [json.loads(line) for line in out.splitlines()]
        found.append([{**record, "latency_s": 0, "stage_s": {}} for record in records])

    assert len(found[0]) == len(lines)
    assert any("rig_drift" in record["flags"] for record in found[0])
    assert found[0] == found[1]


@pytest.mark.parametrize("words", [["detect", "--track"], ["pose", "--track"]])
def test_tracks_cannot_be_made_by_several_processes(run, rig, words):
    status, _, (message,) = run(*words, "--rig", rig, "--jobs", 2, "x.npz")

    assert status == 2
    assert words[1] in message
