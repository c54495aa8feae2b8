"""The Typer application with which every subcommand registers."""

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
    epilog="Each command has a manual page: man ringpose-pose. Exit statuses: man ringpose-conventions.",
    no_args_is_help=True,
    add_completion=False,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)


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
