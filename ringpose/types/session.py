"""A capture: its laser sequence, the lasers and exposure of each frame of a shot, its devices and its shots.

Sequences are written as `off,1,2,3,off` or `off,all@500us,all@4ms`.
"""

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from ringpose.errors import UsageError
from ringpose.types.record import Form, Key, Presence

MAX_LASERS = 8
"""A mask is one byte."""

_STEP = re.compile(r"[1-9][0-9]{0,3}(\+[1-9][0-9]{0,3})*")

_EXPOSURE = re.compile(r"([0-9]{1,12}(?:\.[0-9]{1,12})?)(us|ms|s)")

_UNIT_S = {"us": 1e-6, "ms": 1e-3, "s": 1.0}


@dataclass(frozen=True, slots=True)
class Step:
    """One frame of a shot: which lasers are on."""

    text: str
    """`off`, `all`, or 1-based laser numbers joined by `+`, as given by the user."""
    exposure: str = ""
    """Exposure such as `500us`; empty for the default exposure."""

    @property
    def written(self) -> str:
        """The step in the syntax of a sequence."""
        return f"{self.text}@{self.exposure}" if self.exposure else self.text

    @property
    def exposure_s(self) -> float | None:
        """Exposure of this frame; None for the default exposure."""
        return seconds_of(self.exposure)

    def mask(self, count: int) -> int:
        """Bit i for laser i of a rig with `count` lasers; a number beyond them is an error."""
        if self.text == "off":
            return 0
        if self.text == "all":
            return (1 << count) - 1
        numbers = [int(number) for number in self.text.split("+")]
        if max(numbers) > count:
            lasers = "1 laser" if count == 1 else f"{count} lasers"
            raise UsageError("--sequence", f'step "{self.text}" names laser {max(numbers)} of a rig with {lasers}')
        return sum(1 << (number - 1) for number in numbers)


def seconds_of(text: str) -> float | None:
    """A time with its unit, as 500us, 4ms or 0.5s, in seconds; None if the text is not one."""
    match = _EXPOSURE.fullmatch(text)
    return None if match is None else float(match[1]) * _UNIT_S[match[2]]


def parsed_sequence(text: str) -> tuple[Step, ...]:
    """The steps of a sequence: separated by commas, each `off`, `all` or laser numbers joined by `+`.

    A step may be followed by `@` and an exposure in us, ms or s.
    """
    return tuple(_parsed_step(word.strip(), place) for place, word in enumerate(text.split(","), start=1))


def written_sequence(steps: Iterable[Step]) -> str:
    """The steps in the syntax of a sequence."""
    return ",".join(step.written for step in steps)


def steps_of(masks: Iterable[int], count: int) -> tuple[Step, ...]:
    """The steps for these laser masks on a rig with `count` lasers."""
    texts = ["+".join(str(bit + 1) for bit in range(MAX_LASERS) if mask >> bit & 1) or "off" for mask in masks]
    every = "+".join(str(bit + 1) for bit in range(count))
    return tuple(Step("all" if text == every else text) for text in texts)


def _parsed_step(word: str, place: int) -> Step:
    lasers, at, exposure = word.partition("@")
    step = Step(lasers, exposure)
    if lasers not in ("off", "all"):
        if not _STEP.fullmatch(lasers):
            remedy = "a step is off, all, or laser numbers from 1 joined by +"
            raise UsageError("--sequence", f'step {place} is "{lasers}"', remedy)
        numbers = lasers.split("+")
        if len(set(numbers)) < len(numbers):
            raise UsageError("--sequence", f'step {place}, "{word}", names a laser twice')
        if max(map(int, numbers)) > MAX_LASERS:
            raise UsageError("--sequence", f'step {place}, "{word}", names a laser beyond the {MAX_LASERS} of a mask')
    if at and not step.exposure_s:
        finding = f'step {place}, "{word}", has no exposure after its @'
        raise UsageError("--sequence", finding, "write it as 500us, 4ms or 0.5s")
    return step


CaptureState = Literal["capturing", "finished", "stopped"]
"""`capturing` in a folder that is no longer being written: the capture was aborted, and may have more shots than
listed."""


SESSION_FILE = "session.yaml"
"""Name of the file in a session folder that lists its captures."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Capture:
    """One run of `ringpose capture`; URIs are as given by the user."""

    camera: Annotated[str, Key("URI, as it was given.")]
    camera_name: Annotated[
        str | None, Key("The camera's own name; missing if it does not report one.", presence=Presence.IF_KNOWN)
    ] = None
    lasers: Annotated[str, Key("URI, as it was given.")]
    laser_count: Annotated[
        int | None,
        Key(
            "Number of lasers; missing if the device does not report it.",
            least=1,
            most=MAX_LASERS,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    laser_names: Annotated[
        tuple[str, ...] | None,
        Key(
            "Names in the order of the mask's bits; missing if neither a rig nor a scene defines them.",
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    sequence: Annotated[
        str | None, Key("Missing for recorded shots that were imported unchanged.", presence=Presence.IF_KNOWN)
    ] = None
    exposure_s: Annotated[
        float | None, Key("Missing for the device's own setting.", least=0.0, presence=Presence.IF_KNOWN)
    ] = None
    rate_hz: Annotated[float | None, Key("Missing for as fast as possible.", least=0.0, presence=Presence.IF_KNOWN)] = (
        None
    )
    state: Annotated[
        CaptureState,
        Key(
            "`finished`; `stopped` by a signal or an error; `capturing`, also in a session whose capture was killed.",
            needed=True,
        ),
    ] = "capturing"
    shots: Annotated[
        tuple[str, ...],
        Key(
            "Names of the finished shots in chronological order; their files are NAME.npz.",
            form=Form.DISTINCT,
            needed=True,
        ),
    ] = ()
    provenance: Annotated[
        Mapping[str, Any], Key("Version, command line, time, and hashes of the inputs.", added=True)
    ] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Session:
    """The captures in one folder, the oldest first."""

    captures: Annotated[tuple[Capture, ...], Key("One for each run of `ringpose capture`, the oldest first.")]

    @property
    def shots(self) -> tuple[str, ...]:
        """Names of all shots in chronological order."""
        return tuple(shot for capture in self.captures for shot in capture.shots)
