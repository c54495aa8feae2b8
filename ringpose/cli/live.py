"""Shots of a live camera, one at a time: the latest one whenever the one before has been measured."""

from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from collections.abc import Callable

    from ringpose.capture.latest_frame import LiveShot
    from ringpose.capture.source import CaptureRequest
    from ringpose.cli.batch import Batch
    from ringpose.types.detection import Detection
    from ringpose.types.image import Shot
    from ringpose.types.pose import PoseLine
    from ringpose.types.rig import Rig


@contextmanager
def live_lines(
    request: "CaptureRequest", rig: "Rig", batch: "Batch", measure: "Callable[[Shot | Detection], PoseLine]"
) -> "Iterator[Iterator[PoseLine]]":
    """Pose lines of a camera; a bad shot ends the stream, as all that follow would be bad for the same reason."""
    from ringpose.files.images.shots import checked_shot

    def line_of(live: "LiveShot") -> "PoseLine":
        line = measure(checked_shot(live.shot, rig, request.camera))
        return replace(line, shots_dropped=live.dropped, latency_s=perf_counter() - live.taken_s)

    with _newest_shots(request, batch) as newest:
        import ringpose.detect.pipeline  # noqa: F401  # imported while the first shot is taken

        yield map(line_of, newest)


@contextmanager
def _newest_shots(request: "CaptureRequest", batch: "Batch") -> "Iterator[Iterator[LiveShot]]":
    """The latest shot whenever one is asked for; at the end of the block the lasers are off and the devices closed."""
    from ringpose.capture.latest_frame import NewestShots
    from ringpose.cli.acquisition import source_of

    source = source_of(request, batch)
    with ExitStack() as stack:
        for device in source.devices:
            stack.enter_context(device)
        shots = source.shots(lambda _: None, ())  # live shots are not read from files
        yield stack.enter_context(NewestShots(shots, source.abort, every=source.waits_for_consumer))
