"""The watchdog: a separate process that owns the serial port and switches the lasers off if the capture fails.

It ends with all lasers off when its parent process ends in any way, when its input ends, when the port is lost, and on
every signal that can be caught. While a laser is on it also switches off after a time without commands, after a maximum
time on, while the interlock is open, and if the parent process is stopped. It imports no heavy package, so that it
starts fast.
"""

import os
import select
import signal
import sys
import time
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import TypeAlias

from ringpose.capture.lasers.relay_board import RelayBoard, RelaySettings, settings_of_line
from ringpose.capture.lasers.serial_port import SerialPort
from ringpose.errors import DeviceError

COMMANDS, REPLIES = 0, 1
"""File descriptors: standard input and output."""

ENDING_SIGNALS = (
    "SIGHUP", "SIGTERM", "SIGQUIT", "SIGABRT", "SIGUSR1", "SIGUSR2", "SIGALRM", "SIGVTALRM", "SIGPROF", "SIGXCPU",
    "SIGXFSZ", "SIGIO", "SIGPWR", "SIGTRAP", "SIGSYS",
)  # fmt: skip
"""Signals that end a process by default; here they end it with all lasers off."""

IGNORED_SIGNALS = ("SIGINT", "SIGPIPE", "SIGTSTP", "SIGTTIN", "SIGTTOU")

FAULT_CHECK_S = 0.01
"""Interval of the fault checks while a laser is on."""

EXITING, DUMPING_CORE, SIGNALED = 0x4, 0x200, 0x400
"""Kernel flags (PF_*) of a process that ends: they are set before its memory is freed and its pipes are closed."""

STOPPED = "Tt"
"""States of a process that was stopped by a signal or a debugger (proc(5))."""

Fault: TypeAlias = Callable[[], str]
"""Returns why no laser may be on now; empty if there is no fault."""


def run(parent_pid: int, line: str) -> int:
    """Watch over the lasers of the settings in `line` for a parent process; returns the exit status."""
    settings = settings_of_line(line)
    wake = _signal_pipe()
    port = SerialPort(settings.port, settings.baud)
    try:
        _watch_over(settings, port, ParentProcess(parent_pid), wake)
    except (DeviceError, OSError) as error:
        message = error.message if isinstance(error, DeviceError) else str(error)
        with suppress(OSError):
            _reply(f"0 err {message}\n")
        return 1
    return 0


def _watch_over(settings: RelaySettings, port: SerialPort, parent: "ParentProcess", wake: int) -> None:
    """Open the port, switch off, serve commands until an end, and switch off again."""
    ends = (parent.end, wake)
    port.open()
    try:
        board = RelayBoard(settings, port)
        select.select(ends, [], [], settings.opening_s)
        board.all_off()
        try:
            _reply("0 ok echoes\n" if board.echoes else "0 ok\n")
            port.interrupting = ends
            faults: list[Fault] = [parent.fault]
            if settings.interlock:
                faults.append(lambda: "" if port.is_contact_closed(settings.interlock) else "the interlock is open")
            _serve(Watchdog(board, settings, faults), port, ends)
        finally:
            port.interrupting = ()
            board.all_off()
    finally:
        port.close()


def _serve(watchdog: "Watchdog", port: SerialPort, ends: tuple[int, int]) -> None:
    """Carry out commands until the parent process, its commands or the port end, or a signal arrives."""
    poll = select.poll()
    for descriptor in (COMMANDS, *ends):
        poll.register(descriptor, select.POLLIN)
    poll.register(port.fileno, 0)  # reports a hang-up only
    pending = b""
    while True:
        wait_s = watchdog.wait_s()
        ready = dict(poll.poll(None if wait_s is None else 1000 * wait_s))
        if any(descriptor in ready for descriptor in ends):
            return
        if port.fileno in ready:
            raise DeviceError(port.name, "hung up", "check cable and power")
        watchdog.check()
        if COMMANDS in ready:
            received = os.read(COMMANDS, 4096)
            if not received:
                return
            *lines, pending = (pending + received).split(b"\n")
            for line in lines:
                _reply(watchdog.execute(line.decode()))


