"""A study on a dask cluster: the same results, rejected versions, and a scheduler that disappears."""

import os
import shutil
import socket
import subprocess
import sys
from pathlib import Path

import pytest
from needed import needed_module

import ringpose
from ringpose.cli.main import main

pytestmark = pytest.mark.slow

KILL_AFTER_A_PART = """
import os, signal
from ringpose.files.studies.results import ResultFolder
write = ResultFolder.add
def add(self, shots):
    write(self, shots)
    os.kill({pid}, signal.SIGKILL)
ResultFolder.add = add
"""


@pytest.fixture
def cluster(tmp_path):
    """Starts a scheduler and a worker; returns the address and the scheduler's process."""
    distributed = needed_module("distributed", "ringpose[cluster]")
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
        start("dask_worker", address, "--nthreads", "1", "--nworkers", "1", **environment)
        with distributed.Client(address, timeout="300s", set_as_default=False) as client:
            client.wait_for_workers(1, timeout=300)
        return address, scheduler

    yield started
    for process in processes:
        process.kill()
        process.wait()


def test_a_cluster_gives_the_same_results_even_if_its_scheduler_is_killed(
    study_folder, study_process, study_rows, cluster
):
    study_folder(count=60)
    assert main(["bench", "study", "study.yaml", "--output", "whole", "--jobs", "2", "--quiet"]) == 0
    address, scheduler = cluster()
    before = KILL_AFTER_A_PART.format(pid=scheduler.pid)
    with study_process("out", "--scheduler", address, before=before) as process:
        error = process.communicate()[1]
    assert process.returncode == 69, error
    assert "disappeared" in error
    assert error.count("\n") == 1
    address, _ = cluster()

    with study_process("out", "--scheduler", address) as process:
        error = process.communicate()[1]

    assert process.returncode == 0, error
    assert study_rows("out") == study_rows("whole")


def test_workers_with_another_version_are_rejected_with_the_difference(study_folder, study_process, cluster):
    other = study_folder() / "other"
    shutil.copytree(Path(ringpose.__file__).parent, other / "ringpose")
    (other / "ringpose" / "newer.py").write_text("")
    address, _ = cluster(PYTHONPATH=str(other))

    with study_process("out", "--scheduler", address) as process:
        error = process.communicate()[1]

    assert process.returncode == 65
    assert "code_sha256" in error


def test_a_scheduler_that_does_not_answer_is_an_absent_device(study_folder, capsys, monkeypatch):
    monkeypatch.setattr("ringpose.bench.study.executors.SCHEDULER_S", 1)
    study_folder()

    assert main(["bench", "study", "study.yaml", "--output", "out", "--scheduler", "tcp://127.0.0.1:9"]) == 69
    assert "127.0.0.1:9" in capsys.readouterr().err


@pytest.mark.parametrize(("text", "status"), [(None, 66), ("{}", 65), ('{"address": "tcp:', 65)])
def test_a_scheduler_file_that_is_missing_or_cut_off_is_named(study_folder, capsys, text, status):
    folder = study_folder()
    if text is not None:
        (folder / "scheduler.json").write_text(text)

    assert main(["bench", "study", "study.yaml", "--output", "out", "--scheduler-file", "scheduler.json"]) == status
    assert "scheduler.json" in capsys.readouterr().err
