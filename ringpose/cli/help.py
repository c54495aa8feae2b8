"""`ringpose help`: the manual pages, also where there is no `man`."""

from pathlib import Path
from typing import Annotated

import typer

from ringpose.cli.app import app

Topic = Annotated[
    list[str] | None,
    typer.Argument(metavar="[COMMAND|TOPIC]", help="A command or a topic of the manual; without it they are listed."),
]

VIEWERS = (("man",), ("mandoc", "-a"))
"""Programs that show a page, given the path of its file."""


@app.command("help")
def show_help(topic: Topic = None) -> None:
    """Show the manual page of a command or topic, or list them all."""
    from ringpose.cli.manual.pages import page_of

    if not topic:
        typer.echo(topics_listed())
        return
    path = page_of(topic).path
    if not _is_shown(path):
        import pydoc

        from ringpose.cli.manual.mdoc import plain_text

        pydoc.pager(plain_text(path.read_text(encoding="utf-8")))  # to a file or pipe, it only writes


def topics_listed() -> str:
    """One line for each command and topic of the manual."""
    from ringpose.cli.manual.pages import manual_pages

    pages = manual_pages().values()
    width = max(len(page.topic) for page in pages)
    lines = []
    for heading, sections in (("Commands", "1"), ("Topics", "57")):
        lines += [f"{heading}:"]
        lines += [f"  {page.topic:<{width}}  {page.description}" for page in pages if page.section in sections]
        lines += [""]
    return "\n".join([*lines, "ringpose help NAME shows the page of one of these, as man ringpose-NAME does."])


def _is_shown(path: Path) -> bool:
    """Whether one of the viewers is installed and has shown the page."""
    import shutil
    import subprocess

    for program, *options in VIEWERS:
        executable = shutil.which(program)
        words = [executable or "", *options, str(path)]
        # what it reports is of its own, such as tables wider than the terminal; if it fails, the text is shown instead
        if executable and subprocess.run(words, check=False, stderr=subprocess.DEVNULL).returncode == 0:  # noqa: S603
            return True
    return False
