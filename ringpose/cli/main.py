"""The application: subcommands, signals, and errors turned into exit statuses."""

import os
import signal
import sys
from collections.abc import Sequence
from types import FrameType

import typer

from ringpose.cli import messages
from ringpose.errors import CLOSED_PIPE, NO_POSE, RingposeError, SignalReceived, UsageError

app = typer.Typer(
    name="ringpose",
    help="Pose of a satellite's launch-adapter ring from one camera and line lasers.",
    epilog="Each command has a manual page: man ringpose-pose. Exit statuses: man ringpose-conventions.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)

_WRONG_WORDS: type[Exception] = typer.BadParameter.__mro__[1]
"""UsageError of the click inside typer, which has no public name."""


@app.callback()
def _options(
    show_version: bool = typer.Option(False, "--version", help="Print the version and exit."),
) -> None:
    if show_version:
        from importlib.metadata import version

        typer.echo(f"ringpose {version('ringpose')}")
        raise typer.Exit


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


__all__ = ["NO_POSE", "app", "main", "run"]
