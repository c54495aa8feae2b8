"""What capture asks of a laser driver.

What a laser driver may have to know of its surroundings.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, TypeAlias, runtime_checkable

from ringpose.capture.uri import Device, DeviceUri
from ringpose.errors import DeviceError, LaserSafetyError
from ringpose.types.sequence import MAX_LASERS


class LasersWentOff(DeviceError):
    """Nobody was told to: what was taken since then shows too little light, and may be taken again."""


@runtime_checkable
class LaserDriver(Device, Protocol):
    """Lasers that a program switches; the `with` block ends with all of them off.

    Masks are those of the shots: bit i is laser i of the rig.
    """

    @property
    def count(self) -> int:
        """Number of lasers."""

    @property
    def settle_s(self) -> float:
        """From switching until the light is steady, if nobody measures it."""
        return 0.0

    @property
    def longest_on_s(self) -> float | None:
        """How long a laser may be on for one frame; None for ever."""
        return None

    def open(self) -> None:
        """Take the device and switch everything off; a `DeviceError` says what is in the way."""

    def set_mask(self, lasers: int) -> None:
        """Light exactly these: what has to go off goes off before what has to come on."""

    def read_mask(self) -> int | None:
        """What the board reports to be on; None if it cannot say."""

    def wait(self, duration_s: float) -> None:
        """Let time pass; a driver that notices the loss of its device meanwhile raises at once."""
        time.sleep(duration_s)

    def abort(self) -> None:
        """All off at once, said by another thread than the one that switches, which then fails and ends.

        Lasers that only one thread can reach burn to the end of their shot.
        """
        return

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._switch_off()
        except BaseException:  # a second signal must not leave a laser burning
            self._switch_off()
            raise
        finally:
            self.close()

    def _switch_off(self) -> None:
        try:
            self.set_mask(0)
            left_on = self.read_mask()
        except DeviceError as error:
            raise LaserSafetyError("lasers", f"could not be switched off: {error}", "cut the power") from error
        if left_on:
            raise LaserSafetyError(
                "lasers", f"reported on (mask {left_on}) after all were switched off", "cut the power"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserPlace:
    """The rig that the lasers belong to, and the camera that looks at them."""

    names: tuple[str, ...] | None = None
    """Of the rig's lasers, in its order; None where no rig is given."""
    camera: object | None = None
    """The camera's driver, which may also have output lines; None for a simulated one, made after its lasers."""


LaserFactory: TypeAlias = Callable[[DeviceUri, LaserPlace], LaserDriver]
"""What an entry point of the group `ringpose.lasers` names."""


def channels(uri: DeviceUri, place: LaserPlace) -> tuple[str, ...]:
    """The channel of each laser, in the rig's order: `ch=1,2,3`, or by name `ch=left:1,right:3,middle:2`."""
    words = [word.strip() for word in uri.parameters.get("ch", "").split(",")]
    if not all(words):
        raise uri.problem("does not say which channels feed the lasers (ch=)", "write it as ?ch=1,2,3")
    named = dict(word.partition(":")[::2] for word in words)
    by_name = any(":" in word for word in words)
    chosen = _by_name(uri, place, named, len(words)) if by_name else tuple(words)
    if len(set(chosen)) < len(chosen):
        raise uri.problem("names a channel twice (ch=)")
    if len(chosen) > MAX_LASERS:
        raise uri.problem(f"has {len(chosen)} channels; a mask has room for {MAX_LASERS} lasers")
    if place.names is not None and len(chosen) != len(place.names):
        raise uri.problem(f"has {len(chosen)} channels for the {len(place.names)} lasers of the rig")
    return chosen


def _by_name(uri: DeviceUri, place: LaserPlace, named: dict[str, str], count: int) -> tuple[str, ...]:
    if place.names is None:
        raise uri.problem("names lasers, but there is no rig that says their order", "add --rig FILE")
    if set(named) != set(place.names) or count != len(place.names) or not all(named.values()):
        raise uri.problem(f"must name each of the rig's lasers once: {', '.join(place.names)}")
    return tuple(named[name] for name in place.names)
