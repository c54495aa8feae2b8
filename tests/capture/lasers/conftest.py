"""Boards on pseudo-terminals, and the real command that captures with them."""

import json
import os
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, suppress
from pathlib import Path
from typing import Any

import pytest
from small_rig import SMALL_RIG

from ringpose.simulate.serve.contacts import ContactFaults
from ringpose.simulate.serve.relays import ServedRelays
from ringpose.wire.ascii_relays import AsciiCodec
from ringpose.wire.lcus import LcusCodec
from ringpose.wire.modbus import ModbusCodec
from ringpose.wire.numato import NumatoCodec

ARDUINO = AsciiCodec(on="R{n} ON", off="R{n} OFF", read="R?", acknowledged_by="OK")

BOARDS: dict[str, tuple[Any, str]] = {
    "lcus": (LcusCodec(), "lcus:{port}?ch=1,2,3"),
    "numato": (NumatoCodec(), "numato:{port}?ch=0,1,2"),
    "modbus": (ModbusCodec(), "modbus:{port}?ch=0,1,2"),
    "ascii": (ARDUINO, "ascii:{port}?ch=1,2,3&on=R{{n}}%20ON&off=R{{n}}%20OFF&read=R?&ok=OK&opening=0"),
}

SCENE = """\
ringpose: scene/1
rig: rig.yaml
ring: {radius_inner_m: 0.567, radius_outer_m: 0.597, height_m: 0.06}
body: {size_m: [1.6, 1.6, 1.0]}
stripe_dn: 200
sequence: off,1,2,3,off
trajectory:
- generate: {count: 40, distances_m: [0.5], tilt_rad: 0.05}
"""

UNGUARDED = """
import ringpose.capture.lasers.relays as relays
from ringpose.capture.lasers.driver import LaserDriver
from ringpose.capture.lasers.relay_board import RelayBoard
from ringpose.capture.lasers.serial_port import SerialPort

class Unguarded(LaserDriver):
    count, settle_s = 3, 0.0
    def __init__(self, settings):
        self.port = SerialPort(settings.port, settings.baud)
        self.board = RelayBoard(settings, self.port)
    def open(self):
        self.port.open()
        self.board.all_off()
    def set_mask(self, lasers):
        self.board.set_mask(lasers)
    def read_mask(self):
        return self.board.read_mask()
    def close(self):
        self.port.close()

relays.GuardedLasers = Unguarded
"""
"""Put before the command: it opens the port itself, as it would without the guard."""


@pytest.fixture
def board(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[..., Any]:
    """Serves a board by its scheme; `uri` is what capture is given. Wear is counted in the test's own folder."""
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "state"))

    @contextmanager
    def served(scheme: str, faults: ContactFaults | None = None) -> Iterator[tuple[ServedRelays, str]]:
        codec, uri = BOARDS[scheme]
        with ServedRelays(codec, faults=faults) as relays:
            yield relays, uri.format(port=relays.port)

    return served


@pytest.fixture
def scene_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The working folder, with a small scene in it."""
    (tmp_path / "rig.yaml").write_text(SMALL_RIG)
    (tmp_path / "scene.yaml").write_text(SCENE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


class Capturing(AbstractContextManager["Capturing"]):
    """The real command, forked from a process that has loaded what it imports; used like a `subprocess.Popen`."""

    def __init__(self, forker: socket.socket, job: dict[str, Any]) -> None:
        self._reply, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        (out, their_out), (said, their_said) = os.pipe(), os.pipe()
        self.stdout, self.stderr = os.fdopen(out), os.fdopen(said)
        socket.send_fds(forker, [json.dumps(job).encode()], [theirs.fileno(), their_out, their_said])
        theirs.close()
        os.close(their_out)
        os.close(their_said)
        self.pid = int(self._reply.recv(32))
        self.returncode: int | None = None

    def send_signal(self, number: int) -> None:
        os.kill(self.pid, number)

    def kill(self) -> None:
        with suppress(ProcessLookupError):
            self.send_signal(signal.SIGKILL)

    def wait(self, timeout: float | None = None) -> int:
        if self.returncode is None:
            self._reply.settimeout(timeout)
            self.returncode = int(self._reply.recv(32))
        return self.returncode

    def communicate(self, timeout: float | None = None) -> tuple[str, str]:
        """What it has still to say; a few lines, which a pipe holds."""
        self.wait(timeout)
        return self.stdout.read(), self.stderr.read()

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, trace: object) -> None:
        if kind is not None and self.returncode is None:
            self.kill()
        self.wait()
        for each in (self.stdout, self.stderr, self._reply):
            each.close()


@pytest.fixture(scope="session")
def forker() -> Iterator[socket.socket]:
    """A process that has loaded the command and forks one for each job."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    words = [sys.executable, "-W", "error", str(Path(__file__).with_name("forker.py")), str(theirs.fileno())]
    with subprocess.Popen(words, pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL):
        theirs.close()
        yield ours
        ours.close()


@pytest.fixture
def capturing(scene_folder: Path, forker: socket.socket) -> Callable[..., Capturing]:
    """Starts `ringpose capture` of a small simulated scene with the lasers at a URI; returns the process."""

    def start(
        lasers: str, *words: str, before: str = "", first: tuple[str, ...] = ("capture", "--output", "s")
    ) -> Capturing:
        command = [*first, "--camera", "sim:scene.yaml", "--lasers", lasers, *words]
        job = {"before": before, "words": command, "folder": str(scene_folder), "environment": {**os.environ}}
        return Capturing(forker, job)

    return start


@pytest.fixture
def unguarded() -> str:
    """Code that takes the guard away."""
    return UNGUARDED


def waited(condition: Callable[[], bool], limit_s: float) -> float:
    """Time until a condition holds; infinite if it does not within the limit."""
    began_s = time.monotonic()
    while time.monotonic() < began_s + limit_s:
        if condition():
            return time.monotonic() - began_s
        time.sleep(0.0002)
    return float("inf")


@pytest.fixture
def time_until() -> Callable[..., float]:
    """`waited`, for the tests."""
    return waited
