"""`line:`: lasers switched by the output lines of the camera, which are the fastest switches and do not wear.

A camera can be opened by one process only, so there is no watchdog: if this process is killed, the outputs stay as
they are until the camera detects the missing heartbeat; what it does then depends on its model (some hold them). At the
end of a capture the outputs are set low first. Near people, a board with a timed pulse or a relay is safer.
"""

from dataclasses import replace
from typing import Protocol, runtime_checkable

from ringpose.capture.lasers.driver import LaserContext, LaserDriver, channels
from ringpose.capture.uri import DeviceUri


@runtime_checkable
class OutputLines(Protocol):
    """A camera whose output lines can be set."""

    def set_output(self, line: str, high: bool) -> None:
        """Set a line by its SFNC name (`Line1`); raises `DeviceError` if it cannot be set."""

    def output(self, line: str) -> bool | None:
        """Whether a line is high; None if the camera does not report it."""


class LineLasers(LaserDriver):
    """Lasers at output lines of the camera: laser i is on while line i is high."""

    def __init__(self, camera: OutputLines, lines: tuple[str, ...]) -> None:
        self._camera = camera
        self._lines = lines

    @property
    def count(self) -> int:
        """Number of lasers: one for each output line of the camera."""
        return len(self._lines)

    def open(self) -> None:
        """Set every line low; the camera is open already."""
        self.set_mask(0)

    def set_mask(self, lasers: int) -> None:
        """Switch on exactly these lasers; those that go off are switched before those that come on."""
        for on in (False, True):
            for number, line in enumerate(self._lines):
                if bool(lasers >> number & 1) is on:
                    self._camera.set_output(line, on)

    def read_mask(self) -> int | None:
        """The mask of the lines that are high."""
        states = [self._camera.output(line) for line in self._lines]
        if None in states:
            return None
        return sum(1 << number for number, high in enumerate(states) if high)

    def close(self) -> None:
        """Nothing to do: the driver of the camera closes it."""


def line(uri: DeviceUri, context: LaserContext) -> LineLasers:
    """Lasers at the lines of a URI: `line:Line1,Line2,Line3` in the rig's order, or by name `line:left:Line1,...`."""
    uri.reject_unknown(())
    if not isinstance(context.camera, OutputLines):
        raise uri.problem("needs a camera that has output lines")
    return LineLasers(context.camera, channels(replace(uri, parameters={"ch": uri.address}), context))
