"""A study that is killed, interrupted or out of space has in the end the results of one that was not."""

import errno
import os
import shutil
import signal
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import pytest

from ringpose.cli.main import main

KILLS = 6 * ("worker", "worker", "command") + ("command", "command")
"""What is killed. A shot that kills three workers of one command counts as failed, so that two are killed in turn."""


def children_of(pid: int) -> list[int]:
    """Processes whose parent it is, other than the tracker of shared resources."""
    found = []
    for process in Path("/proc").glob("[0-9]*"):
        try:
            parent = int((process / "stat").read_text().rpartition(")")[2].split()[1])
            if parent == pid and b"spawn_main" in (process / "cmdline").read_bytes():
                found.append(int(process.name))
        except OSError:
            continue
    return found


def children_awaited(process) -> list[int]:
    """The workers of a command; none if it ends before it has any."""
    while process.poll() is None:
        if workers := children_of(process.pid):
            return workers
        time.sleep(0.01)
    return []


@pytest.mark.slow
def test_twenty_kills_of_the_command_and_its_workers_change_nothing(study_folder, study_process, study_rows, rng):
    folder, words = study_folder(count=60), ("--jobs", "2")
    begun_s = time.monotonic()
    with study_process("whole", *words) as process:
        assert process.wait() == 0
    whole_s = time.monotonic() - begun_s
    left = list(KILLS)

    finished = False
    while left or not finished:
        if finished:  # before all kills: it has to compute half of the shots again
            for part in list((folder / "out" / "parts").glob("*.jsonl"))[::2]:
                part.unlink()
        with study_process("out", *words) as process:
            while left:
                time.sleep(float(rng.uniform(0.0, 0.2)) * whole_s)
                victims = [process.pid] if left[0] == "command" else children_awaited(process)
                if process.poll() is not None:
                    break
                with suppress(ProcessLookupError):
                    os.kill(int(rng.choice(victims)), signal.SIGKILL)
                    left.pop(0)
            error = process.communicate()[1]
        finished = process.returncode == 0
        assert finished or process.returncode == -signal.SIGKILL, error

    assert study_rows("out") == study_rows("whole")


def test_after_a_full_disk_the_finished_shots_are_valid_and_the_study_goes_on(
    study_folder, study_rows, monkeypatch, capsys
):
    folder = study_folder(count=2)
    synchronize: Callable[[int], None] = os.fsync

    def full_after_two_parts(handle: int) -> None:
        if len(list((folder / "out" / "parts").glob("*.jsonl"))) >= 2:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        synchronize(handle)

    words = ["bench", "study", "study.yaml", "--quiet", "--jobs", "1", "--output"]
    with monkeypatch.context() as patched:
        patched.setattr("ringpose.bench.study.pipeline.PART_S", (0.0, 0.0))
        patched.setattr(os, "fsync", full_after_two_parts)
        assert main([*words, "out"]) == 74
    assert "free space" in capsys.readouterr().err
    shots = [line for part in (folder / "out" / "parts").iterdir() for line in part.read_text().splitlines()]
    assert len(shots) == 2
    shutil.copytree(folder / "out", folder / "kept")

    assert main([*words, "out"]) == main([*words, "whole"]) == 0

    assert study_rows("out") == study_rows("whole")
    assert all(part.exists() for part in (folder / "out" / "parts" / p.name for p in (folder / "kept/parts").iterdir()))


@pytest.mark.slow
def test_an_interrupt_keeps_what_is_finished_and_ends_with_its_status(study_folder, study_process):
    folder = study_folder(count=100_000)
    with study_process("out", "--jobs", "2") as process:
        while not list((folder / "out" / "parts").glob("*.jsonl")) and process.poll() is None:
            time.sleep(0.01)
        process.send_signal(signal.SIGINT)
        error = process.communicate()[1]

    shots = sum(len(part.read_text().splitlines()) for part in (folder / "out" / "parts").glob("*.jsonl"))
    assert (process.returncode, error) == (130, "")
    assert 0 < shots < 400_000
    assert not (folder / "out" / "results.lock").exists()
