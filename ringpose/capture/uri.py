"""Devices by name: `files:shots`, `sim:scene.yaml`, `aravis://192.168.0.5?format=Mono12`, `lcus:/dev/ttyUSB0?ch=1,2,3`.

Which schemes there are, entry points say: the groups `ringpose.cameras` and `ringpose.lasers`, each entry named by its
scheme. An installed package may add its own; nothing is imported before it is asked for by name.

What every device has in common.
"""

import difflib
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import entry_points
from types import TracebackType
from typing import Any, Protocol, runtime_checkable
from urllib.parse import parse_qsl

from ringpose.errors import UsageError

CAMERAS = "ringpose.cameras"

LASERS = "ringpose.lasers"


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceUri:
    """A device's URI in its parts: `scheme:place?key=value&key=value`."""

    text: str
    """As the user wrote it."""
    option: str
    """The option that it was given with."""
    scheme: str
    place: str
    """Between the colon (and slashes) and the question mark."""
    parameters: Mapping[str, str]

    def problem(self, found: str, remedy: str = "") -> UsageError:
        """What is wrong with it, for the user."""
        return UsageError(f"{self.option} {self.text}", found, remedy)

    def refuse_unknown(self, known: Sequence[str]) -> None:
        """Only these parameters may be given."""
        for key in self.parameters:
            if key not in known:
                near = difflib.get_close_matches(key, known, n=1)
                remedy = f"did you mean {near[0]}?" if near else f"it takes {', '.join(known) or 'none'}"
                raise self.problem(f'has no parameter "{key}"', remedy)

    def number(
        self, key: str, default: int | float, least: int | float = -math.inf, most: int | float = math.inf
    ) -> float:
        """A parameter that is a number within these bounds."""
        try:
            value = float(self.parameters.get(key, default))
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.problem(f'{key} is "{self.parameters[key]}", must be a number')
        if not least <= value <= most:
            raise self.problem(f'{key} is "{self.parameters[key]}"', f"it takes {least:.15g} to {most:.15g}")
        return value

    def whole(self, key: str, default: int, most: int, least: int = 0) -> int:
        """A parameter that counts something."""
        value = self.number(key, default, least, most)
        if not value.is_integer():
            raise self.problem(f'{key} is "{self.parameters[key]}", must be a whole number')
        return int(value)


def schemes(group: str) -> tuple[str, ...]:
    """The names under which drivers are registered."""
    return tuple(sorted({entry.name for entry in entry_points(group=group)}))


def driver(group: str, scheme: str) -> Any:
    """What is registered under a name, imported now: it makes a driver of a `DeviceUri`."""
    return next(iter(entry_points(group=group, name=scheme))).load()


def device_uri(text: str, option: str, group: str) -> DeviceUri:
    """The URI in its parts; its scheme must be one of those registered."""
    scheme, rest = scheme_and_rest(text, option, schemes(group))
    place, _, query = rest.removeprefix("//").partition("?")
    pairs = parse_qsl(query, keep_blank_values=True)
    uri = DeviceUri(text=text, option=option, scheme=scheme, place=place, parameters=dict(pairs))
    twice = next((key for key in uri.parameters if [each for each, _ in pairs].count(key) > 1), None)
    if twice is not None:
        raise uri.problem(f"gives {twice}= twice")
    return uri


def scheme_and_rest(uri: str, option: str, schemes: Sequence[str]) -> tuple[str, str]:
    """What stands before and after the first colon; the scheme must be one of those known."""
    scheme, colon, rest = uri.partition(":")
    if not colon or scheme not in schemes:
        near = difflib.get_close_matches(scheme, schemes, n=1)
        known = ", ".join(f"{known}:" for known in schemes)
        remedy = f"did you mean {near[0]}:{rest}?" if near else f"it begins with one of {known}"
        raise UsageError(option, f'"{uri}" names no device', remedy)
    return scheme, rest


@runtime_checkable
class Device(Protocol):
    """Something that is taken and let go of; a driver derives from this and gains the `with` block that ends closed."""

    def open(self) -> None:
        """Take the device; a `DeviceError` says what is in the way."""

    def close(self) -> None:
        """Let go of the device; closing twice does nothing."""

    def __enter__(self) -> None:
        try:
            self.open()
        except BaseException:
            self.close()
            raise

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
