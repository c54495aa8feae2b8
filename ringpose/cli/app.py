"""The Typer application with which every subcommand registers, and options that are defined in groups."""

from collections.abc import Callable
from dataclasses import fields, is_dataclass
from functools import wraps
from inspect import signature
from typing import Annotated, Any

import typer
from typer.core import TyperGroup


class TwoWords(TyperGroup):
    """A command group in which `simulate serve` can be a command of its own beside `simulate`."""

    def resolve_command(self, ctx: Any, args: list[str]) -> Any:
        """The command with the longest name that the arguments begin with."""
        name = " ".join(args[:2])
        if name in self.commands and " " in name:
            return name, self.commands[name], args[2:]
        return super().resolve_command(ctx, args)


app = typer.Typer(
    name="ringpose",
    cls=TwoWords,
    help="Pose of a satellite's launch-adapter ring from one camera and line lasers.",
    epilog="Each command has a manual page: ringpose help pose, or man ringpose-pose. All pages: ringpose help.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def with_option_groups(command: Callable[..., None]) -> Callable[..., None]:
    """The command for Typer, in which a parameter whose type is a data class is replaced by one option for each field.

    A group of options that several commands share is thus defined once, by its data class, whose fields have defaults
    and are annotated with `typer.Option`. The command receives the group as one value.
    """
    groups: dict[str, Any] = {}
    options = []
    for parameter in signature(command).parameters.values():
        if not is_dataclass(parameter.annotation):
            options.append(parameter)
            continue
        groups[parameter.name] = parameter.annotation
        for field in fields(parameter.annotation):
            options.append(parameter.replace(name=field.name, default=field.default, annotation=field.type))

    @wraps(command)
    def called(**values: Any) -> None:
        for name, group in groups.items():
            values[name] = group(**{field.name: values.pop(field.name) for field in fields(group)})
        command(**values)

    called.__signature__ = signature(command).replace(parameters=options)  # type: ignore[attr-defined]
    return called


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
