"""Relay lasers behind a watchdog process: the capture sends commands to the watchdog, which alone owns the serial port.

The watchdog (`watchdog_process`) switches the lasers off whatever happens to the capture. This module starts it, sends
it commands, and takes over the port if the watchdog itself ends or is stopped.
"""

import os
import resource
import select
import signal
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import ringpose
from ringpose.capture.lasers.driver import LaserDriver, LasersWentOff
from ringpose.capture.lasers.relay_board import RelayBoard, RelaySettings
from ringpose.capture.lasers.serial_port import SerialPort
from ringpose.errors import DeviceError, LaserSafetyError

REPLY_LIMIT_S = 5.0
"""The watchdog replies within milliseconds, or after three attempts at a board that does not; within 2 s it did not at
a load of 27 on two cores. It is the default of the time that a laser may be on."""

OPENING_LIMIT_S = 12.0
"""Eight relays that do not answer are commanded three times within 8 s."""

ENDING_LIMIT_S = 3.0

TAKE_OVER_LIMIT_S = 1.0
"""How long to try to open the port that a dead watchdog may still hold."""

_START = (
    "import sys; sys.path[:] = sys.argv[3].split({separator!r}); "
    "from ringpose.capture.lasers.watchdog_process import run; sys.exit(run(int(sys.argv[1]), sys.argv[2]))"
)


