"""The robot of examples/grasp closes on the ring that the platform shows, by the track of the command."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from ringpose.bench.capture.score import CaptureOutcome, outcome_of
from ringpose.cli.main import main
from ringpose.files.records.captures import RECORD

EXAMPLE = Path(__file__).parents[1] / "examples" / "grasp" / "run.sh"
ENVIRONMENT = {**os.environ, "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"}


@pytest.mark.slow
def test_the_gripper_closes_on_the_band_of_a_ring_that_is_near(tmp_path):
    words = ["--seed", "2", "--distance-m", "0.28", "--share", "0.4", "--record"]

    done = subprocess.run(
        ["sh", EXAMPLE, tmp_path / "out", *words], env=ENVIRONMENT, capture_output=True, text=True, timeout=600
    )

    assert done.returncode == 0, done.stderr
    (line,) = (tmp_path / "out" / "captures.jsonl").read_text().splitlines()
    capture = RECORD.read(json.loads(line), "capture")
    assert capture.capture_probability >= 0.95
    assert outcome_of(capture).outcome is CaptureOutcome.SUCCESS
    shown = shown_run(tmp_path / "out", tmp_path / "loop.html")
    off_m = [np.linalg.norm(np.subtract(*centers)) for centers in shown if None not in centers]
    assert len(off_m) > 0.5 * len(shown)
    assert np.median(off_m) < 0.01


def shown_run(folder: Path, page: Path) -> list[tuple]:
    """Centres of the rings of track and truth in the camera frame of each shot, as `ringpose view` shows them."""
    files = {"--rig": "rig.yaml", "--tracks": "tracks.jsonl", "--truth": "truth.jsonl", "--robot-poses": "robot.jsonl"}
    words = [word for option, name in files.items() for word in (option, str(folder / name))]
    assert main(["view", str(folder / "shots"), *words, "--html", str(page), "--quiet"]) == 0
    data = json.loads(re.search(r'type="application/json" id="data">(.*?)</script>', page.read_text(), re.DOTALL)[1])
    return [
        tuple(
            next((each["center_m"] for each in shot["elements"][0]["strokes"] if each["dash"] == dash), None)
            for dash in ("dotted", "dashed")
        )
        for shot in data["shots"]
    ]
