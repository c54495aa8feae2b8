"""`ringpose pose`: detections, shots, images or a live camera -> one pose line each, or the line of its track."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import fields
from functools import partial
from time import time
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ringpose.cli import messages
from ringpose.cli.app import app, with_option_groups
from ringpose.cli.batch import Batch, Jobs
from ringpose.cli.options.assumptions import Assumed
from ringpose.cli.options.common import (
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
from ringpose.cli.options.devices import ShotOptions
from ringpose.cli.options.known_ring import RingOptions, known_ring
from ringpose.cli.options.track import (
    Format,
    Newest,
    OutputFormat,
    RobotPosesFile,
    TrackSettings,
    camera_motion,
    record_writer,
    track_writer,
)
from ringpose.cli.pose_jobs import PoseStream, SingleShot, recorded_lines
from ringpose.cli.progress import with_progress
from ringpose.errors import NO_POSE, UsageError
from ringpose.types.options import STDIN, Method

if TYPE_CHECKING:
    from ringpose.types.pose import PoseLine

LiveCamera = Annotated[
    str | None, typer.Option("--camera", metavar="URI", help="Measure what this camera sees, see ringpose-capture(1).")
]

Frame = Annotated[PoseFrame, typer.Option("--frame", help="Frame of the vectors; tool needs the rig's mount.")]

Track = Annotated[
    bool, typer.Option("--track", help="Track the ring: write track records, and use the track in the next shots.")
]

Brief = Annotated[bool, typer.Option("--brief", help="Write lines without what only filters use, which is long.")]


@app.command()
@with_option_groups
def pose(
    *,
    rig: RigFile,
    inputs: OptionalInputs = None,
    method: PoseMethod = Method.ML,
    frame: Frame = PoseFrame.CAMERA,
    ring: RingOptions,
    assumed: Assumed,
    channel: ImageChannel = None,
    camera: LiveCamera = None,
    shots: ShotOptions,
    track: Track = False,
    settings: TrackSettings,
    robot_poses: RobotPosesFile = None,
    output_format: OutputFormat = Format.RINGPOSE,
    newest: Newest = False,
    brief: Brief = False,
    overlay: Overlay = None,
    report: Report = None,
    jobs: Jobs = 1,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Compute the pose of the ring: one JSON record a shot on stdout, or with --track the record of its track."""
    from ringpose.files.rigs import read_rig, require_mount

    _check_source(inputs, camera, shots)
    if jobs > 1 and (camera is not None or overlay is not None or report is not None or track):
        raise UsageError("--jobs", "excludes --camera, --overlay, --report and --track", "leave it out")
    _check_method(method, assumed, robot_poses)
    _check_track(track, method, frame, settings)
    options, known = assumed.options, known_ring(ring, method, assumed.ring_tolerance)
    loaded_rig, batch = read_rig(rig), Batch()
    if frame is PoseFrame.TOOL:
        require_mount(loaded_rig, rig)
    is_live_robot = camera is not None and robot_poses == STDIN
    motion = None if is_live_robot else camera_motion(robot_poses, rig, inputs)
    single = SingleShot(loaded_rig, channel, method, frame, known, options, motion)
    stream = PoseStream(single, settings.tracker(loaded_rig, options, motion) if track else None)
    if is_live_robot:
        from ringpose.cli.live_input import live_camera_motion

        stream.motion_until = live_camera_motion(rig, batch)
    lines: AbstractContextManager[Iterator[PoseLine]]
    if camera is None:
        lines = nullcontext(recorded_lines(inputs or [], single, jobs, batch, lambda: stream.rig, stream.measured))
    else:
        from ringpose.capture.latest_frame import EarlyStripes
        from ringpose.cli.live_input import live_lines

        early = EarlyStripes()
        stream.searched = early.stripes_of
        request = shots.request(
            camera, loaded_rig, choose=None if shots.sequence else stream.sequence, on_frame=early.add
        )
        lines = live_lines(request, loaded_rig, batch, stream.measured)
    with batch, ExitStack() as stack:
        if overlay is not None or report is not None:
            from ringpose.cli.overlays import PosePictures

            stream.pictures = stack.enter_context(PosePictures(loaded_rig, overlay, report, force=force))
        write = _writer(stream, record_writer(stack, newest), output_format, brief, verbose, batch)
        _write(stack.enter_context(lines), stream, write, batch, verbose, quiet)
    batch.finish()


