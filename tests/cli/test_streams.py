"""Pipes and signals, with the command as a process of its own."""

import contextlib
import fcntl
import inspect
import json
import os
import pty
import re
import signal
import termios
from pathlib import Path

import cv2
import numpy as np
import pytest
from guarded_lasers import wait_for
from needed import needed_module

from ringpose.files.npz import Archive
from ringpose.files.records.detections import detection_in

DEADLINE_S = 600

NO_FILE_BEYOND = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, ({0}, {0}))"
"""Code that limits the size of files in bytes."""


def ended(process) -> tuple[int, str]:
    """Status and what it said on stderr."""
    _, said = process.communicate(timeout=DEADLINE_S)
    return process.returncode, said


def test_first_line_is_out_before_the_last_input_is_read(forked, rig, detections):
    first, *rest = detections.read_text().splitlines(keepends=True)
    with forked(["pose", "-", "--rig", rig]) as process:
        process.stdin.write(first)
        process.stdin.flush()
        answer = process.stdout.readline()
        process.stdin.writelines(rest)
        out, said = process.communicate(timeout=DEADLINE_S)

    assert json.loads(answer)["shot"] == "a"
    assert [json.loads(line)["shot"] for line in out.splitlines()] == ["b", "c"]
    assert (process.returncode, said) == (0, "")


def test_detect_streams_into_pose(forked, rig, picture):
    with (
        forked(["detect", "-", "--rig", rig]) as detect,
        forked(["pose", "-", "--rig", rig], stdin=detect.stdout) as pose,
    ):
        detect.stdin.write(f"{picture('a.png')}\n")
        detect.stdin.flush()
        answer = pose.stdout.readline()
        detect.stdin.close()
        pose.wait(DEADLINE_S)
        detect.wait(DEADLINE_S)

    assert json.loads(answer)["shot"] == "a"
    assert (detect.returncode, pose.returncode) == (3, 3)


@pytest.mark.parametrize(
    ("number", "status"),
    [(signal.SIGTERM, 143), (signal.SIGINT, 130), (signal.SIGHUP, 129)],
    ids=["TERM", "INT", "HUP"],
)
def test_signal_while_streaming_ends_with_its_status_and_no_word(forked, rig, detections, number, status):
    with forked(["pose", "-", "--rig", rig]) as process:
        process.stdin.write(detections.read_text())
        process.stdin.flush()
        answers = [process.stdout.readline() for _ in range(3)]
        process.send_signal(number)
        process.wait(DEADLINE_S)
        said = process.stderr.read()

    assert [json.loads(answer)["shot"] for answer in answers] == ["a", "b", "c"]
    assert (process.returncode, said) == (status, "")


class Interrupting:
    """Sends the process a signal when a module is about to be imported."""

    def __init__(self, module: str) -> None:
        self.module = module

    def find_spec(self, name, path=None, target=None):
        if name == self.module:
            os.kill(os.getpid(), signal.SIGINT)


IMPORTED = ["typer", "ringpose.cli.pose", "yaml", "cv2", "ringpose.measure.stream"]


@pytest.mark.parametrize("module", ["numpy", *(pytest.param(name, marks=pytest.mark.slow) for name in IMPORTED)])
def test_interrupt_while_a_module_is_imported_is_no_traceback(started, rig, detections, module):
    code = f"{inspect.getsource(Interrupting)}\nsys.meta_path.insert(0, Interrupting({module!r}))\n"
    with started("pose", detections, "--rig", rig, before=f"import os, signal, sys\n{code}") as process:
        status, said = ended(process)

    assert (status, said) == (130, "")


LOST = """
import ringpose.errors, signal, sys, os
class Swallows:
    def __del__(self): os.kill(os.getpid(), signal.SIGTERM)
class Finder:
    def find_spec(self, name, path=None, target=None):
        if name == "ringpose.files.rigs":
            Swallows()
sys.meta_path.insert(0, Finder())
"""


def test_signal_that_gets_lost_in_a_destructor_is_raised_again(started, rig):
    with started("pose", "-", "--rig", rig, before=LOST) as process:
        process.wait(DEADLINE_S)
        said = process.stderr.read()

    assert (process.returncode, said) == (143, "")


CLEANS_UP = """
import os, signal, sys, time
import ringpose.cli.main as cli
def command(arguments):
    try:
        print("on", flush=True)
        time.sleep(600)
    finally:
        for _ in range(3):
            os.kill(os.getpid(), signal.SIGINT)
            time.sleep(0.2)
        print("off", flush=True)
cli._command = command
"""


def test_clean_up_is_not_broken_off_by_further_signals(forked):
    with forked([], CLEANS_UP) as process:
        process.stdout.readline()
        process.send_signal(signal.SIGTERM)
        rest, said = process.communicate(timeout=DEADLINE_S)

    assert (process.returncode, rest, said) == (143, "off\n", "")


