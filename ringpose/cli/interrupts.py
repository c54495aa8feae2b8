"""Signals as exceptions, so that `with` and `finally` blocks run."""

import signal
import sys
from types import FrameType
from typing import Any

from ringpose.errors import SignalReceived

AGAIN_S = 0.1
"""How long after a signal its exception is raised once more, if it got lost."""

ENDING = (signal.SIGHUP, signal.SIGINT, signal.SIGTERM)


def raise_signals() -> None:
    """From now on the signals that end a program are exceptions, except those that it was started to ignore."""
    interrupts = _Interrupts()
    sys.unraisablehook = _report_unraisable
    signal.signal(signal.SIGALRM, interrupts)
    for number in ENDING:
        if signal.getsignal(number) != signal.SIG_IGN:  # nohup, or a shell's background job
            signal.signal(number, interrupts)


def ignore_signals() -> None:
    """The program is about to end anyway."""
    signal.setitimer(signal.ITIMER_REAL, 0)
    for number in (*ENDING, signal.SIGALRM):
        signal.signal(number, signal.SIG_IGN)


class _Interrupts:
    """Turns signals into one exception, which is raised again and again until it is on its way.

    Once is not enough: foreign code may swallow it (an import in C clears all errors, a destructor cannot raise).
    While a `with` or `finally` block cleans up after it, no signal breaks that off.
    """

    def __init__(self) -> None:
        self.number = 0

    def __call__(self, number: int, frame: FrameType | None) -> None:
        self.number = self.number or number
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
        if not _on_its_way(sys.exception()):
            raise SignalReceived(self.number)


def _on_its_way(error: BaseException | None) -> bool:
    while error is not None and not isinstance(error, SignalReceived):
        error = error.__context__
    return error is not None


def _report_unraisable(unraisable: Any) -> None:
    if not isinstance(unraisable.exc_value, SignalReceived):
        sys.__unraisablehook__(unraisable)
