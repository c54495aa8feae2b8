"""`ringpose pose`: detections, shots, images or a live camera -> one pose line each."""

from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.app import app
from ringpose.cli.assumption_options import (
    MaxRate,
    MaxSpeed,
    RigStabilityFactor,
    RingTolerance,
    Still,
    assumption_options,
)
from ringpose.cli.batch import Jobs
from ringpose.cli.device_options import AllowUnseen, Count, Duration, Exposure, LasersUri, Settle, Steps
from ringpose.cli.known_ring import RadiusInner, RadiusOuter, RadiusSd, RingName, RingOptions, RingsFile
from ringpose.cli.options import (
    Force,
    ImageChannel,
    OptionalInputs,
    Overlay,
    PoseFrame,
    PoseMethod,
    Quiet,
    Report,
    RigFile,
    Verbose,
)
from ringpose.errors import UsageError
from ringpose.types.options import Method

if TYPE_CHECKING:
    from ringpose.capture.latest_frame import LiveShot
    from ringpose.capture.source import CaptureRequest
    from ringpose.cli.batch import Batch
    from ringpose.cli.overlays import PosePictures
    from ringpose.pose.drift import DriftMonitor
    from ringpose.types.detection import Detection
    from ringpose.types.image import Shot
    from ringpose.types.pose import PoseLine
    from ringpose.types.rig import Rig

LiveCamera = Annotated[
    str | None, typer.Option("--camera", metavar="URI", help="Measure what this camera sees, see ringpose-capture(1).")
]

Frame = Annotated[PoseFrame, typer.Option("--frame", help="Frame of the vectors; tool needs the rig's mount.")]

Brief = Annotated[
    bool, typer.Option("--brief", help="Write lines without the measurement in information form, which is long.")
]