PELTED = """
import os, signal, sys
from ringpose.cli import main as cli

number, ends_by = signal.{number}, {ends_by}
statuses = []
ending = [False]

def command(arguments):
    ending[0] = True
    if ends_by:
        os.kill(os.getpid(), ends_by)
    return 0

def lines_of_the_end(frame, event, _):
    if ending[0] and frame.f_code.co_filename == cli.__file__ and event == "line":
        lines[0] += 1
        if lines[0] >= at:
            os.kill(os.getpid(), number)
    return lines_of_the_end

cli._command = command
at = 0
while True:
    at, lines, ending[0] = at + 1, [0], False
    for each in cli.ENDING:
        signal.signal(each, signal.SIG_DFL)
    sys.settrace(lines_of_the_end)
    try:
        cli.run()
    except SystemExit as end:
        statuses.append(end.code)
    finally:
        sys.settrace(None)
    if lines[0] < at:
        break
print(len(statuses), *sorted(set(statuses)), file=sys.__stderr__)
os._exit(0)
"""
"""Ends the command again and again: once it has ended, signals arrive at each line from line `at` on."""


@pytest.mark.parametrize("ends_by", [0, signal.SIGTERM], ids=["finished", "ended by SIGTERM"])
@pytest.mark.parametrize("number", ["SIGTERM", "SIGINT", "SIGHUP", "SIGPIPE"])
def test_repeated_signals_at_any_line_of_the_end_are_no_traceback(forked, number, ends_by):
    with forked([], PELTED.format(number=number, ends_by=int(ends_by))) as process:
        _, said = process.communicate(timeout=DEADLINE_S)

    runs, *statuses = (int(word) for word in said.split())
    assert process.returncode == 0
    assert runs > 10  # lines, and so ends, that were tried
    by_signal = {128 + getattr(signal, number)} if number != "SIGPIPE" else set()  # Python ignores SIGPIPE
    assert set(statuses) | by_signal == {143 if ends_by else 0} | by_signal  # of two at once, either may be first


def test_a_signal_ends_a_command_whose_reader_has_stopped_reading(forked, rig, detections):
    reading, writing = os.pipe()
    size = fcntl.fcntl(writing, fcntl.F_SETPIPE_SZ, 4096)
    with forked(["pose", "-", "--rig", rig], stdout=writing) as process:
        os.close(writing)
        process.stdin.write(3 * detections.read_text())
        process.stdin.flush()
        wait_for(lambda: int.from_bytes(fcntl.ioctl(reading, termios.FIONREAD, bytes(4)), "little") == size)
        process.send_signal(signal.SIGTERM)
        process.wait(DEADLINE_S)
        os.close(reading)
        said = process.stderr.read()

    assert (process.returncode, said) == (143, "")


def test_signals_that_the_parent_ignores_stay_ignored(forked, rig, detections):
    ignore = "import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)"
    with forked(["pose", "-", "--rig", rig], ignore) as process:
        process.stdin.write(detections.read_text())
        process.stdin.flush()
        process.stdout.readline()
        process.send_signal(signal.SIGHUP)
        _, said = process.communicate(timeout=DEADLINE_S)

    assert (process.returncode, said) == (0, "")


def test_closed_pipe_ends_quietly(forked, rig, detections):
    line = detections.read_text().splitlines(keepends=True)[0]
    with forked(["pose", "-", "--rig", rig]) as process:
        process.stdin.write(line)
        process.stdin.flush()
        process.stdout.readline()
        process.stdout.close()
        process.stdin.write(line)
        process.stdin.flush()
        process.wait(DEADLINE_S)
        said = process.stderr.read()

    assert (process.returncode, said) == (141, "")


@pytest.mark.parametrize(("is_closed", "status"), [(False, 143), (True, 141)], ids=["signal", "closed pipe"])
def test_repeated_findings_are_counted_at_any_end(forked, rig, detections, is_closed, status):
    line = detections.read_text().splitlines(keepends=True)[0]
    with forked(["pose", "-", "--rig", rig]) as process:
        process.stdin.write(3 * '{"schema": 1}\n' + line)
        process.stdin.flush()
        process.stdout.readline()
        if is_closed:
            process.stdout.close()
            process.stdin.write(line)
            process.stdin.flush()
        else:
            process.send_signal(signal.SIGTERM)
        process.wait(DEADLINE_S)
        first, counted = process.stderr.read().splitlines()

    assert process.returncode == status
    assert first.startswith("ringpose pose: standard input:1: ")
    assert "2 further records" in counted


@pytest.mark.parametrize("words", [pytest.param(["--help"], marks=pytest.mark.slow), ["--version"]])
def test_help_into_a_closed_pipe_ends_quietly(started, words):
    with started(*words) as process:
        process.stdout.close()
        process.wait(DEADLINE_S)
        said = process.stderr.read()

    assert (process.returncode, said) == (141, "")


