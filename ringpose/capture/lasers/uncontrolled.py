"""`none:`: lasers that are always on, or switched by something else."""

from collections.abc import Iterable

from ringpose.capture.lasers.driver import LaserContext, LaserDriver
from ringpose.capture.uri import DeviceUri
from ringpose.errors import UsageError
from ringpose.types.session import MAX_LASERS, Step


class UncontrolledLasers(LaserDriver):
    """Lasers that no device switches: assumed to be on all the time; the user must switch them off."""

    def __init__(self, count: int) -> None:
        self._count = count

    @property
    def count(self) -> int:
        """Number of lasers of the rig."""
        return self._count

    def open(self) -> None:
        """Nothing to open."""

    def set_mask(self, lasers: int) -> None:
        """Nothing to switch; `reject_switching` ensures that a sequence has the step `all` only."""

    def read_mask(self) -> int | None:
        """None: it is not known which lasers are on."""
        return None

    def close(self) -> None:
        """Nothing to close."""


def none(uri: DeviceUri, context: LaserContext) -> UncontrolledLasers:
    """Lasers that nothing switches, as many as the rig has; without a rig, as many as a mask can hold."""
    if uri.address or uri.parameters:
        raise uri.problem("has words after its colon", "leave them out")
    return UncontrolledLasers(MAX_LASERS if context.names is None else len(context.names))


def reject_switching(steps: Iterable[Step]) -> None:
    """Reject a sequence that has another step than `all`, for lasers that are not switched."""
    for step in steps:
        if step.text != "all":
            raise UsageError(
                "--lasers none:", f'nothing switches the lasers for step "{step.text}"', "use --sequence all"
            )
