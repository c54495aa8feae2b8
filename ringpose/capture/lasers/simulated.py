"""`sim:`: lasers of a simulated scene; the simulated camera looks at what is lit here."""

from ringpose.capture.lasers.driver import LaserDriver, LaserPlace
from ringpose.capture.uri import DeviceUri


class SimulatedLasers(LaserDriver):
    """Off until it is opened and after it is closed."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._lit = 0

    @property
    def count(self) -> int:
        """Number of lasers of the scene's rig."""
        return self._count

    def open(self) -> None:
        """Start with all off."""
        self._lit = 0

    def set_mask(self, lasers: int) -> None:
        """Light exactly these."""
        self._lit = lasers

    def read_mask(self) -> int | None:
        """What is lit."""
        return self._lit

    def close(self) -> None:
        """End with all off."""
        self._lit = 0


def sim(uri: DeviceUri, place: LaserPlace) -> SimulatedLasers:
    """The lasers of the simulated scene."""
    if uri.place or uri.parameters:
        raise uri.problem("has words after its colon", "leave them out")
    if place.names is None or place.camera is not None:
        raise uri.problem("goes with a simulated camera only")
    return SimulatedLasers(len(place.names))
