"""Options of the commands that take shots from devices."""

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Annotated, Any, ClassVar, Literal

import typer

from ringpose.cli.app import DEVICES, finite
from ringpose.errors import UsageError

if TYPE_CHECKING:
    from ringpose.capture.source import CaptureRequest
    from ringpose.types.rig import Rig
    from ringpose.types.session import Step

MAX_SETTLE_S = 10.0

MIN_EXPOSURE_S = 1e-9

MAX_SHOTS = 10**9


def seconds_or_auto(option: str, least_s: float, most_s: float, text: str) -> float | Literal["auto"]:
    """Seconds within bounds, or `auto`; a unit may be given, as in a sequence (4ms)."""
    from ringpose.types.session import seconds_of

    if text == "auto":
        return "auto"
    try:
        value_s = seconds_of(text) or float(text)
    except ValueError:
        value_s = math.nan
    if not (least_s <= value_s <= most_s and math.isfinite(value_s)):
        most = f" to {most_s:g}" if most_s < math.inf else ""
        raise UsageError(option, f'"{text}"', f"give auto, or seconds from {least_s:g}{most}, also as 5ms or 500us")
    return value_s


def settle_time(text: str) -> float | Literal["auto"]:
    """The value of --settle."""
    return seconds_or_auto("--settle", 0.0, MAX_SETTLE_S, text)


def exposure_time(text: str) -> float | Literal["auto"]:
    """The value of --exposure."""
    return seconds_or_auto("--exposure", MIN_EXPOSURE_S, math.inf, text)


def steps(text: str) -> "tuple[Step, ...]":
    """The steps of a sequence."""
    from ringpose.types.session import parsed_sequence

    return parsed_sequence(text)


@dataclass(frozen=True, slots=True)
class ShotOptions:
    """How shots are taken from devices, as given; named like the options."""

    PURPOSE: ClassVar = DEVICES

    lasers: Annotated[
        str | None,
        typer.Option(
            "--lasers",
            metavar="URI",
            help="lcus:PORT?ch=1,2,3, numato:, modbus:, ascii:, line:, sim:, none: (always on).",
        ),
    ] = None
    sequence: Annotated[
        Any,
        typer.Option(
            "--sequence",
            metavar="STEPS",
            parser=steps,
            help="What is lit, frame by frame: off,1,2,3,off or off,all or 1+2.",
        ),
    ] = None
    exposure: Annotated[
        Any,
        typer.Option(
            "--exposure", metavar="S|auto", parser=exposure_time, help="Exposure of each frame; auto: by the stripes."
        ),
    ] = None
    settle: Annotated[
        Any,
        typer.Option(
            "--settle", metavar="S|auto", parser=settle_time, help="From switching to exposing; auto: measured first."
        ),
    ] = None
    allow_unseen: Annotated[bool, typer.Option("--allow-unseen", help="Keep shots in which a laser does not show.")] = (
        False
    )
    count: Annotated[
        int | None, typer.Option("--count", metavar="N", min=1, max=MAX_SHOTS, help="Shots to take, at most.")
    ] = None
    duration: Annotated[
        float | None,
        typer.Option("--duration", metavar="S", min=1e-3, callback=finite, help="Begin no shot after this."),
    ] = None

    def request(self, camera: str, rig: "Rig | None", **more: Any) -> "CaptureRequest":
        """The request for a capture with these options, by the URI of a camera and the rig that it belongs to.

        `more` are further attributes of the request.
        """
        from ringpose.capture.source import CaptureRequest

        return CaptureRequest(
            camera=camera,
            lasers=self.lasers,
            steps=self.sequence,
            exposure_s=self.exposure,
            settle_s=self.settle,
            allow_missing=self.allow_unseen,
            count=self.count,
            duration_s=self.duration,
            laser_names=None if rig is None else rig.lasers.names,
            rig=rig,
            **more,
        )
