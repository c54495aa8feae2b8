"""The entry point: signals become exceptions, errors become exit statuses.

Nothing heavy is imported before the signals are caught, so that an interrupt during start-up is no traceback.

Signals as exceptions, so that `with` and `finally` blocks run.
"""

import gc
import os
import signal
import sys
from collections.abc import Sequence
from importlib import import_module
from types import FrameType
from typing import Any

from ringpose.cli import messages
from ringpose.errors import CLOSED_PIPE, RingposeError, SignalReceived, UsageError

COMMANDS = {
    "capture": "capture",
    "calibrate-camera": "calibrate.camera",
    "calibrate-planes": "calibrate.planes",
    "convert-camera": "convert_camera",
    "detect": "detect",
    "pose": "pose",
    "simulate": "simulate.render",
    "bench": "bench",
}
"""Subcommands in the order of the help, with their modules."""

GARBAGE_FROM = 100_000
"""New objects from which Python looks for garbage among them. A start makes 40 000, all for good: looking through them
is a twentieth of its time. A shot leaves a few dozen small ones."""


def main(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit status; bugs leave as exceptions."""
    try:
        status = _command(list(arguments))
        if sys.stdout is not None:
            sys.stdout.flush()
    except (BrokenPipeError, SystemExit):  # typer turns the former into the latter, and exits for nothing else
        return CLOSED_PIPE
    except RingposeError as error:
        messages.error(error)
        return error.status
    except OSError as error:
        return _output_failed(error)
    except SignalReceived as received:
        return int(received.status)
    except KeyboardInterrupt:
        return 128 + signal.SIGINT
    return status


def run() -> None:
    """The entry point of the `ringpose` command."""
    try:
        raise_signals()
        gc.set_threshold(GARBAGE_FROM)
        for stream in (sys.stdin, sys.stdout):
            if stream is not None:
                stream.reconfigure(encoding="utf-8", errors="surrogateescape")  # type: ignore[union-attr]
        status = main(sys.argv[1:])
    except SignalReceived as received:
        status = received.status
    _end_undisturbed()
    _drop_unwritten()
    sys.exit(status)


def _end_undisturbed() -> None:
    """Whoever presses Ctrl-C again and again may hit the moment in which signals cease to count."""
    while True:
        try:
            return ignore_signals()
        except SignalReceived:
            continue


def _command(arguments: list[str]) -> int:
    import typer

    from ringpose.cli.app import app

    named = [name for name in COMMANDS if [name] == arguments[:1]]
    for name in named or COMMANDS:
        import_module(f"ringpose.cli.{COMMANDS[name]}")
    wrong_words: Any = typer.BadParameter.__mro__[1]  # UsageError of the click inside typer, which has no public name
    try:
        return int(app(arguments, prog_name="ringpose", standalone_mode=False) or 0)
    except wrong_words as error:
        if type(error).__name__ == "NoArgsIsHelpError":
            sys.stderr.write(error.format_message().rstrip() + "\n")
            return UsageError.status
        path = getattr(getattr(error, "ctx", None), "command_path", "ringpose")
        raise UsageError("", error.format_message().rstrip("."), f"see {path} --help") from None
    except typer.Abort:
        return 128 + signal.SIGINT


def _output_failed(error: OSError) -> int:
    """An error of the last flush of stdout, or of a file of which nobody expected it."""
    from ringpose.errors import InputOutputError

    reason = (error.strerror or str(error)).lower()
    if error.filename is None:
        messages.error(InputOutputError("standard output", f"writing broke off: {reason}"))
    else:
        messages.error(InputOutputError(str(error.filename), f"reading or writing broke off: {reason}"))
    return InputOutputError.status


def _drop_unwritten() -> None:
    """What stdout could not take, Python would try to write once more at exit, and complain."""
    try:
        if sys.stdout is not None:
            sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


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