def test_full_disk_is_one_line(forked, rig, detections):
    with Path("/dev/full").open("w") as full, forked(["pose", detections, "--rig", rig], stdout=full) as process:
        status, said = ended(process)

    assert status == 74
    assert said == "ringpose pose: standard output: writing broke off: no space left on device\n"


def test_full_disk_in_a_batch_leaves_what_was_finished(forked, picture, tmp_path):
    """No file may grow beyond 4 kB here: enough for an image without segments, not for one with hundreds."""
    picture("a.png")
    noise = np.random.default_rng(1).integers(0, 255, (480, 640), dtype=np.uint8)
    cv2.imwrite(str(tmp_path / "b.png"), noise)
    words = ["detect", tmp_path / "a.png", tmp_path / "b.png", "--segments-only", "--output", tmp_path / "out"]
    with forked(words, NO_FILE_BEYOND.format(4_000)) as process:
        out, said = process.communicate(timeout=DEADLINE_S)

    assert (process.returncode, out) == (74, f"{tmp_path}/out/a.npz\n")
    assert said.startswith(f"ringpose detect: {tmp_path}/out/b.npz: writing broke off: ")
    assert [path.name for path in (tmp_path / "out").iterdir()] == ["a.npz"]
    assert detection_in(Archive(tmp_path / "out" / "a.npz")).shot == "a"


def test_a_full_disk_names_the_overlay_as_well_as_the_report(forked, rig, detections, tmp_path):
    needed_module(
        "matplotlib.font_manager", "ringpose[report]"
    )  # the process could not write its cache, which it would report
    words = ["pose", detections, "--rig", rig, "--overlay", tmp_path / "drawn", "--report", tmp_path / "r.html"]
    with forked(words, NO_FILE_BEYOND.format(100)) as process:
        _, said = process.communicate(timeout=DEADLINE_S)

    assert process.returncode == 74
    assert [line.split(": ")[1] for line in said.splitlines()] == [f"{tmp_path}/r.html", f"{tmp_path}/drawn/a.png"]


def test_progress_goes_to_a_terminal_and_leaves_the_records_alone(forked, rig, detections, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    terminal, end = pty.openpty()
    with forked(["pose", detections, "--rig", rig], stderr=end) as process:
        out, _ = process.communicate(timeout=DEADLINE_S)
    os.close(end)
    said = os.read(terminal, 1 << 16).decode()
    os.close(terminal)

    assert "shots" in said
    assert [json.loads(line)["shot"] for line in out.splitlines()] == ["a", "b", "c"]


def test_rows_on_the_terminal_of_the_progress_stand_on_lines_of_their_own(started, rig, detections, monkeypatch):
    monkeypatch.setenv("TERM", "xterm")
    terminal, end = pty.openpty()
    with started("pose", detections, "--rig", rig, stdout=end, stderr=end) as process:
        os.close(end)
        said = b""
        with contextlib.suppress(OSError):  # the terminal is closed
            while part := os.read(terminal, 1 << 16):
                said += part
        process.wait(DEADLINE_S)
    os.close(terminal)

    # what a line shows is what stands behind the last return to its beginning, or the last erasing of it
    rows = [re.split(r"\r|\x1b\[2K", row.rstrip("\r"))[-1] for row in said.decode().split("\n")]
    shown = [re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", row) for row in rows]
    assert [row.split()[0] for row in shown if re.match(r"[abc] ", row)] == ["a", "b", "c"]
    assert [row.split()[0] for row in shown if "grasp point" in row or "status" in row] == ["grasp", "shot"]


def test_closed_stdout_is_one_line(started, rig, detections):
    with started("pose", detections, "--rig", rig, preexec_fn=_close_stdout) as process:
        status, said = ended(process)

    assert (status, said.count("\n")) == (74, 1)


@pytest.mark.parametrize("unbuffered", [pytest.param("", marks=pytest.mark.slow), "1"])
def test_nobody_to_read_the_messages_changes_no_status(started, rig, tmp_path, monkeypatch, unbuffered):
    monkeypatch.setenv("PYTHONUNBUFFERED", unbuffered)
    with Path("/dev/full").open("w") as full:
        process = started("pose", tmp_path / "none.npz", "--rig", rig, stderr=full)
        process.communicate(timeout=DEADLINE_S)

    assert process.returncode == 66


@pytest.mark.slow
def test_name_that_is_no_utf_8_is_a_name(started, rig, tmp_path):
    with started("pose", "-", "--rig", rig, text=False) as process:
        _, said = process.communicate(bytes(tmp_path) + b"/\xff.npz\n", timeout=DEADLINE_S)

    assert (process.returncode, said.count(b"\n")) == (66, 1)


def _close_stdout() -> None:
    os.close(1)
