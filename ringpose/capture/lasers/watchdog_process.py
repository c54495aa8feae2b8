"""The guard: a process of its own that owns the port, so that the lasers go off whatever becomes of the capture.

It ends with all lasers off when its owner ends in any way, when its input ends, when the port is lost, and on every
signal that can be caught. It starts fast because it imports nothing heavy.

When lasers go off although nobody has said so.

Whether the process that the guard works for is still at work.
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

COMMANDS, ANSWERS = 0, 1
"""File descriptors."""

ENDING = (
    "SIGHUP", "SIGTERM", "SIGQUIT", "SIGABRT", "SIGUSR1", "SIGUSR2", "SIGALRM", "SIGVTALRM", "SIGPROF", "SIGXCPU",
    "SIGXFSZ", "SIGIO", "SIGPWR", "SIGTRAP", "SIGSYS",
)  # fmt: skip
"""What would end a process without a word: here it ends with all lasers off."""

IGNORED = ("SIGINT", "SIGPIPE", "SIGTSTP", "SIGTTIN", "SIGTTOU")


def run(owner: int, line: str) -> int:
    """Guard the lasers of the settings in `line` for the process `owner`; returns the exit status."""
    settings = settings_of_line(line)
    wake = _woken_by_signals()
    port = SerialPort(settings.port, settings.baud)
    try:
        return _guarded(settings, port, ParentProcess(owner), wake)
    except (DeviceError, OSError) as error:
        found = f"{error.found}; {error.remedy}" if isinstance(error, DeviceError) else str(error)
        with suppress(OSError):
            _say(f"0 err {found}\n")
        return 1


class ParentProcess:
    """The parent of this process."""

    def __init__(self, pid: int) -> None:
        self.end = os.pidfd_open(pid)
        """Becomes readable when the owner has ended."""
        if os.getppid() != pid:
            raise DeviceError("guard", "its owner has ended")
        self._status = os.open(f"/proc/{pid}/stat", os.O_RDONLY)

    def danger(self) -> str:
        """That it is about to end, or was stopped; nothing while it runs."""
        try:
            fields = os.pread(self._status, 1024, 0).rpartition(b")")[2].split()
        except OSError:
            return "the capture has ended"
        if int(fields[6]) & (EXITING | DUMPING_CORE | SIGNALED):
            return "the capture is ending"
        return "the capture was stopped" if fields[0].decode() in STOPPED else ""


def _guarded(settings: RelaySettings, port: SerialPort, owner: ParentProcess, wake: int) -> int:
    port.open()
    try:
        return _served(settings, port, owner, (owner.end, wake))
    finally:
        port.close()


def _served(settings: RelaySettings, port: SerialPort, owner: ParentProcess, ends: tuple[int, int]) -> int:
    board = RelayBoard(settings, port)
    select.select(ends, [], [], settings.opening_s)
    board.all_off()
    try:
        _say("0 ok\n")
        port.interrupting = ends
        rules = WatchdogParams(board, settings, (owner.danger, *_interlock(settings, port)))
        _serve(rules, port, ends)
    finally:
        port.interrupting = ()
        board.all_off()
    return 0


Fault: TypeAlias = Callable[[], str]
"""Says why no laser may be on now; nothing if there is no reason."""


class WatchdogParams:
    """Obeys one line at a time, and between them watches heartbeat, on-time and other dangers.

    Lines are `NUMBER set MASK`, `NUMBER read` and `NUMBER off`; answers are `NUMBER ok MASK`, `NUMBER ok -` where the
    board cannot say, `NUMBER err TEXT`, and `NUMBER off TEXT` if the lasers went off by themselves meanwhile. What was
    switched off so stays off until the owner has said `set 0` or `off`.
    """

    def __init__(
        self,
        board: RelayBoard,
        settings: RelaySettings,
        dangers: Sequence[Fault] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._board = board
        self._settings = settings
        self._dangers = dangers
        self._clock = clock
        self._heard_s = self._on_since_s = self._said_s = clock()
        self._went_off = ""

    def obey(self, line: str) -> str:
        """Carry out a line and answer it."""
        number, _, order = line.strip().partition(" ")
        self._heard_s = self._clock()
        try:
            return f"{number} {self._obeyed(order.split())}\n"
        except DeviceError as error:
            text = f"{error.found}; {error.remedy}" if error.remedy else error.found
            return f"{number} err {text}\n"

    def wait_s(self) -> float | None:
        """How long nothing has to be watched; None for ever."""
        if not self._board.lit:
            return None
        ends_s = [self._heard_s + self._settings.heartbeat_s, self._on_since_s + self._settings.on_limit_s]
        if self._settings.repeat_s is not None:
            ends_s.append(self._said_s + self._settings.repeat_s)
        if self._dangers:
            ends_s.append(self._clock() + LOOK_S)
        return max(0.0, min(ends_s) - self._clock())

    def watch(self) -> None:
        """Switch off what may not be on any longer."""
        if not self._board.lit:
            return
        reason = self._reason_to_switch_off()
        if reason:
            self._went_off = reason
            self._board.all_off()
        elif self._settings.repeat_s is not None and self._clock() >= self._said_s + self._settings.repeat_s:
            self._said_s = self._clock()
            self._board.repeat()

    def _obeyed(self, order: list[str]) -> str:
        if order[:1] == ["off"] or order == ["set", "0"]:
            self._went_off = ""
            self._board.set_mask(0) if order[0] == "set" else self._board.all_off()
            return "ok 0"
        self.watch()
        if self._went_off:
            return f"off {self._went_off}"
        if order[:1] == ["set"]:
            return self._set(int(order[1]))
        reported = self._board.read_mask()
        return "ok -" if reported is None else f"ok {reported}"

    def _set(self, lasers: int) -> str:
        danger = self._danger() if lasers else ""
        if danger:
            raise DeviceError("lasers", f"stay off: {danger}")
        self._said_s = self._clock()
        if not lasers & self._board.lit:
            self._on_since_s = self._clock()
        self._board.set_mask(lasers)
        return f"ok {lasers}"

    def _reason_to_switch_off(self) -> str:
        now_s, settings = self._clock(), self._settings
        danger = self._danger()
        if danger:
            return danger
        if now_s >= self._heard_s + settings.heartbeat_s:
            return f"nothing was heard for {settings.heartbeat_s:g} s; raise heartbeat= if a frame takes longer"
        if now_s >= self._on_since_s + settings.on_limit_s:
            return f"a laser was on for {settings.on_limit_s:g} s; raise longest_on= (and pulse=) if it has to be"
        return ""

    def _danger(self) -> str:
        return next((reason for danger in self._dangers if (reason := danger())), "")


def _serve(rules: WatchdogParams, port: SerialPort, ends: tuple[int, int]) -> None:
    """Until the owner, its orders or the port end, or a signal comes."""
    poll = select.poll()
    for number in (COMMANDS, *ends):
        poll.register(number, select.POLLIN)
    poll.register(port.fileno, 0)
    pending = b""
    while True:
        wait_s = rules.wait_s()
        ready = dict(poll.poll(None if wait_s is None else 1000 * wait_s))
        if any(number in ready for number in ends):
            return
        if port.fileno in ready:
            raise DeviceError(port.name, "hung up", "check cable and power")
        rules.watch()
        if COMMANDS in ready:
            received = os.read(COMMANDS, 4096)
            if not received:
                return
            *lines, pending = (pending + received).split(b"\n")
            for line in lines:
                _say(rules.obey(line.decode()))


def _interlock(settings: RelaySettings, port: SerialPort) -> tuple[Fault, ...]:
    if not settings.interlock:
        return ()
    return (lambda: "" if port.is_closed_contact(settings.interlock) else "the interlock is open",)


def _say(line: str) -> None:
    os.write(ANSWERS, line.encode())


def _woken_by_signals() -> int:
    """A descriptor that becomes readable when a signal comes that should end the guard."""
    woken, waking = os.pipe()
    os.set_blocking(waking, False)
    for name in IGNORED:
        signal.signal(getattr(signal, name), signal.SIG_IGN)
    for name in ENDING:
        if hasattr(signal, name):
            signal.signal(getattr(signal, name), lambda number, frame: None)
    signal.set_wakeup_fd(waking, warn_on_full_buffer=False)
    return woken


if __name__ == "__main__":
    sys.exit(run(int(sys.argv[1]), sys.argv[2]))

LOOK_S = 0.01
"""How often dangers are looked for while a laser is on."""

EXITING, DUMPING_CORE, SIGNALED = 0x4, 0x200, 0x400
"""Flags of the kernel (PF_*): a process ends with its first flag; its pipes are closed only when its memory is gone."""

STOPPED = "Tt"
"""States of a process that was stopped, by a signal or a debugger."""
