"""`sim:`: lasers of a simulated scene; the simulated camera reads from here which are on."""

from ringpose.capture.lasers.driver import LaserContext, LaserDriver
from ringpose.capture.uri import DeviceUri


class SimulatedLasers(LaserDriver):
    """Lasers that exist as a mask only; off before opening and after closing."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._mask = 0

    @property
    def count(self) -> int:
        """Number of lasers of the scene's rig."""
        return self._count

    def open(self) -> None:
        """Start with all off."""
        self._mask = 0

    def set_mask(self, lasers: int) -> None:
        """Switch on exactly these lasers."""
        self._mask = lasers

    def read_mask(self) -> int | None:
        """The mask of the lasers that are on."""
        return self._mask

    def close(self) -> None:
        """End with all off."""
        self._mask = 0


def sim(uri: DeviceUri, context: LaserContext) -> SimulatedLasers:
    """The lasers of the simulated scene."""
    if uri.address or uri.parameters:
        raise uri.problem("has words after its colon", "leave them out")
    if context.names is None or context.camera is not None:
        raise uri.problem("needs a simulated camera")
    return SimulatedLasers(len(context.names))
