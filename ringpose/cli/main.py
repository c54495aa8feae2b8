"""The entry point: signals become exceptions, errors become exit statuses."""

import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType

import typer

from ringpose.cli import messages
from ringpose.cli.app import app
from ringpose.errors import CLOSED_PIPE, RingposeError, SignalReceived, UsageError

_WRONG_WORDS: type[Exception] = typer.BadParameter.__mro__[1]
"""UsageError of the click inside typer, which has no public name."""


def main(arguments: Sequence[str]) -> int:
    """Run one command line and return its exit status; bugs leave as exceptions."""
    try:
        status = app(list(arguments), standalone_mode=False)
        sys.stdout.flush()
    except _WRONG_WORDS as error:
        messages.error(UsageError("", error.format_message(), "see ringpose --help"))  # type: ignore[attr-defined]
        return UsageError.status
    except typer.Abort:
        return 128 + signal.SIGINT
    except BrokenPipeError:
        return CLOSED_PIPE
    except RingposeError as error:
        messages.error(error)
        return error.status
    except SignalReceived as received:
        return int(received.status)
    return int(status or 0)


def run() -> None:
    """The entry point of the `ringpose` command."""
    for number in (signal.SIGHUP, signal.SIGINT, signal.SIGTERM):
        signal.signal(number, _raise)
    status = main(sys.argv[1:])
    if status == CLOSED_PIPE:  # what Python still holds for stdout would raise again at exit
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    sys.exit(status)


def _raise(number: int, frame: FrameType | None) -> None:
    raise SignalReceived(number)
