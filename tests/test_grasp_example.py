"""The robot of examples/grasp closes on the ring that the platform shows, by the track of the command."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from ringpose.bench.capture.score import CaptureOutcome, outcome_of
from ringpose.files.records.captures import RECORD

EXAMPLE = Path(__file__).parents[1] / "examples" / "grasp" / "run.sh"
ENVIRONMENT = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


@pytest.mark.slow
def test_the_gripper_closes_on_the_band_of_a_ring_that_is_near(tmp_path):
    words = ["--seed", "2", "--distance-m", "0.28", "--share", "0.4"]

    done = subprocess.run(
        ["sh", EXAMPLE, tmp_path / "out", *words], env=ENVIRONMENT, capture_output=True, text=True, timeout=600
    )

    assert done.returncode == 0, done.stderr
    (line,) = (tmp_path / "out" / "captures.jsonl").read_text().splitlines()
    capture = RECORD.read(json.loads(line), "capture")
    assert capture.capture_probability >= 0.95
    assert outcome_of(capture).outcome is CaptureOutcome.SUCCESS
