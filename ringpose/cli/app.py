"""The Typer application with which every subcommand registers, and the options that several commands share."""

from collections.abc import Callable
from copy import copy
from dataclasses import fields, is_dataclass
from enum import StrEnum
from functools import wraps
from inspect import cleandoc, signature
from math import isfinite
from pathlib import Path
from typing import Annotated, Any, get_args

import typer
from typer.core import TyperCommand, TyperGroup, TyperOption
from typer.models import CommandFunctionType

from ringpose.cli import messages
from ringpose.errors import UsageError
from ringpose.types.options import Method
from ringpose.types.options import PoseFrame as PoseFrame
from ringpose.types.plausible import Range


class Command(TyperCommand):
    """A command whose help lists its options by purpose, which is their `rich_help_panel`, and that can log times."""

    def __init__(self, name: str | None, **given: Any) -> None:
        super().__init__(name, **given)
        self.params.append(
            TyperOption(
                param_decls=["--log-times"],
                is_flag=True,
                is_eager=True,
                expose_value=False,
                callback=_log_times,
                help="Begin each message on stderr with the time (UTC).",
            )
        )

    def format_options(self, ctx: Any, formatter: Any) -> None:
        """Write the arguments, the options without a purpose of their own, and the others."""
        sections: dict[str, list[tuple[str, str]]] = {"Arguments": [], "Options": []}
        for parameter in self.get_params(ctx):
            row = parameter.get_help_record(ctx)
            if row is not None:
                purpose = getattr(parameter, "rich_help_panel", None) or "Options"
                title = "Arguments" if parameter.param_type_name == "argument" else purpose
                sections.setdefault(title, []).append(row)
        for title, rows in sections.items():
            if rows:
                with formatter.section(title):
                    formatter.write_dl(rows)


def _log_times(context: Any, option: Any, requested: bool | None) -> None:
    messages.HEADING.has_time = bool(requested)


class Commands(TyperGroup):
    """A command group in which `simulate serve` can be a command of its own beside `simulate`."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command with the longest name that the arguments begin with."""
        name = " ".join(args[:2])
        if name in self.commands and " " in name:
            return name, self.commands[name], args[2:]
        return super().resolve_command(ctx, args)

    def list_commands(self, ctx: Any) -> list[str]:
        """The names that a shell completes: of one word."""
        return [name for name in self.commands if " " not in name]

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write what each command does, in full."""
        rows = [(name, cleandoc(command.help or "").split("\n\n")[0]) for name, command in self.commands.items()]
        with formatter.section("Commands"):
            formatter.write_dl(rows)


class Application(typer.Typer):
    """Typer with commands whose options are listed by purpose."""

    def command(
        self, name: str | None = None, *, cls: type[TyperCommand] | None = Command, **given: Any
    ) -> Callable[[CommandFunctionType], CommandFunctionType]:
        """A decorator that registers a command."""
        return super().command(name, cls=cls, **given)


app = Application(
    name="ringpose",
    cls=Commands,
    help="Pose of a satellite's launch-adapter ring from one camera and line lasers.",
    epilog="Each command has a manual page: ringpose help pose, or man ringpose-pose. All pages: ringpose help.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def with_option_groups(command: Callable[..., None]) -> Callable[..., None]:
    """The command for Typer, in which a parameter whose type is a data class is replaced by one option for each field.

    A group of options that several commands share is thus defined once, by its data class, whose fields have defaults
    and are annotated with `typer.Option`. The command receives the group as one value. The help lists the group under
    the data class's `PURPOSE`, except options with a panel of their own.
    """
    groups: dict[str, Any] = {}
    options = []
    for parameter in signature(command).parameters.values():
        if not is_dataclass(parameter.annotation):
            options.append(parameter)
            continue
        group: Any = parameter.annotation
        groups[parameter.name] = group
        for field in fields(group):
            option = for_purpose(group.PURPOSE, field.type)
            options.append(parameter.replace(name=field.name, default=field.default, annotation=option))

    @wraps(command)
    def called(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group(**{field.name: values.pop(field.name) for field in fields(group)})
        command(**values)

    called.__signature__ = signature(command).replace(parameters=options)  # type: ignore[attr-defined]
    return called


def for_purpose(purpose: str, option: Any) -> Any:
    """A type that is annotated with `typer.Option`, listed under this purpose in the help if it states none itself."""
    value_type, info = get_args(option)
    listed = copy(info)
    listed.rich_help_panel = listed.rich_help_panel or purpose
    return Annotated[value_type, listed]


def _print_version(requested: bool) -> bool:
    if requested:
        from importlib.metadata import version

        typer.echo(f"ringpose {version('ringpose')}")
        raise typer.Exit
    return requested


@app.callback()
def _options(
    show_version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    pass


STDOUT = "-"

ASSUMED, DEVICES, KNOWN_RING, LIMITS, OUTPUT, ROBOT, TRACK = (
    "What is assumed",
    "Camera and lasers",
    "What is known of the ring",
    "Limits",
    "Output",
    "Robot",
    "Track",
)
"""Purposes of options by which several commands list them."""


class Channel(StrEnum):
    """A channel of a colour image."""

    R = "r"
    G = "g"
    B = "b"


def finite(value: float | None) -> float | None:
    """The value; NaN, which passes Typer's bounds, and infinity are rejected."""
    if value is not None and not isfinite(value):
        raise typer.BadParameter(f"{value} is not a finite number")
    return value


