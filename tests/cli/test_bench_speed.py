"""`ringpose bench speed`."""

import json
from pathlib import Path

import pytest

from ringpose.cli.main import main

NAMES = [
    "EdgeDrawing",
    "stripes to break points",
    "the same with ring edges",
    "solvePnP",
    "pose, paper",
    "pose, paper-constrained",
    "pose, ml",
    "import numpy, cv2",
    "ringpose pose --help",
    "first pose of a detection",
    "first pose of a shot",
]


pytestmark = pytest.mark.usefixtures("empty_folder")


@pytest.mark.slow
def test_each_time_has_a_ratio_to_its_reference(capsys):
    status = main(["bench", "speed", "--rounds", "1", "--json", "-"])

    times = {row["name"]: row for row in json.loads(capsys.readouterr().out)["times"]}
    assert (status, sorted(times)) == (0, sorted(NAMES))
    for row in times.values():
        assert row["time_s"] == pytest.approx(row["ratio"] * times[row["reference"]]["time_s"], rel=1e-9)


def test_a_folder_of_that_name_can_still_be_given(capsys):
    Path("speed").mkdir()

    status = main(["bench", "./speed"])

    assert status == 66
    assert "speed: is not a data set" in capsys.readouterr().err
