"""Injected faults in the syntax of the command line: `loss=0.002`, `stuck:2`, `late:3=0.05`."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from ringpose.errors import UsageError
from ringpose.simulate.serve.device import CameraFaults
from ringpose.simulate.serve.relays import RelayFaults

FAULTS = {
    "loss": "loss=0.002",
    "no-resend": "no-resend",
    "dead-camera": "dead-camera=20",
    "keeps-lines": "keeps-lines",
    "unplug": "unplug=20",
    "operate": "operate=0.008",
    "release": "release=0.004",
    "stuck": "stuck:2",
    "welded": "welded:2",
    "dark": "dark:2",
    "late": "late:2=0.05",
}
"""An example of each fault, which shows whether it is of one laser (`:2`) and whether it has a value (`=20`)."""

_COUNTS = ("dead-camera", "unplug")
"""Faults whose value is a number of frames."""


@dataclass(frozen=True, slots=True, kw_only=True)
class InjectedFaults:
    """Injected faults of each device."""

    camera: CameraFaults = CameraFaults()
    contacts: RelayFaults = field(default_factory=RelayFaults)
    unplug_after: int | None = None
    """Number of frames after which the relay board is unplugged."""


def parsed_faults(texts: Iterable[str], lasers: int) -> InjectedFaults:
    """The requested faults; lasers are numbered from 1 in the texts."""
    faults = [_parsed(text, lasers) for text in texts]
    values = {name: value for name, _, value in faults}
    counts = {name: int(values[name]) for name in _COUNTS if name in values}

    def lasers_with(name: str) -> frozenset[int]:
        return frozenset(laser for other, laser, _ in faults if other == name)

    return InjectedFaults(
        camera=CameraFaults(
            loss=values.get("loss", 0.0),
            resends="no-resend" not in values,
            dies_after=counts.get("dead-camera"),
            keeps_lines="keeps-lines" in values,
        ),
        contacts=RelayFaults(
            operate_s=values.get("operate", 0.0),
            release_s=values.get("release", 0.0),
            stuck=lasers_with("stuck"),
            welded=lasers_with("welded"),
            dead=lasers_with("dark"),
            late_s={laser: value for name, laser, value in faults if name == "late"},
        ),
        unplug_after=counts.get("unplug"),
    )


def _parsed(text: str, lasers: int) -> tuple[str, int, float]:
    """Name, laser (from 0; -1 if none is given) and value (0 if none is given) of a fault."""
    head, equals, value = text.partition("=")
    name, colon, laser = head.partition(":")
    if name not in FAULTS:
        raise UsageError("--fault", f'"{text}" is not a fault', f"give one of {', '.join(FAULTS)}")
    example = FAULTS[name]
    if bool(colon) != (":" in example) or bool(equals) != ("=" in example):
        raise UsageError("--fault", f'"{text}" does not have the form of {name}', f"give {example}")
    if colon and not (laser.isdecimal() and 1 <= int(laser) <= lasers):
        raise UsageError("--fault", f'"{text}" does not name a laser', f"lasers are numbered from 1 to {lasers}")
    try:
        number = float(value) if equals else 0.0
    except ValueError:
        number = math.nan
    is_valid = math.isfinite(number) and number >= 0.0
    if name in _COUNTS:
        is_valid = is_valid and number.is_integer() and number >= 1.0
    if not is_valid or (name == "loss" and number >= 1.0):
        raise UsageError("--fault", f'"{text}" has an invalid value', f"give {example}")
    return name, int(laser) - 1 if colon else -1, number
