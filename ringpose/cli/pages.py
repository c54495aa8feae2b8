"""The pages that commands serve for browsers: the option of their port, and the line with their address."""

from typing import Annotated

import typer

PagePort = Annotated[
    int | None,
    typer.Option(
        "--port",
        metavar="PORT",
        min=1,
        max=65535,
        help="Port of the page at 127.0.0.1; by default 8080, or the next one that is free.",
    ),
]


def announce(port: int, asked: int | None) -> None:
    """Write the address of a page to stdout, and say on stderr that it is not the usual one."""
    from ringpose.cli import messages
    from ringpose.console.server import FIRST_PORT
    from ringpose.files import records

    if asked is None and port != FIRST_PORT:
        messages.echo(f"port {FIRST_PORT} is in use: the page is at port {port}")
    records.write({"page": f"http://127.0.0.1:{port}"})