class WatchdogLasers(LaserDriver):
    """Lasers at a relay board that a watchdog process switches.

    If the watchdog process ends unexpectedly, the capture process opens the port itself and switches the lasers off,
    and every later command fails.
    """

    def __init__(self, settings: RelaySettings) -> None:
        self.settings = settings
        self._watchdog: subprocess.Popen[bytes] | None = None
        self._has_ended: threading.Event | None = None
        """Set when the watchdog has ended and, if that was unexpected, the lasers have been switched off without it."""
        self._in_service = False
        """From the first reply until `close`: an end of the watchdog in this time is unexpected."""
        self._fault: DeviceError | LaserSafetyError | None = None
        self._has_fault = threading.Event()
        self._echoes: bool | None = None
        """Whether the adapter echoes what is sent; None until the watchdog has reported it."""
        self._number = 0
        self._received = b""

    @property
    def count(self) -> int:
        """One laser for each relay."""
        return len(self.settings.relays)

    @property
    def settle_s(self) -> float:
        """Settling time of relays: they close within 10 ms; the rest covers contact bounce and the laser's start."""
        return 0.05

    @property
    def longest_on_s(self) -> float:
        """Time after which the watchdog switches a laser off; it receives no command while a frame is exposed."""
        return min(self.settings.heartbeat_s, self.settings.on_limit_s)

    @property
    def watchdog_pid(self) -> int:
        """Process id of the watchdog; 0 while there is none."""
        return 0 if self._watchdog is None else self._watchdog.pid

    def open(self) -> None:
        """Start the watchdog, which opens the port and switches everything off."""
        _disable_core_dumps()
        # A new interpreter in its own session, with the module search path of this one.
        paths = os.pathsep.join([*sys.path, str(Path(ringpose.__file__).parents[1])])
        start = _START.format(separator=os.pathsep)
        words = [sys.executable, "-I", "-S", "-c", start, str(os.getpid()), self.settings.line(), paths]
        pipe = subprocess.PIPE
        self._watchdog = subprocess.Popen(words, stdin=pipe, stdout=pipe, start_new_session=True)  # noqa: S603 (no word comes from outside)
        self._has_ended = threading.Event()
        monitor = (self._watchdog.pid, self._has_ended)
        threading.Thread(target=self._monitor, args=monitor, name="watchdog-monitor", daemon=True).start()
        self._echoes = self._reply(0, OPENING_LIMIT_S + self.settings.opening_s) == "echoes"
        self._in_service = True

    def set_mask(self, lasers: int) -> None:
        """Switch on exactly these lasers; those that go off are switched before those that come on."""
        try:
            self._send(f"set {lasers}")
        except DeviceError:
            if lasers or self._fault is None:
                raise  # after a fault, "all off" has been done already when the watchdog ended

    def read_mask(self) -> int | None:
        """The mask that the board reports; None if it cannot report."""
        try:
            reported = self._send("read")
        except DeviceError:
            if self._fault is None:
                raise
            return 0
        return None if reported == "-" else int(reported)

    def wait(self, duration_s: float) -> None:
        """Let time pass; raises at once if the watchdog or the port is lost meanwhile."""
        if self._has_fault.wait(duration_s) and self._fault is not None:
            raise self._fault

    def abort(self) -> None:
        """Make the watchdog switch off and end; no laser can be switched on after that."""
        watchdog = self._watchdog
        if watchdog is not None and self._in_service:
            with suppress(ProcessLookupError):
                os.kill(watchdog.pid, signal.SIGTERM)

    def close(self) -> None:
        """End the watchdog by closing its input; it switches off once more."""
        self._in_service = False
        watchdog, self._watchdog = self._watchdog, None
        if watchdog is None:
            return
        with suppress(OSError):
            watchdog.stdin.close()  # type: ignore[union-attr]
        try:
            watchdog.wait(ENDING_LIMIT_S)
        except subprocess.TimeoutExpired:
            watchdog.kill()
            watchdog.wait()
        finally:
            watchdog.stdout.close()  # type: ignore[union-attr]

    def _send(self, command: str) -> str:
        """Send a command; returns the reply."""
        if self._fault is not None:
            raise self._fault
        if self._watchdog is None:
            raise DeviceError(self.settings.port, "is not open")
        self._number += 1
        try:
            os.write(self._watchdog.stdin.fileno(), f"{self._number} {command}\n".encode())  # type: ignore[union-attr]
        except OSError:
            raise self._lost() from None
        return self._reply(self._number, REPLY_LIMIT_S)

    def _reply(self, number: int, limit_s: float) -> str:
        """The reply to a command; late replies to earlier commands, whose wait a signal interrupted, are skipped."""
        ends_s = time.monotonic() + limit_s
        while True:
            replied, _, words = self._line(ends_s).partition(" ")
            kind, _, rest = words.partition(" ")
            if kind == "err" and replied == "0" and self._number:
                raise self._lost()  # number 0 after the start: the watchdog reports why it ends
            if kind == "err" and replied in (str(number), "0"):
                raise DeviceError(self.settings.port, rest)
            if replied == str(number):
                break
        if kind == "off":
            raise LasersWentOff(self.settings.port, f"the watchdog switched the lasers off: {rest}")
        return rest

    def _line(self, ends_s: float) -> str:
        while b"\n" not in self._received:
            watchdog = self._watchdog
            if watchdog is None or watchdog.stdout is None:
                raise self._lost()
            ready, _, _ = select.select([watchdog.stdout], [], [], max(0.0, ends_s - time.monotonic()))
            if not ready:
                os.kill(watchdog.pid, signal.SIGKILL)  # the id stays valid until `close` has waited for the process
                raise self._lost()
            received = os.read(watchdog.stdout.fileno(), 4096)
            if not received:
                raise self._lost()
            self._received += received
        line, _, self._received = self._received.partition(b"\n")
        return line.decode()

    def _lost(self) -> DeviceError | LaserSafetyError:
        """The fault that ended the watchdog; waits until the lasers have been switched off or that has failed."""
        if self._has_ended is not None:
            self._has_ended.wait(ENDING_LIMIT_S + self.settings.opening_s)
        return self._fault or self._taken_over()

    def _monitor(self, pid: int, has_ended: threading.Event) -> None:
        """In a thread: wait for the end of the watchdog; if it is unexpected, take over the port and switch off.

        A stopped watchdog counts as ended.
        """
        with suppress(ChildProcessError):  # raised if another thread has waited for it: it has ended
            os.waitid(os.P_PID, pid, os.WEXITED | os.WSTOPPED | os.WNOWAIT)
        try:
            if self._in_service:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)  # it may only have been stopped
                self._taken_over()
                self._has_fault.set()
        finally:
            has_ended.set()

    def _taken_over(self) -> DeviceError | LaserSafetyError:
        """Switch off without a watchdog; returns the fault to report."""
        try:
            _switch_off(self.settings, self._echoes)
        except DeviceError as error:
            finding = f"watchdog and port are lost, the lasers may be on: {error.finding}"
            self._fault = LaserSafetyError(self.settings.port, finding, "cut the power")
        else:
            finding = "the watchdog of the lasers ended; they were switched off without it"
            self._fault = DeviceError(self.settings.port, finding)
        return self._fault


def _switch_off(settings: RelaySettings, echoes: bool | None) -> None:
    """Open the port and switch all lasers off; `echoes` is what is known of its adapter."""
    port = SerialPort(settings.port, settings.baud)
    ends_s = time.monotonic() + TAKE_OVER_LIMIT_S
    while True:
        try:
            port.open()
            break
        except DeviceError:  # the kernel needs a moment to release the port of a killed watchdog
            if time.monotonic() > ends_s or not Path(settings.port).exists():
                raise
            time.sleep(0.005)
    try:
        if settings.opening_s:  # a board that restarts when its port is opened may not listen yet: try before and after
            with suppress(DeviceError):
                RelayBoard(settings, port, echoes=echoes).all_off()
            time.sleep(settings.opening_s)
        RelayBoard(settings, port, echoes=echoes).all_off()
    finally:
        port.close()


def _disable_core_dumps() -> None:
    """Prevent core dumps, so that a crash ends this process at once.

    While a core is written, the pipes stay open and the lasers on. A limit of one byte, unlike none, also keeps the
    kernel from piping the core to a program (core(5)).
    """
    _, hard = resource.getrlimit(resource.RLIMIT_CORE)
    if hard != 0:
        resource.setrlimit(resource.RLIMIT_CORE, (1, hard))
