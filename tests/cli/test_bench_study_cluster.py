"""A study on a dask cluster: the same results, refused versions, and a scheduler that disappears."""

import csv
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import pytest

import ringpose
from ringpose.cli.main import main
from ringpose.types.study import TIMES

pytest.importorskip("distributed")
pytestmark = pytest.mark.slow

EXAMPLES = Path(__file__).parents[2] / "examples"

STUDY = """\
ringpose: study/1
title: cluster
scene: scene.yaml
level: features
count: 60
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


@pytest.fixture
def cluster(tmp_path):
    """Starts a scheduler and a worker; returns the address and the scheduler's process."""
    processes = []

    def start(module, *words, **environment):
        command = [sys.executable, "-m", "distributed.cli." + module, *words, "--no-dashboard"]
        with (tmp_path / f"{module}.log").open("w") as log:
            processes.append(subprocess.Popen(command, stdout=log, stderr=log, env={**os.environ, **environment}))
        return processes[-1]

    def started(**environment):
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        address = f"tcp://127.0.0.1:{port}"
        scheduler = start("dask_scheduler", "--host", "127.0.0.1", "--port", str(port))
        _wait_for(port)
        start("dask_worker", address, "--nthreads", "1", "--nworkers", "1", **environment)
        return address, scheduler

    yield started
    for process in processes:
        process.kill()
        process.wait()


def _wait_for(port):
    for _ in range(100):
        with socket.socket() as probe:
            if probe.connect_ex(("127.0.0.1", port)) == 0:
                return
        time.sleep(0.1)
    pytest.fail("no scheduler")


def command(output, address):
    words = ["bench", "study", "study.yaml", "--output", output, "--scheduler", address, "--quiet"]
    return [sys.executable, "-c", "from ringpose.cli.main import run; run()", *words]


def rows_in(folder):
    with (folder / "results.csv").open() as stream:
        return [{k: v for k, v in row.items() if k not in TIMES} for row in csv.DictReader(stream)]


def test_a_cluster_gives_the_same_results_even_if_its_scheduler_is_killed(folder, cluster):
    assert main(["bench", "study", "study.yaml", "--output", "whole", "--jobs", "2", "--quiet"]) == 0
    address, scheduler = cluster()
    with subprocess.Popen(command("out", address), stderr=subprocess.PIPE, text=True) as process:
        while not list((folder / "out" / "parts").glob("*.jsonl")) and process.poll() is None:
            time.sleep(0.1)
        scheduler.send_signal(signal.SIGKILL)
        error = process.communicate(timeout=100)[1]
    assert process.returncode == 69, error
    assert "disappeared" in error
    address, _ = cluster()

    done = subprocess.run(command("out", address), capture_output=True, text=True, timeout=200)

    assert done.returncode == 0, done.stderr
    assert rows_in(folder / "out") == rows_in(folder / "whole")


def test_workers_with_another_version_are_refused_with_the_difference(folder, cluster):
    other = folder / "other"
    shutil.copytree(Path(ringpose.__file__).parent, other / "ringpose")
    (other / "ringpose" / "newer.py").write_text("")
    address, _ = cluster(PYTHONPATH=str(other))
    time.sleep(3)

    done = subprocess.run(command("out", address), capture_output=True, text=True, timeout=100)

    assert done.returncode == 65
    assert "code_sha256" in done.stderr


def test_a_scheduler_that_does_not_answer_is_an_absent_device(folder):
    done = subprocess.run(command("out", "tcp://127.0.0.1:9"), capture_output=True, text=True, timeout=100)

    assert done.returncode == 69
    assert "127.0.0.1:9" in done.stderr
