"""Virtual relay boards, and processes of `ringpose capture` that use them."""

import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from forked import Forked
from guarded_lasers import BOARDS, PATIENT, LinkedRelays
from small_rig import write_scene

from ringpose.simulate.serve.relays import RelayFaults, ServedRelays

WITHOUT_WATCHDOG = """
import ringpose.capture.lasers.relays as relays
from ringpose.capture.lasers.driver import LaserDriver
from ringpose.capture.lasers.relay_board import RelayBoard
from ringpose.capture.lasers.serial_port import SerialPort

class Unwatched(LaserDriver):
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

relays.WatchdogLasers = Unwatched
"""
"""Put before the command: it opens the port itself, as it would without the watchdog."""


@pytest.fixture
def board(tmp_path: Path) -> Callable[..., Any]:
    """Serves a virtual board by its scheme; yields it with its URI."""

    @contextmanager
    def served(
        scheme: str, faults: RelayFaults | None = None, limits: str = PATIENT
    ) -> Iterator[tuple[ServedRelays, str]]:
        codec, uri = BOARDS[scheme]
        with LinkedRelays(tmp_path, codec, faults=faults) as relays:
            yield relays, uri.format(port=relays.port, channels=relays.channels) + limits

    return served


@pytest.fixture
def scene_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A working folder with a small scene."""
    write_scene(tmp_path, "stripe_dn: 200", "sequence: off,1,2,3,off", count=40)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def capturing(scene_folder: Path, forker: socket.socket) -> Callable[..., Forked]:
    """Starts `ringpose capture` of a small simulated scene with the lasers at a URI; returns the process."""

    def start(
        lasers: str, *words: str, before: str = "", first: tuple[str, ...] = ("capture", "--output", "s")
    ) -> Forked:
        command = [*first, "--camera", "sim:scene.yaml", "--lasers", lasers, *words]
        return Forked(forker, command, before)

    return start


@pytest.fixture
def without_watchdog() -> str:
    """Code that replaces the watchdog by a driver that opens the port itself."""
    return WITHOUT_WATCHDOG
