"""The application object that every subcommand registers itself on."""

from typing import Annotated

import typer

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


def _print_version(wanted: bool) -> bool:
    if wanted:
        from importlib.metadata import version

        typer.echo(f"ringpose {version('ringpose')}")
        raise typer.Exit
    return wanted


@app.callback()
def _options(
    show_version: Annotated[
        bool, typer.Option("--version", help="Print the version and exit.", callback=_print_version, is_eager=True)
    ] = False,
) -> None:
    pass
