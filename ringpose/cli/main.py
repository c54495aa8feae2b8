"""The entry point: signals are converted into exceptions, and errors into exit statuses.

Signals are raised as exceptions so that `with` and `finally` blocks run and the lasers are switched off. Heavy modules
are imported only after the signal handlers are installed, so that an interrupt during start-up prints no traceback.
"""

import gc
import os
import re
import signal
import sys
import warnings
from collections.abc import Callable, Sequence
from functools import partial
from importlib import import_module
from types import FrameType
from typing import Any, TextIO

from ringpose.cli import messages
from ringpose.errors import CLOSED_PIPE, ImplausibleValueWarning, RingposeError, SignalReceived, UsageError

COMMANDS = {
    "capture": "capture",
    "calibrate-camera": "calibrate.camera",
    "calibrate-planes": "calibrate.planes",
    "calibrate-mount": "calibrate.mount",
    "convert-camera": "calibrate.convert_camera",
    "detect": "detect",
    "pose": "pose",
    "track": "track",
    "simulate": "simulate.render",
    "bench": "bench",
    "view": "view",
    "schema": "schema",
    "help": "help",
}
"""Module of each subcommand, in the order in which the help lists them."""

GARBAGE_FROM = 100_000
"""Allocations between two runs of the garbage collector. Start-up allocates 40 000 objects that all stay alive, and
collecting among them takes 5 % of its time; a shot leaves only a few dozen small objects."""


def main(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit status; bugs propagate as exceptions."""
    try:
        status = _command(list(arguments))
        if sys.stdout is not None:
            sys.stdout.flush()
    except BrokenPipeError:
        return CLOSED_PIPE
    except SystemExit as end:  # raised by Typer for a broken pipe, and with status 0 after a shell's completion
        return CLOSED_PIPE if end.code else 0
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
    """The entry point of the `ringpose` command.

    A signal may arrive at any instant. Until the block below has been left, it is raised inside it or by `main`; from
    then on it is without effect, so that it can neither change the status nor end in a traceback.
    """
    interrupts = Interrupts()
    try:
        raise_signals(interrupts)
        gc.set_threshold(GARBAGE_FROM)
        # the matrices of a shot are small: OpenBLAS, loaded with NumPy later, would share them between threads that
        # mostly wait for each other, which doubles the time of a shot in ambient light
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        for stream in (sys.stdin, sys.stdout):
            if stream is not None:
                stream.reconfigure(encoding="utf-8", errors="surrogateescape")  # type: ignore[union-attr]
        status = main(sys.argv[1:])
        interrupts.are_over = True
    except SignalReceived as received:  # while it is handled, another one is not raised
        interrupts.are_over = True
        status = received.status
    ignore_signals()
    if interrupts.number and sys.stdout is not None:
        _discard(sys.stdout)  # its reader may have stopped reading, and no signal could end the wait for it
    _discard_unwritten_output()
    sys.exit(status)


def _show_warning(
    show: Callable[..., None], message: Warning | str, category: type[Warning], *where: Any, **more: Any
) -> None:
    """Print a warning of an implausible value as one line, and any other as Python does."""
    if issubclass(category, ImplausibleValueWarning):
        messages.echo(str(message))
    else:
        show(message, category, *where, **more)


def _command(arguments: list[str]) -> int:
    import typer

    from ringpose.cli.app import app

    # Only the module of the command that runs is imported; --help without a command needs all of them.
    requested = [name for name in COMMANDS if [name] == arguments[:1]]
    messages.HEADING.program, messages.HEADING.has_time = " ".join(["ringpose", *requested]), False
    for name in requested or COMMANDS:
        import_module(f"ringpose.cli.{COMMANDS[name]}")
    click_usage_error: Any = typer.BadParameter.__mro__[1]  # has no public name in Typer's copy of click
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("default", ImplausibleValueWarning)
            warnings.showwarning = partial(_show_warning, warnings.showwarning)
            return int(app(arguments, prog_name="ringpose", standalone_mode=False) or 0)
    except click_usage_error as error:
        if type(error).__name__ == "NoArgsIsHelpError":
            sys.stderr.write(error.format_message().rstrip() + "\n")
            return UsageError.status
        path = getattr(getattr(error, "ctx", None), "command_path", "ringpose")
        finding = re.sub(r"a valid (int|float)( range)?\b", _number_kind, error.format_message().rstrip("."))
        raise UsageError("", finding, f"see {path} --help") from None
    except typer.Abort as abort:  # what Typer makes of an EOFError, such as that of a truncated file of byte code
        raise abort.__cause__ or abort from None


def _number_kind(match: re.Match[str]) -> str:
    """What Typer calls a valid int or float, with or without range."""
    return "a whole number" if match[1] == "int" else "a number"


def _output_failed(error: OSError) -> int:
    """Report an error of the last flush of stdout, or of a file operation that was not expected to fail."""
    from ringpose.errors import InputOutputError

    reason = (error.strerror or str(error)).lower()
    if error.filename is None:
        messages.error(InputOutputError("standard output", f"writing broke off: {reason}"))
    else:
        messages.error(InputOutputError(str(error.filename), f"reading or writing broke off: {reason}"))
    return InputOutputError.status


def _discard_unwritten_output() -> None:
    """Discard output and messages that cannot be written; else Python tries again at exit, and ends with status 120."""
    for stream in (sys.stdout, sys.stderr):
        try:
            if stream is not None:
                stream.flush()
        except OSError:
            _discard(stream)


def _discard(stream: TextIO) -> None:
    """Redirect a stream to /dev/null."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), stream.fileno())


AGAIN_S = 0.1
"""Delay after which the exception of a signal is raised again if it was lost."""

ENDING = (signal.SIGHUP, signal.SIGINT, signal.SIGTERM)


def raise_signals(interrupts: "Interrupts") -> None:
    """Raise the signals that end a program as exceptions, except those that it was started to ignore."""
    sys.unraisablehook = interrupts.report_unraisable
    signal.signal(signal.SIGALRM, interrupts)
    for number in ENDING:
        if signal.getsignal(number) != signal.SIG_IGN:  # nohup, or a shell's background job
            signal.signal(number, interrupts)


def ignore_signals() -> None:
    """Ignore all signals that end a program, since it is about to exit."""
    signal.setitimer(signal.ITIMER_REAL, 0)
    for number in (*ENDING, signal.SIGALRM):
        signal.signal(number, signal.SIG_IGN)


class Interrupts:
    """Signal handler that raises one exception, and repeats it until the exception propagates.

    Raising it once is not enough, since foreign code may swallow it (an import in C clears all errors, a destructor
    cannot raise). While a `with` or `finally` block cleans up after it, further signals do not interrupt the clean-up.
    """

    def __init__(self) -> None:
        self.number = 0
        """The signal that is raised; 0 if none has arrived."""
        self.are_over = False
        """Whether signals are without effect, since the exit status is known."""

    def __call__(self, number: int, frame: FrameType | None) -> None:
        """Handle a signal."""
        if self.are_over:
            return
        self.number = self.number or number
        signal.setitimer(signal.ITIMER_REAL, AGAIN_S)
        if not _is_propagating(sys.exception()):
            raise SignalReceived(self.number)

    def report_unraisable(self, unraisable: Any) -> None:
        """Print the error of a destructor, unless a signal may have interrupted the constructor of its object."""
        if not self.number:
            sys.__unraisablehook__(unraisable)


def _is_propagating(error: BaseException | None) -> bool:
    """Whether a `SignalReceived` is being handled, by itself or as the context of another exception."""
    while error is not None and not isinstance(error, SignalReceived):
        error = error.__context__
    return error is not None