@app.command()
def pose(
    rig: RigFile,
    inputs: OptionalInputs = None,
    method: PoseMethod = Method.ML,
    frame: Frame = PoseFrame.CAMERA,
    radius_outer: RadiusOuter = None,
    radius_inner: RadiusInner = None,
    radius_sd: RadiusSd = None,
    ring: RingName = None,
    rings: RingsFile = None,
    still: Still = False,
    max_speed: MaxSpeed = None,
    max_rate: MaxRate = None,
    ring_tolerance: RingTolerance = None,
    rig_stability: RigStabilityFactor = 1.0,
    channel: ImageChannel = None,
    camera: LiveCamera = None,
    lasers: LasersUri = None,
    sequence: Steps = None,
    exposure: Exposure = None,
    settle: Settle = None,
    allow_missing: AllowUnseen = False,
    count: Count = None,
    duration: Duration = None,
    brief: Brief = False,
    overlay: Overlay = None,
    report: Report = None,
    jobs: Jobs = 1,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Compute the pose of the ring: one JSON record a shot on stdout."""
    from ringpose.cli.batch import Batch
    from ringpose.cli.known_ring import known_ring
    from ringpose.files.rigs import read_rig, require_mount
    from ringpose.pose.drift import DriftMonitor
    from ringpose.pose.record import pose_line

    _check_source(inputs, camera, lasers)
    if jobs > 1 and (camera is not None or overlay is not None or report is not None):
        raise UsageError("--jobs", "excludes --camera, --overlay and --report", "leave it out")
    ring_options = RingOptions(
        radius_outer_m=radius_outer, radius_inner_m=radius_inner, radius_sd_m=radius_sd, ring=ring, rings=rings
    )
    known = known_ring(ring_options, method)
    options = assumption_options(still, max_speed, max_rate, ring_tolerance, rig_stability)
    rig_of_shots = read_rig(rig)
    if frame is PoseFrame.TOOL:
        require_mount(rig_of_shots, rig)
    batch = Batch()
    monitor = DriftMonitor(rig_of_shots, rig_of_shots.stability.scaled(rig_stability))

    def measured(source: "Shot | Detection") -> "PoseLine":
        return pose_line(source, monitor.rig, method=method, frame=frame, known=known, options=options)

    measure: Callable[[Shot | Detection], PoseLine] = measured
    pictures = None
    if overlay is not None or report is not None:
        from ringpose.cli.overlays import PosePictures

        pictures = PosePictures(measure, rig_of_shots, overlay, report, force=force)
        measure = pictures.measure
    lines: AbstractContextManager[Iterator[PoseLine]]
    if jobs > 1:
        from ringpose.cli.pose_jobs import SingleShot, parallel_lines
        from ringpose.files.inputs import inputs as named
        from ringpose.files.sources import SUFFIXES

        single = SingleShot(rig=rig_of_shots, channel=channel, method=method, frame=frame, known=known, options=options)
        items = named(inputs or [], SUFFIXES)
        lines = nullcontext(parallel_lines(items, single, jobs, batch, lambda: monitor.rig, measured))
    elif camera is None:
        lines = nullcontext(_recorded_lines(inputs or [], rig_of_shots, channel, batch, measure))
    else:
        from ringpose.capture.source import CaptureRequest

        request = CaptureRequest(
            camera=camera,
            lasers=lasers,
            steps=sequence,
            exposure_s=exposure,
            settle_s=settle,
            allow_missing=allow_missing,
            laser_names=rig_of_shots.lasers.names,
            rig=rig_of_shots,
            count=count,
            duration_s=duration,
        )
        lines = _live_lines(request, rig_of_shots, batch, measure)
    try:
        with lines as each:
            _write(each, monitor, batch, brief, verbose, quiet, pictures)
    finally:  # also after an interrupt, which is how the measurement of a live camera ends
        if pictures is not None:
            pictures.finish()
    batch.finish()


def _check_source(inputs: list[str] | None, camera: str | None, lasers: str | None) -> None:
    """Shots come either from files or from a camera."""
    if not inputs and camera is None:
        raise UsageError("", "there is nothing to measure", "name an INPUT, or give --camera and --lasers")
    if inputs and camera is not None:
        raise UsageError("--camera", f"and the input {inputs[0]} exclude each other", "leave one of them out")
    if lasers is not None and camera is None:
        raise UsageError("--lasers", "is of no use without --camera")
    if camera is not None and camera.startswith("files:"):
        raise UsageError("--camera", "a recording is not a live camera", f"name {camera[6:]} as INPUT")


def _recorded_lines(
    inputs: list[str],
    rig: "Rig",
    channel: str | None,
    batch: "Batch",
    measure: "Callable[[Shot | Detection], PoseLine]",
) -> "Iterator[PoseLine]":
    """Pose lines of the inputs; bad ones are reported by the batch."""
    from ringpose.files.inputs import inputs as named
    from ringpose.files.sources import SUFFIXES, read_source

    for item in batch.valid_inputs(named(inputs, SUFFIXES)):
        with batch.guarded():
            yield measure(read_source(item, rig, channel))


@contextmanager
def _live_lines(
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


def _write(
    lines: "Iterator[PoseLine]",
    monitor: "DriftMonitor",
    batch: "Batch",
    brief: bool,
    verbose: bool,
    quiet: bool,
    pictures: "PosePictures | None",
) -> None:
    """Every line as it comes, with the health of the rig; then its picture."""
    from ringpose.cli import messages
    from ringpose.cli.progress import with_progress
    from ringpose.errors import NO_POSE
    from ringpose.files import records
    from ringpose.files.poses import pose_record
    from ringpose.pose.record import remarks_on

    for line in with_progress(lines, "shots", quiet):
        with_health, warning = monitor.update(line)
        if warning is not None:
            messages.echo(f"{line.shot}: {warning}; run ringpose calibrate-planes")
        records.write(pose_record(with_health, brief))
        if verbose:
            messages.echo(f"{line.shot}: {remarks_on(with_health)}")
        if line.pose is None:
            batch.record_status(NO_POSE)
        if pictures is not None:
            with batch.guarded():
                pictures.add(with_health)
