"""`none:`: lasers that burn all the time, or that somebody else switches."""

from collections.abc import Iterable

from ringpose.capture.lasers.driver import LaserDriver, LaserPlace
from ringpose.capture.uri import DeviceUri
from ringpose.errors import UsageError
from ringpose.types.sequence import MAX_LASERS, Step


class UncontrolledLasers(LaserDriver):
    """Taken as all on, always; switching them off is the user's own business."""

    def __init__(self, count: int) -> None:
        self._count = count

    @property
    def count(self) -> int:
        """Number of lasers of the rig."""
        return self._count

    def open(self) -> None:
        """Nothing to take."""

    def set_mask(self, lasers: int) -> None:
        """Nothing to switch: `refuse_switching` has seen to it that only the step `all` is asked for."""

    def read_mask(self) -> int | None:
        """Nobody knows."""
        return None

    def close(self) -> None:
        """Nothing to let go of."""


def none(uri: DeviceUri, place: LaserPlace) -> UncontrolledLasers:
    """As many as the rig has; without a rig as many as a mask has room for."""
    if uri.place or uri.parameters:
        raise uri.problem("has words after its colon", "leave them out")
    return UncontrolledLasers(MAX_LASERS if place.names is None else len(place.names))


def refuse_switching(steps: Iterable[Step]) -> None:
    """A sequence for lasers that nothing switches may have the step `all` only."""
    for step in steps:
        if step.text != "all":
            raise UsageError(
                "--lasers none:", f'nothing switches the lasers for step "{step.text}"', "say --sequence all"
            )