class Watchdog:
    """Executes commands line by line and checks, between them, heartbeat, time on and other faults.

    Commands are `NUMBER set MASK`, `NUMBER read` and `NUMBER off`. Replies are `NUMBER ok MASK`, `NUMBER ok -` if the
    board cannot report, `NUMBER err TEXT`, and `NUMBER off TEXT` if the watchdog itself has switched the lasers off.
    From then on, every command is answered with `off TEXT` until the parent process has sent `set 0` or `off`.
    """

    def __init__(
        self,
        board: RelayBoard,
        settings: RelaySettings,
        faults: Sequence[Fault] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._board = board
        self._settings = settings
        self._faults = faults
        self._clock = clock
        self._heartbeat_s = self._on_since_s = self._sent_s = clock()
        self._off_reason = ""
        """Why the watchdog has switched off; empty if it has not, or if the parent process has confirmed it."""

    def execute(self, line: str) -> str:
        """Execute a command; returns the reply."""
        number, _, command = line.strip().partition(" ")
        self._heartbeat_s = self._clock()
        try:
            return f"{number} {self._executed(command.split())}\n"
        except DeviceError as error:
            return f"{number} err {error.message}\n"

    def wait_s(self) -> float | None:
        """Time until the next check is due; None while all lasers are off."""
        if not self._board.on_mask:
            return None
        due_s = [self._heartbeat_s + self._settings.heartbeat_s, self._on_since_s + self._settings.on_limit_s]
        if self._settings.repeat_s is not None:
            due_s.append(self._sent_s + self._settings.repeat_s)
        if self._faults:
            due_s.append(self._clock() + FAULT_CHECK_S)
        return max(0.0, min(due_s) - self._clock())

    def check(self) -> None:
        """Switch off if a laser must not be on any longer; otherwise repeat the last command if that is due."""
        if not self._board.on_mask:
            return
        reason = self._reason_to_switch_off()
        if reason:
            self._off_reason = reason
            self._board.all_off()
        elif self._settings.repeat_s is not None and self._clock() >= self._sent_s + self._settings.repeat_s:
            self._sent_s = self._clock()
            self._board.repeat()

    def _executed(self, command: list[str]) -> str:
        if command[:1] == ["off"] or command == ["set", "0"]:
            self._off_reason = ""
            self._board.set_mask(0) if command[0] == "set" else self._board.all_off()
            return "ok 0"
        self.check()
        if self._off_reason:
            return f"off {self._off_reason}"
        if command[:1] == ["set"]:
            return self._set(int(command[1]))
        reported = self._board.read_mask()
        return "ok -" if reported is None else f"ok {reported}"

    def _set(self, lasers: int) -> str:
        fault = self._fault() if lasers else ""
        if fault:
            raise DeviceError("lasers", f"stay off: {fault}")
        self._sent_s = self._clock()
        if not lasers & self._board.on_mask:  # a laser that stays on keeps the time since it came on
            self._on_since_s = self._clock()
        self._board.set_mask(lasers)
        return f"ok {lasers}"

    def _reason_to_switch_off(self) -> str:
        now_s, settings = self._clock(), self._settings
        fault = self._fault()
        if fault:
            return fault
        if now_s >= self._heartbeat_s + settings.heartbeat_s:
            return f"no command came for {settings.heartbeat_s:g} s; raise heartbeat= if a frame takes longer"
        if now_s >= self._on_since_s + settings.on_limit_s:
            return f"a laser was on for {settings.on_limit_s:g} s; raise longest_on= (and pulse=) if it has to be"
        return ""

    def _fault(self) -> str:
        return next((reason for fault in self._faults if (reason := fault())), "")


class ParentProcess:
    """The process that has started this one: the capture."""

    def __init__(self, pid: int) -> None:
        self.end = os.pidfd_open(pid)
        """A file descriptor that becomes readable when the parent process has ended."""
        if os.getppid() != pid:
            raise DeviceError("watchdog", "its parent process has ended")
        self._status = os.open(f"/proc/{pid}/stat", os.O_RDONLY)

    def fault(self) -> str:
        """A message if the process is ending or was stopped; empty while it runs."""
        try:
            fields = os.pread(self._status, 1024, 0).rpartition(b")")[2].split()
        except OSError:
            return "the capture has ended"
        if int(fields[6]) & (EXITING | DUMPING_CORE | SIGNALED):
            return "the capture is ending"
        return "the capture was stopped" if fields[0].decode() in STOPPED else ""


def _signal_pipe() -> int:
    """A file descriptor that becomes readable when a signal arrives that ends the watchdog."""
    readable, writable = os.pipe()
    os.set_blocking(writable, False)
    for name in IGNORED_SIGNALS:
        signal.signal(getattr(signal, name), signal.SIG_IGN)
    for name in ENDING_SIGNALS:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), lambda number, frame: None)
    signal.set_wakeup_fd(writable, warn_on_full_buffer=False)
    return readable


def _reply(line: str) -> None:
    os.write(REPLIES, line.encode())


if __name__ == "__main__":
    sys.exit(run(int(sys.argv[1]), sys.argv[2]))
