"""`ringpose capture` as a process of its own: signals, pipes, a full disk, a terminal that goes away."""

import fcntl
import os
import signal
import termios
from pathlib import Path

import numpy as np
import pytest
from recorded_shots import make_shot, recorded

from ringpose.files.images.sessions import read_session
from ringpose.files.images.shots import write_shot

pytestmark = pytest.mark.usefixtures("empty_folder")


SLOWLY = ("capture", "--camera", "files:in", "--rate", "0.001", "--output", "s")
"""A second shot is not taken before the test has ended."""


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT, signal.SIGHUP])
def test_a_signal_leaves_finished_shots_and_a_valid_session(number, forked):
    """The name of the first shot is out before the second one is taken."""
    for name in "abc":
        recorded(Path("in"), name)
    with forked(SLOWLY) as process:
        first = process.stdout.readline()

        process.send_signal(number)
        out, err = process.communicate(timeout=300)

    assert process.returncode == 128 + number
    assert (first, out, err) == ("s/a.npz\n", "", "")
    (capture,) = read_session(Path("s")).captures
    assert (capture.state, capture.shots) == ("stopped", ("a",))
    assert sorted(path.name for path in Path("s").iterdir()) == ["a.npz", "session.yaml"]


def test_a_reader_that_goes_away_ends_the_capture_with_a_valid_session(forked):
    for name in "ab":
        recorded(Path("in"), name)
    reading, writing = os.pipe()
    os.close(reading)

    with forked(["capture", "--camera", "files:in", "--output", "s"], stdout=writing) as process:
        os.close(writing)
        _, said = process.communicate(timeout=300)

    assert (process.returncode, said) == (141, "")
    assert read_session(Path("s")).captures[0].state == "stopped"


def test_a_full_disk_keeps_what_was_finished(forked, rng):
    """No file may grow beyond 5 kB here; noise does not compress."""
    for name in "ab":
        recorded(Path("in"), name)
    noise = rng.integers(0, 256, (1, 120, 160), dtype=np.uint8)
    write_shot(
        Path("in/z.npz"),
        make_shot(noise, [0], name="z"),
    )
    words = ["capture", "--camera", "files:in", "--output", "s"]

    limit = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (5_000, 5_000))"
    with forked(words, limit) as process:
        out, said = process.communicate(timeout=600)

    assert (process.returncode, out) == (74, "s/a.npz\ns/b.npz\n")
    assert said.startswith("ringpose capture: s/z.npz: writing broke off: ")
    (capture,) = read_session(Path("s")).captures
    assert (capture.state, capture.shots) == ("stopped", ("a", "b"))


def test_progress_is_shown_on_a_terminal_and_names_alone_go_out(forked):
    for name in "ab":
        recorded(Path("in"), name)
    screen, terminal = os.openpty()

    with forked(["capture", "--camera", "files:in", "--output", "s"], stderr=terminal) as process:
        out, _ = process.communicate(timeout=600)
    shown = os.read(screen, 65536).decode()
    os.close(screen)
    os.close(terminal)

    assert out == "s/a.npz\ns/b.npz\n"
    assert "2 shots" in shown


@pytest.mark.parametrize(("ignored", "status"), [pytest.param(True, 0, marks=pytest.mark.slow), (False, 129)])
def test_a_terminal_that_goes_away_takes_no_shot_with_it(started, ignored, status):
    for name in "abcdef":
        recorded(Path("in"), name)
    screen, terminal = os.openpty()

    def belongs_to_the_terminal():
        os.setsid()
        fcntl.ioctl(terminal, termios.TIOCSCTTY, 0)
        signal.signal(signal.SIGHUP, signal.SIG_IGN if ignored else signal.SIG_DFL)

    rate = "5" if ignored else "0.001"
    words = ["capture", "--camera", "files:in", "--rate", rate, "--output", "s"]
    with started(*words, stderr=terminal, preexec_fn=belongs_to_the_terminal) as process:
        process.stdout.readline()
        os.close(terminal)
        os.close(screen)
        process.stdout.read()

    assert process.returncode == status
    assert (len(read_session(Path("s")).shots) == 6) is ignored
