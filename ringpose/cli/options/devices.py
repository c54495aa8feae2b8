"""Options of the commands that take shots from devices."""

import math
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from ringpose.cli.options.common import finite
from ringpose.errors import UsageError

if TYPE_CHECKING:
    from ringpose.types.session import Step

MAX_SETTLE_S = 10.0

MIN_EXPOSURE_S = 1e-9

MAX_SHOTS = 10**9


def settle_time(text: str) -> float | Literal["auto"]:
    """Seconds, or `auto`."""
    if text == "auto":
        return "auto"
    try:
        settle_s = float(text)
    except ValueError:
        settle_s = -1.0
    if not 0 <= settle_s <= MAX_SETTLE_S:
        raise UsageError("--settle", f'"{text}"', f"it is auto, or seconds from 0 to {MAX_SETTLE_S:g}")
    return settle_s


def exposure_time(text: str) -> float | Literal["auto"]:
    """Seconds, or `auto`."""
    if text == "auto":
        return "auto"
    try:
        exposure_s = float(text)
    except ValueError:
        exposure_s = -1.0
    if not MIN_EXPOSURE_S <= exposure_s < math.inf:
        raise UsageError("--exposure", f'"{text}"', f"it is auto, or seconds from {MIN_EXPOSURE_S:g}")
    return exposure_s


def steps(text: str) -> "tuple[Step, ...]":
    """The steps of a sequence."""
    from ringpose.types.session import parsed_sequence

    return parsed_sequence(text)


LasersUri = Annotated[
    str | None,
    typer.Option(
        "--lasers", metavar="URI", help="lcus:PORT?ch=1,2,3, numato:, modbus:, ascii:, line:, sim:, none: (always on)."
    ),
]
Steps = Annotated[
    Any,
    typer.Option(
        "--sequence",
        metavar="STEPS",
        parser=steps,
        help="What is lit, frame by frame: off,1,2,3,off or off,all or 1+2.",
    ),
]
Exposure = Annotated[
    Any,
    typer.Option(
        "--exposure", metavar="S|auto", parser=exposure_time, help="Exposure of each frame; auto: by the stripes."
    ),
]
Count = Annotated[
    int | None, typer.Option("--count", metavar="N", min=1, max=MAX_SHOTS, help="Shots to take, at most.")
]
Rate = Annotated[
    float | None, typer.Option("--rate", metavar="HZ", min=1e-3, callback=finite, help="Shots a second, at most.")
]
Duration = Annotated[
    float | None, typer.Option("--duration", metavar="S", min=1e-3, callback=finite, help="Begin no shot after this.")
]
Settle = Annotated[
    Any,
    typer.Option(
        "--settle", metavar="S|auto", parser=settle_time, help="From switching to exposing; auto: measured first."
    ),
]
AllowUnseen = Annotated[bool, typer.Option("--allow-unseen", help="Keep shots in which a laser does not show.")]
