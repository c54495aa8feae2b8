"""Shots from devices, as they are taken, for a command that measures them."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from typing import TYPE_CHECKING

from ringpose.errors import UsageError

if TYPE_CHECKING:
    from pathlib import Path

    from ringpose.capture.latest_frame import LiveShot
    from ringpose.cli.batch import Batch
    from ringpose.cli.sources import Wanted


def refuse_both(inputs: list[str] | None, camera: str | None, lasers: str | None) -> None:
    """Shots come from files or from a camera."""
    if not inputs and camera is None:
        raise UsageError("", "there is nothing to measure", "name an INPUT, or give --camera and --lasers")
    if inputs and camera is not None:
        raise UsageError("--camera", f"and the input {inputs[0]} exclude each other", "leave one of them out")
    if lasers is not None and camera is None:
        raise UsageError("--lasers", "is of no use without --camera")
    if camera is not None and camera.startswith("files:"):
        raise UsageError("--camera", "what is recorded is not live", f"name {camera[6:]} as INPUT")


@contextmanager
def newest_shots(wanted: "Wanted", batch: "Batch") -> "Iterator[Iterator[LiveShot]]":
    """The newest shot each time; when the block ends the lasers are off and the devices closed."""
    from ringpose.capture.latest_frame import NewestShots
    from ringpose.cli.sources import source_of

    source = source_of(wanted, batch)
    with ExitStack() as stack:
        for device in source.devices:
            stack.enter_context(device)
        shots = source.shots(_unread, ())
        yield stack.enter_context(NewestShots(shots, source.abort))


def _unread(path: "Path") -> None:
    """Nobody asks from which files live shots come."""
