"""The guard: a process of its own that owns the port, so that the lasers go off whatever becomes of the capture.

It ends with all lasers off when its owner ends in any way, when its input ends, when the port is lost, and on every
signal that can be caught. It starts fast because it imports nothing heavy.
"""

import os
import select
import signal
import sys
from contextlib import suppress

from ringpose.capture.lasers.guard_rules import Danger, GuardRules
from ringpose.capture.lasers.owner import Owner
from ringpose.capture.lasers.relay_board import RelayBoard
from ringpose.capture.lasers.relay_settings import RelaySettings, settings_of_line
from ringpose.capture.lasers.serial_port import SerialPort
from ringpose.errors import DeviceError

ORDERS, ANSWERS = 0, 1
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
        return _guarded(settings, port, Owner(owner), wake)
    except (DeviceError, OSError) as error:
        found = f"{error.found}; {error.remedy}" if isinstance(error, DeviceError) else str(error)
        with suppress(OSError):
            _say(f"0 err {found}\n")
        return 1


def _guarded(settings: RelaySettings, port: SerialPort, owner: Owner, wake: int) -> int:
    port.open()
    try:
        return _served(settings, port, owner, (owner.end, wake))
    finally:
        port.close()


def _served(settings: RelaySettings, port: SerialPort, owner: Owner, ends: tuple[int, int]) -> int:
    board = RelayBoard(settings, port)
    select.select(ends, [], [], settings.opening_s)
    board.all_off()
    try:
        _say("0 ok\n")
        port.interrupting = ends
        rules = GuardRules(board, settings, (owner.danger, *_interlock(settings, port)))
        _serve(rules, port, ends)
    finally:
        port.interrupting = ()
        board.all_off()
    return 0


def _serve(rules: GuardRules, port: SerialPort, ends: tuple[int, int]) -> None:
    """Until the owner, its orders or the port end, or a signal comes."""
    poll = select.poll()
    for number in (ORDERS, *ends):
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
        if ORDERS in ready:
            received = os.read(ORDERS, 4096)
            if not received:
                return
            *lines, pending = (pending + received).split(b"\n")
            for line in lines:
                _say(rules.obey(line.decode()))


def _interlock(settings: RelaySettings, port: SerialPort) -> tuple[Danger, ...]:
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
