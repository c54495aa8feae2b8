"""Results of a batch are in the order of its inputs for any number of processes."""

import json
import os
from pathlib import Path

import pytest
from study_work import reversed_name

from ringpose.cli.batch import Batch
from ringpose.cli.main import main
from ringpose.errors import DataError


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


def test_tracking_cannot_use_several_processes(carried_data, capsys):
    words = ["detect", "--rig", str(carried_data / "rig_b" / "rig.yaml"), "--track", "--jobs", "2", "x.npz"]

    assert main(words) == 2
    assert "--track" in capsys.readouterr().err
