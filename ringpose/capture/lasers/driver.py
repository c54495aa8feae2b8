"""The interface of laser drivers, and what their factories receive."""

import time
from collections.abc import Callable
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, TypeAlias, runtime_checkable

from ringpose.capture.uri import Device, DeviceUri
from ringpose.errors import DeviceError, LaserSafetyError
from ringpose.types.session import MAX_LASERS


class LasersWentOff(DeviceError):
    """Lasers went off without a command; frames taken since then lack light, and the shot can be repeated."""


@runtime_checkable
class LaserDriver(Device, Protocol):
    """Lasers that can be switched; the `with` block ends with all of them off.

    In masks, bit i is laser i of the rig.
    """

    @property
    def count(self) -> int:
        """Number of lasers."""

    @property
    def settle_s(self) -> float:
        """Default time from switching until the light is steady."""
        return 0.0

    @property
    def longest_on_s(self) -> float | None:
        """Maximum time for which a laser may be on for one frame; None if it is not limited."""
        return None

    def open(self) -> None:
        """Open the device and switch everything off; raises `DeviceError` if that fails."""

    def set_mask(self, lasers: int) -> None:
        """Switch on exactly these lasers; those that go off are switched before those that come on."""

    def read_mask(self) -> int | None:
        """The mask that the board reports; None if it cannot report."""

    def wait(self, duration_s: float) -> None:
        """Let time pass; raises at once if the driver detects meanwhile that its device is lost."""
        time.sleep(duration_s)

    def abort(self) -> None:
        """Switch all lasers off at once; commands of the thread that switches them then fail.

        It is called by another thread. By default nothing happens: the lasers stay on until the end of their shot.
        """
        return

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        try:
            self._switch_off()
        except BaseException:  # a second signal must not leave a laser on
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
            finding = f"reported on (mask {left_on}) after all were switched off"
            raise LaserSafetyError("lasers", finding, "cut the power")


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserContext:
    """The rig that the lasers belong to, and the camera that captures them."""

    names: tuple[str, ...] | None = None
    """Names of the rig's lasers, in its order; None if no rig is given."""
    camera: object | None = None
    """The camera's driver, which may have output lines; None for a simulated one, which is created after its lasers."""


LaserFactory: TypeAlias = Callable[[DeviceUri, LaserContext], LaserDriver]
"""The type of the entry points of the group `ringpose.lasers`."""


def channels(uri: DeviceUri, context: LaserContext) -> tuple[str, ...]:
    """The channel of each laser, in the rig's order: `ch=1,2,3`, or by name `ch=left:1,right:3,middle:2`."""
    words = [word.strip() for word in uri.parameters.get("ch", "").split(",")]
    if not all(words):
        raise uri.problem("lacks the channels of the lasers (ch=)", "write it as ?ch=1,2,3")
    chosen = tuple(words)
    if any(":" in word for word in words):
        named = dict(word.partition(":")[::2] for word in words)
        if context.names is None:
            raise uri.problem("names lasers, but their order is unknown without a rig", "add --rig FILE")
        if set(named) != set(context.names) or len(words) != len(context.names) or not all(named.values()):
            raise uri.problem(f"must name each of the rig's lasers once: {', '.join(context.names)}")
        chosen = tuple(named[name] for name in context.names)
    if len(set(chosen)) < len(chosen):
        raise uri.problem("names a channel twice (ch=)")
    if len(chosen) > MAX_LASERS:
        raise uri.problem(f"has {len(chosen)} channels; at most {MAX_LASERS} lasers are possible")
    if context.names is not None and len(chosen) != len(context.names):
        raise uri.problem(f"has {len(chosen)} channels for the {len(context.names)} lasers of the rig")
    return chosen
