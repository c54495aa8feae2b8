"""The application object that every subcommand registers itself on."""

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


@app.callback()
def _options(
    show_version: bool = typer.Option(False, "--version", help="Print the version and exit."),
) -> None:
    if show_version:
        from importlib.metadata import version

        typer.echo(f"ringpose {version('ringpose')}")
        raise typer.Exit