def number_option(
    name: str, unit: str, meaning: str, least: int | float | None = None, most: int | float | None = None
) -> Any:
    """An option that takes a finite number within bounds."""
    return typer.Option(name, metavar=unit, min=least, max=most, callback=finite, help=meaning)


def file_option(*names: str, meaning: str, metavar: str = "FILE", purpose: str | None = None) -> Any:
    """An option that names a file or folder.

    A file that is not readable is reported when it is read, with its own exit status; Typer would report wrong usage.
    """
    return typer.Option(*names, readable=False, metavar=metavar, help=meaning, rich_help_panel=purpose)


def check_plausible(option: str, value: float | None, plausible: Range, remedy: str = "") -> None:
    """Reject the value of an option that is outside the range of its quantity; None is not given.

    `remedy` is for values that are plausible in no other unit.
    """
    if value is not None and not plausible.holds(value):
        finding, cause = plausible.finding(value)
        raise UsageError(option, finding, cause if plausible.likely(value) or not remedy else remedy)


def numbers(text: str | None, option: str, remedy: str, plausible: Range) -> list[float]:
    """The numbers of an option, separated by commas; UsageError unless all are in the range of their quantity."""
    try:
        parsed = [float(word) for word in text.split(",")] if text is not None else []
    except ValueError:
        raise UsageError(option, f"{text!r} is not a list of numbers", remedy) from None
    for number in parsed:
        check_plausible(option, number, plausible, remedy)
    return parsed


PoseMethod = Annotated[Method, typer.Option("--method", help="How the pose is computed.")]
_INPUTS = typer.Argument(metavar="INPUT...", help="Files or folders; - reads names or records from stdin, one a line.")
Inputs = Annotated[list[str], _INPUTS]
OptionalInputs = Annotated[list[str] | None, _INPUTS]
RigFile = Annotated[Path, file_option("--rig", meaning="The calibrated rig (rig.yaml).")]
_BOARD = file_option("--board", meaning="The board file: its kind and its sizes.")
BoardFile = Annotated[Path, _BOARD]
OptionalBoardFile = Annotated[Path | None, _BOARD]
Overlay = Annotated[
    Path | None,
    file_option(
        "--overlay", metavar="DIR", meaning="Draw what was found into PNG files in this folder.", purpose=OUTPUT
    ),
]
Report = Annotated[
    Path | None,
    file_option("--report", meaning="Write an HTML page with pictures (needs matplotlib).", purpose=OUTPUT),
]


def check_report(report: Path | None, force: bool) -> None:
    """Reject a report, before any computation, that exists or that cannot be drawn."""
    from ringpose.files.atomic import reject_existing
    from ringpose.report.page import require_matplotlib

    if report is not None:
        require_matplotlib()
        reject_existing(report, force)


_OUTPUT = file_option("--output", "-o", meaning="Where the result is written.", purpose=OUTPUT)
OutputFile = Annotated[Path, _OUTPUT]
CalibrationOutput = Annotated[
    Path | None,
    file_option("--output", "-o", meaning="Where the result is written; required to calibrate.", purpose=OUTPUT),
]
JsonFile = Annotated[
    str | None,
    typer.Option("--json", metavar="FILE", help="All figures as JSON; - instead of tables.", rich_help_panel=OUTPUT),
]
CsvFile = Annotated[
    str | None,
    typer.Option("--csv", metavar="FILE", help="The rows as CSV; - instead of tables.", rich_help_panel=OUTPUT),
]
Force = Annotated[bool, typer.Option("--force", help="Replace output that exists already.", rich_help_panel=OUTPUT)]
ImageChannel = Annotated[
    Channel | None, typer.Option("--channel", help="Read this channel of colour images; else their luminance.")
]
Verbose = Annotated[bool, typer.Option("--verbose", "-v", help="Report the result of each input on stderr.")]
Quiet = Annotated[bool, typer.Option("--quiet", "-q", help="No progress on stderr, only errors.")]
