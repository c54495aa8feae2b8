"""`ringpose pose`: detections, shots or images -> one pose line each.

Shots from devices, as they are taken, for a command that measures them.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, ExitStack, contextmanager, nullcontext
from dataclasses import replace
from functools import partial
from time import perf_counter
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.app import app
from ringpose.cli.device_options import AllowUnseen, Count, Duration, Exposure, LasersUri, Settle, Steps
from ringpose.cli.known_ring import RadiusInner, RadiusOuter, RadiusSd, RingName, RingOptions, RingsFile
from ringpose.cli.options import ImageChannel, OptionalInputs, PoseFrame, PoseMethod, Quiet, RigFile, Verbose
from ringpose.errors import UsageError
from ringpose.types.options import Method

if TYPE_CHECKING:
    from pathlib import Path

    from ringpose.capture.latest_frame import LiveShot
    from ringpose.cli.acquisition import CaptureRequest
    from ringpose.cli.batch import Batch
    from ringpose.cli.rig_watch import DriftMonitor
    from ringpose.types.detection import Detection
    from ringpose.types.image import Shot
    from ringpose.types.pose import PoseLine
    from ringpose.types.rig import Rig
    from ringpose.types.ring import KnownRadii, Ring


LiveCamera = Annotated[
    str | None, typer.Option("--camera", metavar="URI", help="Measure what this camera sees, see ringpose-capture(1).")
]

Frame = Annotated[PoseFrame, typer.Option("--frame", help="Frame of the vectors; tool needs the rig's mount.")]


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
    channel: ImageChannel = None,
    camera: LiveCamera = None,
    lasers: LasersUri = None,
    sequence: Steps = None,
    exposure: Exposure = None,
    settle: Settle = None,
    allow_missing: AllowUnseen = False,
    count: Count = None,
    duration: Duration = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Compute the pose of the ring: one JSON record a shot on stdout."""
    from ringpose.cli.batch import Batch
    from ringpose.cli.known_ring import known_ring
    from ringpose.cli.rig_watch import DriftMonitor
    from ringpose.files.rigs import read_rig, require_mount

    refuse_both(inputs, camera, lasers)
    said = RingOptions(
        radius_outer_m=radius_outer, radius_inner_m=radius_inner, radius_sd_m=radius_sd, ring=ring, rings=rings
    )
    known = known_ring(said, method)
    rig_of_shots = read_rig(rig)
    if frame is PoseFrame.TOOL:
        require_mount(rig_of_shots, rig)
    batch = Batch()
    measure = partial(pose_line, rig=rig_of_shots, method=method, frame=frame, known=known)
    lines: AbstractContextManager[Iterator[PoseLine]]
    if camera is None:
        lines = nullcontext(_recorded_lines(inputs or [], rig_of_shots, channel, batch, measure))
    else:
        from ringpose.cli.acquisition import CaptureRequest

        wanted = CaptureRequest(
            camera=camera,
            lasers=lasers,
            steps=sequence,
            exposure_s=exposure,
            settle_s=settle,
            allow_missing=allow_missing,
            laser_names=rig_of_shots.lasers.names,
            count=count,
            duration_s=duration,
        )
        lines = _live_lines(wanted, rig_of_shots, batch, measure)
    with lines as each:
        _write(each, DriftMonitor(rig_of_shots.lasers.names, method), batch, verbose, quiet)
    batch.finish()


def _recorded_lines(
    inputs: list[str],
    rig: "Rig",
    channel: str | None,
    batch: "Batch",
    measure: "Callable[[Shot | Detection], PoseLine]",
) -> "Iterator[PoseLine]":
    """Pose lines of what the user names; what is bad among it is the batch's business."""
    from ringpose.files.inputs import inputs as named
    from ringpose.files.sources import SUFFIXES, read_source

    for item in batch.good(named(inputs, SUFFIXES)):
        with batch.item():
            yield measure(read_source(item, rig, channel))


@contextmanager
def _live_lines(
    wanted: "CaptureRequest", rig: "Rig", batch: "Batch", measure: "Callable[[Shot | Detection], PoseLine]"
) -> "Iterator[Iterator[PoseLine]]":
    """Pose lines of a camera; what is wrong with one live shot is wrong with all that follow."""
    from ringpose.files.shots import fitting_shot

    def line_of(live: "LiveShot") -> "PoseLine":
        line = measure(fitting_shot(live.shot, rig, wanted.camera))
        return replace(line, dropped=live.dropped, latency_s=perf_counter() - live.taken_s)

    with newest_shots(wanted, batch) as newest:
        import ringpose.detect.pipeline  # here, while the first shot is taken, it costs no time
        import ringpose.pose.pipeline  # noqa: F401

        yield map(line_of, newest)


def _write(lines: "Iterator[PoseLine]", watch: "DriftMonitor", batch: "Batch", verbose: bool, quiet: bool) -> None:
    """Every line as it comes, with the lasers' health."""
    from ringpose.cli import messages
    from ringpose.cli.progress import counted
    from ringpose.cli.rig_watch import remarks_on
    from ringpose.errors import NO_POSE
    from ringpose.files import records
    from ringpose.files.poses import pose_record

    for line in counted(lines, "shots", quiet):
        watched = watch.watched(line)
        records.write(pose_record(watched))
        if verbose:
            messages.say(f"{line.shot}: {remarks_on(watched)}")
        if line.pose is None:
            batch.met(NO_POSE)


def pose_line(
    source: "Shot | Detection",
    rig: "Rig",
    method: Method,
    frame: PoseFrame,
    known: "KnownRadii | Sequence[Ring] | None" = None,
) -> "PoseLine":
    """The pose of one shot, or the reason why it has none, and how long that took."""
    from ringpose.pose.pipeline import estimate_pose
    from ringpose.types.detection import BreakPoints, Detection, NoBreakPoints
    from ringpose.types.pose import NoPose, PoseLine, RingPose

    start_s = perf_counter()
    detection = source if isinstance(source, Detection) else _detected(source, rig)
    points = detection.break_points
    result: RingPose | NoPose | NoBreakPoints = (
        estimate_pose(points, rig, method, detection.ring_edges, known) if isinstance(points, BreakPoints) else points
    )
    if isinstance(result, RingPose) and frame is PoseFrame.TOOL and rig.tool_from_camera is not None:
        from ringpose.pose.transform import pose_in_frame

        result = pose_in_frame(result, rig.tool_from_camera)
    return PoseLine(
        shot=detection.shot,
        stamp_s=detection.stamp_s,
        pose=result if isinstance(result, RingPose) else None,
        reason=(result.remark or None) if isinstance(result, RingPose) else result.value,
        frame=frame,
        latency_s=perf_counter() - start_s,
        rig=rig.sha256,
    )


def _detected(shot: "Shot", rig: "Rig") -> "Detection":
    """What is found in a shot; a pose from a record needs no detector."""
    from ringpose.detect.pipeline import detect

    return detect(shot, rig)


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
def newest_shots(wanted: "CaptureRequest", batch: "Batch") -> "Iterator[Iterator[LiveShot]]":
    """The newest shot each time; when the block ends the lasers are off and the devices closed."""
    from ringpose.capture.latest_frame import NewestShots
    from ringpose.cli.acquisition import source_of

    source = source_of(wanted, batch)
    with ExitStack() as stack:
        for device in source.devices:
            stack.enter_context(device)
        shots = source.shots(_unread, ())
        yield stack.enter_context(NewestShots(shots, source.abort))


def _unread(path: "Path") -> None:
    """Nobody asks from which files live shots come."""
