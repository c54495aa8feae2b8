"""What capture asks of a laser driver."""

import time
from types import TracebackType
from typing import Protocol, runtime_checkable

from ringpose.capture.device import Device
from ringpose.errors import DeviceError, LaserSafetyError


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
