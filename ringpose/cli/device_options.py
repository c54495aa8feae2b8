"""Options of the commands that take shots from devices."""

from typing import Annotated

import typer

LasersUri = Annotated[
    str | None,
    typer.Option(
        "--lasers", metavar="URI", help="lcus:PORT?ch=1,2,3, numato:, modbus:, ascii:, line:, sim:, none: (always on)."
    ),
]
Steps = Annotated[
    str | None,
    typer.Option("--sequence", metavar="STEPS", help="What is lit, frame by frame: off,1,2,3,off or off,all or 1+2."),
]
Exposure = Annotated[float | None, typer.Option("--exposure", metavar="S", min=1e-9, help="Exposure of each frame.")]
Count = Annotated[int | None, typer.Option("--count", metavar="N", min=1, help="Shots to take, at most.")]
Rate = Annotated[float | None, typer.Option("--rate", metavar="HZ", min=1e-3, help="Shots a second, at most.")]
Duration = Annotated[float | None, typer.Option("--duration", metavar="S", min=1e-3, help="Begin no shot after this.")]
Settle = Annotated[
    float | None, typer.Option("--settle", metavar="S", min=0.0, max=10.0, help="From switching to exposing.")
]
AllowUnseen = Annotated[bool, typer.Option("--allow-unseen", help="Keep shots in which a laser does not show.")]
