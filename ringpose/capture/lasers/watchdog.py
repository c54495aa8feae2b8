"""Relays behind a guard: the process that captures tells the guard, the guard alone touches the port.

Notices when the guard itself ends or is stopped.
"""

import os
import resource
import select
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

import ringpose
from ringpose.capture.lasers.driver import LaserDriver, LasersWentOff
from ringpose.capture.lasers.relay_board import RelayBoard, RelaySettings
from ringpose.capture.lasers.serial_port import SerialPort
from ringpose.errors import DeviceError, LaserSafetyError

ANSWER_LIMIT_S = 2.0
"""The guard answers within milliseconds, or after three attempts at a board that does not."""

OPENING_LIMIT_S = 10.0

ENDING_LIMIT_S = 3.0

_START = (
    "import sys; sys.path[:] = sys.argv[3].split({separator!r}); "
    "from ringpose.capture.lasers.watchdog_process import run; sys.exit(run(int(sys.argv[1]), sys.argv[2]))"
)


class WatchdogLasers(LaserDriver):
    """If the guard ends unasked, this process takes the port itself, switches off, and captures no more."""

    def __init__(self, settings: RelaySettings) -> None:
        self.settings = settings
        self._guard: subprocess.Popen[bytes] | None = None
        self._end: WatchdogConnection | None = None
        self._guarding = False
        self._fault: DeviceError | LaserSafetyError | None = None
        self._faulty = threading.Event()
        self._number = 0
        self._received = b""

    @property
    def count(self) -> int:
        """One laser a relay."""
        return len(self.settings.relays)

    @property
    def settle_s(self) -> float:
        """Relays close within 10 ms; the rest is for their bouncing and the laser's own start."""
        return 0.05

    @property
    def longest_on_s(self) -> float:
        """Until the guard steps in, which is told nothing while a frame is exposed."""
        return min(self.settings.heartbeat_s, self.settings.on_limit_s)

    @property
    def guard_pid(self) -> int:
        """Process number of the guard; 0 while there is none."""
        return 0 if self._guard is None else self._guard.pid

    def open(self) -> None:
        """Start the guard, which takes the port and switches everything off."""
        _keep_no_core()
        self._guard = _started(self.settings)
        self._end = WatchdogConnection(self._guard.pid, self._guard_ended)
        self._answer(0, OPENING_LIMIT_S + self.settings.opening_s)
        self._guarding = True

    def set_mask(self, lasers: int) -> None:
        """Light exactly these: what has to go off goes off before what has to come on."""
        try:
            self._order(f"set {lasers}")
        except DeviceError:
            if lasers or self._fault is None:
                raise  # otherwise they were switched off when the guard ended

    def read_mask(self) -> int | None:
        """What the board reports to be on; None if it cannot say."""
        try:
            reported = self._order("read")
        except DeviceError:
            if self._fault is None:
                raise
            return 0
        return None if reported == "-" else int(reported)

    def wait(self, duration_s: float) -> None:
        """Let time pass, but not if the guard or the port is lost meanwhile."""
        if self._faulty.wait(duration_s) and self._fault is not None:
            raise self._fault

    def abort(self) -> None:
        """Let the guard switch off and end; nothing can be lit after it."""
        guard = self._guard
        if guard is not None and self._guarding:
            with suppress(ProcessLookupError):
                os.kill(guard.pid, signal.SIGTERM)

    def close(self) -> None:
        """Send the guard home; it switches off once more."""
        self._guarding = False
        guard, self._guard = self._guard, None
        if guard is None:
            return
        with suppress(OSError):
            guard.stdin.close()  # type: ignore[union-attr]
        try:
            guard.wait(ENDING_LIMIT_S)
        except subprocess.TimeoutExpired:
            guard.kill()
            guard.wait()
        finally:
            guard.stdout.close()  # type: ignore[union-attr]

    def _order(self, order: str) -> str:
        if self._fault is not None:
            raise self._fault
        if self._guard is None:
            raise DeviceError(self.settings.port, "is not open")
        self._number += 1
        try:
            os.write(self._guard.stdin.fileno(), f"{self._number} {order}\n".encode())  # type: ignore[union-attr]
        except OSError:
            raise self._lost() from None
        return self._answer(self._number, ANSWER_LIMIT_S)

    def _answer(self, number: int, limit_s: float) -> str:
        """The answer to an order; those to earlier ones, whose wait a signal broke off, are passed over."""
        ends_s = time.monotonic() + limit_s
        while True:
            said, _, words = self._line(ends_s).partition(" ")
            kind, _, rest = words.partition(" ")
            if kind == "err" and said in (str(number), "0"):
                raise self._problem(said, rest)
            if said == str(number):
                break
        if kind == "off":
            raise LasersWentOff(self.settings.port, f"the guard switched the lasers off: {rest}")
        return rest

    def _problem(self, said: str, words: str) -> DeviceError | LaserSafetyError:
        """A refusal; one that was no answer (0) is the guard's last word."""
        if said == "0" and self._number:
            return self._lost()
        return DeviceError(self.settings.port, words)

    def _line(self, ends_s: float) -> str:
        while b"\n" not in self._received:
            guard = self._guard
            if guard is None or guard.stdout is None:
                raise self._lost()
            ready, _, _ = select.select([guard.stdout], [], [], max(0.0, ends_s - time.monotonic()))
            if not ready:
                os.kill(guard.pid, signal.SIGKILL)  # it is ours until `close` has waited for it
                raise self._lost()
            received = os.read(guard.stdout.fileno(), 4096)
            if not received:
                raise self._lost()
            self._received += received
        line, _, self._received = self._received.partition(b"\n")
        return line.decode()

    def _lost(self) -> DeviceError | LaserSafetyError:
        """Why there is no guard any more, once everything was done about it."""
        if self._end is not None:
            self._end.has_come.wait(ENDING_LIMIT_S + self.settings.opening_s)
        return self._fault or self._taken_over()

    def _guard_ended(self, pid: int) -> None:
        """In the thread that waits for it: take the port and switch off."""
        if not self._guarding:
            return
        with suppress(ProcessLookupError):
            os.kill(pid, signal.SIGKILL)  # it may only have been stopped
        self._taken_over()
        self._faulty.set()

    def _taken_over(self) -> DeviceError | LaserSafetyError:
        """Switch off without a guard; what there is to be said about it."""
        try:
            _switch_off(self.settings)
        except DeviceError as error:
            found = f"guard and port are lost, the lasers may be on: {error.found}"
            self._fault = LaserSafetyError(self.settings.port, found, "cut the power")
        else:
            found = "the guard of the lasers ended; they were switched off without it"
            self._fault = DeviceError(self.settings.port, found)
        return self._fault


