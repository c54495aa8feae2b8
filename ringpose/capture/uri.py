"""Device URIs, such as `aravis://192.168.0.5?format=Mono12` or `lcus:/dev/ttyUSB0?ch=1,2,3`, and their drivers.

Drivers are registered as entry points of the groups `ringpose.cameras` and `ringpose.lasers`, named by their scheme;
an installed package can add its own. A driver is imported only when a URI uses it. `Device` is what all drivers share.
"""

import difflib
import functools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from types import TracebackType
from typing import Any, Protocol, TypeVar, runtime_checkable
from urllib.parse import parse_qsl

from ringpose.errors import UsageError

CAMERAS = "ringpose.cameras"

LASERS = "ringpose.lasers"


@dataclass(frozen=True, slots=True, kw_only=True)
class DeviceUri:
    """The parts of a device URI: `scheme:address?key=value&key=value`."""

    text: str
    """The URI as the user wrote it."""
    option: str
    """The command-line option, for messages."""
    scheme: str
    address: str
    """The part between the colon (and slashes) and the question mark."""
    parameters: Mapping[str, str]

    def problem(self, finding: str, remedy: str = "") -> UsageError:
        """The error to raise for this URI."""
        return UsageError(f"{self.option} {self.text}", finding, remedy)

    def reject_unknown(self, known: Sequence[str]) -> None:
        """Reject all parameters but these."""
        for key in self.parameters:
            if key not in known:
                near = difflib.get_close_matches(key, known, n=1)
                remedy = f"did you mean {near[0]}?" if near else f"it takes {', '.join(known) or 'none'}"
                raise self.problem(f'has no parameter "{key}"', remedy)

    def number(
        self, key: str, default: int | float, minimum: int | float = -math.inf, maximum: int | float = math.inf
    ) -> float:
        """A parameter that is a number within these bounds."""
        try:
            value = float(self.parameters.get(key, default))
        except ValueError:
            value = math.nan
        if not math.isfinite(value):
            raise self.problem(f'{key} is "{self.parameters[key]}", must be a number')
        if not minimum <= value <= maximum:
            raise self.problem(f'{key} is "{self.parameters[key]}"', f"it takes {minimum:.15g} to {maximum:.15g}")
        return value

    def whole(self, key: str, default: int, maximum: int, minimum: int = 0) -> int:
        """A parameter that is an integer within these bounds."""
        value = self.number(key, default, minimum, maximum)
        if not value.is_integer():
            raise self.problem(f'{key} is "{self.parameters[key]}", must be a whole number')
        return int(value)


def schemes(group: str) -> tuple[str, ...]:
    """The schemes for which drivers are registered."""
    return tuple(sorted(_registered(group)))


def driver(group: str, scheme: str) -> Any:
    """The registered factory of a scheme, imported now: it makes a driver from a `DeviceUri`."""
    return _registered(group)[scheme].load()


@functools.cache  # to go through all installed packages takes 10 ms
def _registered(group: str) -> Mapping[str, EntryPoint]:
    """The first entry point of each scheme."""
    return {entry.name: entry for entry in reversed(entry_points(group=group))}


def device_uri(text: str, option: str, group: str) -> DeviceUri:
    """The parts of a URI; its scheme must be registered."""
    scheme, rest = scheme_and_rest(text, option, schemes(group))
    address, _, query = rest.removeprefix("//").partition("?")
    pairs = parse_qsl(query, keep_blank_values=True)
    uri = DeviceUri(text=text, option=option, scheme=scheme, address=address, parameters=dict(pairs))
    keys = [key for key, _ in pairs]
    twice = next((key for key in keys if keys.count(key) > 1), None)
    if twice is not None:
        raise uri.problem(f"gives {twice}= twice")
    return uri


def scheme_and_rest(uri: str, option: str, schemes: Sequence[str]) -> tuple[str, str]:
    """The parts before and after the first colon; the scheme must be one of `schemes`."""
    scheme, colon, rest = uri.partition(":")
    if not colon or scheme not in schemes:
        near = difflib.get_close_matches(scheme, schemes, n=1)
        known = ", ".join(f"{known}:" for known in schemes)
        remedy = f"did you mean {near[0]}:{rest}?" if near else f"it begins with one of {known}"
        raise UsageError(option, f'"{uri}" names no device', remedy)
    return scheme, rest


_Opened = TypeVar("_Opened", bound="Device")


@runtime_checkable
class Device(Protocol):
    """A device that is opened and closed; a driver that derives from this is a context manager."""

    def open(self) -> None:
        """Open the device; raises `DeviceError` if that fails."""

    def close(self) -> None:
        """Close the device; closing it twice does nothing."""

    def __enter__(self: _Opened) -> _Opened:
        try:
            self.open()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
