"""A live camera -> lines: the newest shot is measured while the next one is taken, and the track chooses its lasers."""

from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from time import perf_counter

from ringpose.capture.latest_frame import EarlyStripes, LiveShot, NewestShots
from ringpose.capture.source import CaptureRequest, Source, TrackedSequence
from ringpose.measure.stream import Measured, Stream
from ringpose.types.image import Shot
from ringpose.types.rig import Rig


@contextmanager
def live_lines(
    request: CaptureRequest,
    open_source: Callable[[CaptureRequest], Source],
    open_stream: Callable[..., Stream],
    checked: Callable[[Shot, Rig, str], Shot],
) -> Iterator[Iterator[Measured]]:
    """The lines of a live camera: after each measurement, the latest shot is measured next.

    `open_stream` receives `early` of `Stream`. The track chooses the lasers of each shot unless the request has steps.
    A shot that is lost to changing ambient light has a line, too. `checked` raises DataError for a shot that does not
    fit the rig: it ends the stream, as all that follow would be bad for the same reason. At the end of the block the
    lasers are off and the devices closed.
    """
    early = EarlyStripes(request.rig)
    stream, sequence = open_stream(early=early.stripes_of), TrackedSequence()
    choose = sequence if stream.is_tracking and not request.steps else None
    source = open_source(replace(request, choose=choose, on_frame=early.add, yields_lost=True))

    def measured(live: LiveShot) -> Measured:
        measurement = stream.measure(checked(live.shot, stream.setup.rig, request.camera))
        sequence.report(is_assigned=stream.assigns_lasers)
        latency_s = perf_counter() - live.taken_s
        return replace(measurement, line=replace(measurement.line, shots_dropped=live.dropped, latency_s=latency_s))

    with ExitStack() as stack:
        for device in source.devices:
            stack.enter_context(device)
        shots = source.shots(lambda _: None, ())  # live shots are not read from files
        newest = stack.enter_context(NewestShots(shots, source.abort, every=source.waits_for_consumer))
        import ringpose.detect.pipeline  # noqa: F401  # imported while the first shot is taken

        yield map(measured, newest)
