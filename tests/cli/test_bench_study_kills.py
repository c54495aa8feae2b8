"""A study that is killed again and again has in the end the results of one that was not."""

import csv
import os
import shutil
import signal
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

import pytest

from ringpose.types.study import TIMES

EXAMPLES = Path(__file__).parents[2] / "examples"
KILLS = 20

STUDY = """\
ringpose: study/1
title: killed
scene: scene.yaml
level: features
count: 250
seed: 1
vary: {distance_m: [0.3, 0.5], light: [dim, normal]}
methods: [ml]
"""


@pytest.fixture
def folder(tmp_path, monkeypatch):
    for name in ("scene.yaml", "scene-rig.yaml"):
        shutil.copy(EXAMPLES / name, tmp_path)
    (tmp_path / "study.yaml").write_text(STUDY)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def started(output, *words):
    program = "from ringpose.cli.main import run; run()"
    command = [sys.executable, "-c", program, "bench", "study", "study.yaml", "--output", output, "--quiet", *words]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)


def children_of(pid):
    """Processes whose parent it is."""
    found = []
    for status in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = status.read_text().rpartition(")")[2].split()
        except OSError:
            continue
        if int(fields[1]) == pid:
            found.append(int(status.parent.name))
    return found


def rows_in(folder):
    with (folder / "results.csv").open() as stream:
        return [{k: v for k, v in row.items() if k not in TIMES} for row in csv.DictReader(stream)]


@pytest.mark.slow
def test_twenty_kills_of_the_command_and_its_workers_change_nothing(folder, rng):
    with started("whole", "--jobs", "2") as process:
        assert process.wait() == 0
    kills = {"command": 0, "worker": 0}
    finished = False
    while not finished:
        with started("out", "--jobs", "2") as process:
            while sum(kills.values()) < KILLS and process.poll() is None:
                time.sleep(float(rng.uniform(0.4, 2.0)))
                workers = children_of(process.pid)
                what = "worker" if workers and rng.uniform() < 0.6 else "command"
                victim = int(rng.choice(workers)) if what == "worker" else process.pid
                with suppress(ProcessLookupError):
                    os.kill(victim, signal.SIGKILL)
                    kills[what] += 1
            status = process.wait(timeout=200)
            error = process.stderr.read()
        finished = status == 0
        assert finished or status == -signal.SIGKILL, error

    assert sum(kills.values()) == KILLS
    assert min(kills.values()) > 3
    assert rows_in(folder / "out") == rows_in(folder / "whole")


@pytest.mark.slow
def test_after_a_full_disk_the_finished_shots_are_valid_and_the_study_goes_on(folder):
    program = (
        "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (9000, 9000));"
        "from ringpose.cli.main import run; run()"
    )
    words = ["bench", "study", "study.yaml", "--quiet", "--jobs", "1", "--count", "8", "--output"]
    full = subprocess.run([sys.executable, "-c", program, *words, "out"], capture_output=True, text=True)
    parts = len(list((folder / "out" / "parts").glob("*.jsonl")))
    for output in ("out", "whole"):
        with started(output, "--jobs", "1", "--count", "8") as process:
            assert process.wait() == 0

    assert full.returncode == 74, full.stderr
    assert "free space" in full.stderr
    assert parts > 0
    assert rows_in(folder / "out") == rows_in(folder / "whole")


@pytest.mark.slow
def test_an_interrupt_keeps_what_is_finished_and_ends_with_its_status(folder):
    with started("out", "--jobs", "2", "--count", "100") as process:
        while not list((folder / "out" / "parts").glob("*.jsonl")):
            time.sleep(0.1)
        time.sleep(0.3)
        process.send_signal(signal.SIGINT)
        status = process.wait(timeout=60)
        error = process.stderr.read()

    shots = sum(len(part.read_text().splitlines()) for part in (folder / "out" / "parts").glob("*.jsonl"))
    assert (status, error) == (130, "")
    assert 0 < shots < 400
    assert not (folder / "out" / "results.lock").exists()