def _started(settings: RelaySettings) -> "subprocess.Popen[bytes]":
    """A fresh interpreter in a session of its own, which finds what this one finds and loads nothing else."""
    paths = os.pathsep.join([*sys.path, str(Path(ringpose.__file__).parents[1])])
    start = _START.format(separator=os.pathsep)
    words = [sys.executable, "-I", "-S", "-c", start, str(os.getpid()), settings.line(), paths]
    pipe = subprocess.PIPE
    return subprocess.Popen(words, stdin=pipe, stdout=pipe, start_new_session=True)  # noqa: S603 (no word comes from outside)


def _switch_off(settings: RelaySettings) -> None:
    port = SerialPort(settings.port, settings.baud)
    ends_s = time.monotonic() + 1.0
    while True:
        try:
            port.open()
            break
        except DeviceError:  # the dead guard's hold of the port takes a moment to end
            if time.monotonic() > ends_s or not Path(settings.port).exists():
                raise
            time.sleep(0.005)
    try:
        if settings.opening_s:  # a board that starts anew when its port is opened may not listen yet
            with suppress(DeviceError):
                RelayBoard(settings, port).all_off()
            time.sleep(settings.opening_s)
        RelayBoard(settings, port).all_off()
    finally:
        port.close()


def _keep_no_core() -> None:
    """A crash must end this process at once: while a core is written its pipes stay open.

    A limit of one byte, unlike none, also keeps the kernel from piping the core to a program (core(5)).
    """
    _, hard = resource.getrlimit(resource.RLIMIT_CORE)
    if hard != 0:
        resource.setrlimit(resource.RLIMIT_CORE, (1, hard))


class WatchdogConnection:
    """Waits, in a thread, for the end of a child process, and acts at once; a stopped one is as bad as a dead one."""

    def __init__(self, pid: int, act: Callable[[int], None]) -> None:
        self._pid = pid
        self._act = act
        self.has_come = threading.Event()
        """Set when the child has ended and everything was done about it."""
        self._thread = threading.Thread(target=self._watch, name="guard-end", daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        with suppress(ChildProcessError):  # if it was waited for elsewhere it has ended
            os.waitid(os.P_PID, self._pid, os.WEXITED | os.WSTOPPED | os.WNOWAIT)
        try:
            self._act(self._pid)
        finally:
            self.has_come.set()
