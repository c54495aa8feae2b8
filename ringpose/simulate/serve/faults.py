"""Injected faults in the syntax of the command line: `loss=0.002`, `stuck:2`, `late:3=0.05`."""

import math
from collections.abc import Iterable
from dataclasses import dataclass, field

from ringpose.errors import UsageError
from ringpose.simulate.serve.device import CameraFaults
from ringpose.simulate.serve.relays import RelayFaults

_LASER_FAULTS = ("stuck", "welded", "dark", "late")

_COUNTS = ("dead-camera", "unplug")

_VALUE_FAULTS = ("loss", "late", "operate", "release", *_COUNTS)

FAULTS = ("loss", "no-resend", "dead-camera", "keeps-lines", "unplug", "operate", "release", *_LASER_FAULTS)


@dataclass(frozen=True, slots=True, kw_only=True)
class InjectedFaults:
    """Injected faults of each device."""

    camera: CameraFaults = CameraFaults()
    contacts: RelayFaults = field(default_factory=RelayFaults)
    unplug_after: int | None = None
    """Number of frames after which the relay board is unplugged."""


@dataclass(frozen=True, slots=True, kw_only=True)
class _Fault:
    text: str
    name: str
    laser: int
    """Number of the laser from 0; -1 if none is given."""
    value: float


def parsed_faults(texts: Iterable[str], lasers: int) -> InjectedFaults:
    """The requested faults; lasers are numbered from 1."""
    faults = [_parsed(text, lasers) for text in texts]
    values = {fault.name: fault.value for fault in faults}
    lasers_of = {name: frozenset(fault.laser for fault in faults if fault.name == name) for name in _LASER_FAULTS}
    return InjectedFaults(
        camera=CameraFaults(
            loss=values.get("loss", 0.0),
            resends="no-resend" not in values,
            dies_after=_count(values, "dead-camera"),
            keeps_lines="keeps-lines" in values,
        ),
        contacts=RelayFaults(
            operate_s=values.get("operate", 0.0),
            release_s=values.get("release", 0.0),
            stuck=lasers_of["stuck"],
            welded=lasers_of["welded"],
            dead=lasers_of["dark"],
            late_s={fault.laser: fault.value for fault in faults if fault.name == "late"},
        ),
        unplug_after=_count(values, "unplug"),
    )


def _count(values: dict[str, float], name: str) -> int | None:
    return int(values[name]) if name in values else None


def _parsed(text: str, lasers: int) -> _Fault:
    words, equals, value = text.partition("=")
    name, colon, laser = words.partition(":")
    if name not in FAULTS:
        raise UsageError("--fault", f'"{text}" is not a fault', f"give one of {', '.join(FAULTS)}")
    if bool(colon) != (name in _LASER_FAULTS) or bool(equals) != (name in _VALUE_FAULTS):
        raise UsageError("--fault", f'"{text}" is not how {name} is asked for', f"say {_example(name)}")
    if colon and not (laser.isdecimal() and 1 <= int(laser) <= lasers):
        raise UsageError("--fault", f'"{text}" names no laser', f"lasers are numbered from 1 to {lasers}")
    try:
        number = float(value) if equals else 0.0
    except ValueError:
        number = -1.0
    is_possible = math.isfinite(number) and number >= 0.0
    if name in _COUNTS:
        is_possible = is_possible and number.is_integer() and number >= 1.0
    if not is_possible or (name == "loss" and number >= 1.0):
        raise UsageError("--fault", f'"{text}" has no possible value', f"say {_example(name)}")
    return _Fault(text=text, name=name, laser=int(laser) - 1 if colon else -1, value=number)


def _example(name: str) -> str:
    value = {"loss": "=0.002", "late": "=0.05", "operate": "=0.008", "release": "=0.004"}.get(name, "=20")
    return name + (":2" if name in _LASER_FAULTS else "") + (value if name in _VALUE_FAULTS else "")