def _check_source(inputs: list[str] | None, camera: str | None, shots: ShotOptions) -> None:
    """Shots come either from files or from a camera."""
    if not inputs and camera is None:
        raise UsageError("", "there is nothing to measure", "name an INPUT, or give --camera")
    if inputs and camera is not None:
        raise UsageError("--camera", f"and the input {inputs[0]} exclude each other", "leave one of them out")
    if camera is not None and camera.startswith("files:"):
        raise UsageError("--camera", "a recording is not a live camera", f"name {camera[6:]} as INPUT")
    for field in fields(shots):
        if camera is None and getattr(shots, field.name) != field.default:
            raise UsageError(f"--{field.name.replace('_', '-')}", "is of no use without --camera", "leave it out")


def _check_method(method: Method, assumed: Assumed, robot_poses: str | None) -> None:
    """Reject options that the paper's methods do not use; they assume a perfect ring at rest, as a value of 0 does."""
    given = {
        "--robot-poses": robot_poses,
        "--max-speed": assumed.max_speed,
        "--max-rate": assumed.max_rate,
        "--ring-tolerance": assumed.ring_tolerance,
    }
    for option, value in given.items():
        if method is not Method.ML and value:
            raise UsageError(option, f"is not used by --method {method.value}", "leave it out, or use --method ml")


def _check_track(track: bool, method: Method, frame: PoseFrame, settings: TrackSettings) -> None:
    """Options of a track need one, and a track needs the measurements of method ml."""
    if not track and settings != TrackSettings():
        raise UsageError("--track", "is missing: the options of a track are given", "add it, or leave them out")
    if track and method is not Method.ML:
        raise UsageError("--track", f"needs measurements, which --method {method.value} has not", "use --method ml")
    if track and frame is PoseFrame.TOOL:
        raise UsageError("--frame", "tool is not an inertial frame, as a track needs", "leave it out")


def _writer(
    stream: PoseStream,
    write: "Callable[[Mapping[str, Any]], None]",
    output_format: Format,
    brief: bool,
    verbose: bool,
    batch: Batch,
) -> "Callable[[PoseLine], None]":
    """A function that writes the record of a pose line, or of the track that the line continues."""
    from ringpose.files.records.poses import pose_record

    record: Callable[[PoseLine], Mapping[str, Any]] = partial(pose_record, brief=brief)
    if output_format is Format.ROS:
        from ringpose.files.records.ros import ros_messages

        record = ros_messages

    def pose_written(line: "PoseLine") -> None:
        write(record(line))
        if line.pose is None:
            batch.record_status(NO_POSE)

    if stream.shots is None:
        return pose_written
    shots, track_written = stream.shots, track_writer(write, output_format, brief, verbose, batch)

    def track_of_pose_written(line: "PoseLine") -> None:
        with batch.guarded():
            track_written(shots.added(line, time()))
        if stream.sequence is not None:
            stream.sequence.report(is_assigned=shots.assigns_lasers(stream.rig))

    return track_of_pose_written


def _write(
    lines: "Iterator[PoseLine]",
    stream: PoseStream,
    write: "Callable[[PoseLine], None]",
    batch: Batch,
    verbose: bool,
    quiet: bool,
) -> None:
    """Write each line as it comes, report the health of the rig, then draw the line's picture."""
    from ringpose.pose.pipeline import remarks_on

    for line in with_progress(lines, "shots", quiet):
        with_health, warning = stream.monitor.update(line)
        if warning is not None:
            messages.echo(f"{line.shot}: {warning}; run ringpose calibrate-planes")
        with_health, warning = stream.form.update(with_health)
        if warning is not None:
            messages.echo(f"{line.shot}: {warning}")
        write(with_health)
        if verbose:
            messages.echo(f"{line.shot}: {remarks_on(with_health)}")
        if stream.pictures is not None:
            with batch.guarded():
                stream.pictures.add(with_health)
