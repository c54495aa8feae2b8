"""`line:`: lasers at the camera's own output lines, the fastest way to switch them, without relays that wear.

The camera is opened once, so no guard can stand by: if this process is killed, the outputs stay as they are until the
camera misses its owner's heartbeat, and what it does then depends on its make (some hold them). Outputs go low
before anything else at the end. For people near the beam, a board with a timed pulse or a relay is the safer choice.
"""

from typing import Protocol, runtime_checkable

from ringpose.capture.lasers.driver import LaserDriver, LaserPlace, channels
from ringpose.capture.uri import DeviceUri


@runtime_checkable
class OutputLines(Protocol):
    """A camera whose output lines a program sets."""

    def set_output(self, line: str, high: bool) -> None:
        """Set a line by its SFNC name (`Line1`); a `DeviceError` says if it cannot be."""

    def output(self, line: str) -> bool | None:
        """Whether a line is high; None if the camera cannot say."""


class LineLasers(LaserDriver):
    """Laser i is lit while line i is high."""

    def __init__(self, camera: OutputLines, lines: tuple[str, ...]) -> None:
        self._camera = camera
        self._lines = lines

    @property
    def count(self) -> int:
        """One laser a line."""
        return len(self._lines)

    def open(self) -> None:
        """The camera is open already: every line low."""
        self.set_mask(0)

    def set_mask(self, lasers: int) -> None:
        """Light exactly these: what has to go off goes off before what has to come on."""
        for on in (False, True):
            for number, line in enumerate(self._lines):
                if bool(lasers >> number & 1) is on:
                    self._camera.set_output(line, on)

    def read_mask(self) -> int | None:
        """The lines that are high."""
        states = [self._camera.output(line) for line in self._lines]
        if None in states:
            return None
        return sum(1 << number for number, high in enumerate(states) if high)

    def close(self) -> None:
        """The camera's own driver lets go of it."""


def line(uri: DeviceUri, place: LaserPlace) -> LineLasers:
    """`line:Line1,Line2,Line3`, in the rig's order, or by name `line:left:Line1,...`."""
    uri.refuse_unknown(())
    if not isinstance(place.camera, OutputLines):
        raise uri.problem("goes with a camera that has output lines only")
    return LineLasers(place.camera, channels(_as_channels(uri), place))


def _as_channels(uri: DeviceUri) -> DeviceUri:
    return DeviceUri(text=uri.text, option=uri.option, scheme=uri.scheme, place=uri.place, parameters={"ch": uri.place})
