"""`ringpose pose`: detections, shots, images or a live camera -> one pose line each, or the line of its track."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager, ExitStack, nullcontext
from dataclasses import fields, replace
from functools import partial
from pathlib import Path
from time import time
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli import messages
from ringpose.cli.app import (
    ASSUMED,
    DEVICES,
    TRACK,
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
    app,
    check_plausible,
    numbers,
    with_option_groups,
)
from ringpose.cli.batch import Batch, Jobs, with_progress
from ringpose.cli.options.assumptions import Assumed
from ringpose.cli.options.devices import ShotOptions
from ringpose.cli.options.known_ring import RingOptions, known_ring
from ringpose.cli.options.robot import Frame, RobotColumns, RobotConvention, check_frame
from ringpose.cli.options.track import (
    Format,
    LineOptions,
    RobotPosesFile,
    TrackSettings,
    camera_motion,
    track_writer,
)
from ringpose.errors import NO_POSE, DataError, UsageError
from ringpose.types import plausible
from ringpose.types.assumptions import RISK
from ringpose.types.options import STDIN, Method
from ringpose.types.plausible import Range

if TYPE_CHECKING:
    from ringpose.cli.overlays import PosePictures
    from ringpose.files.inputs import Input, Problem, SourceReader
    from ringpose.files.records.line_file import LineFile
    from ringpose.measure.stream import Measured, Stream
    from ringpose.types.pose import PoseLine
    from ringpose.types.rig import Camera, Rig
    from ringpose.types.track import TrackLine

LiveCamera = Annotated[
    str | None,
    typer.Option(
        "--camera",
        metavar="URI",
        help="Measure what this camera sees, see ringpose-capture(1).",
        rich_help_panel=DEVICES,
    ),
]

GraspNear = Annotated[
    str | None,
    typer.Option(
        "--grasp-near",
        metavar="X_PX,Y_PX",
        help="Where both arcs of the ring are seen, grasp that nearer to this place; default: the image's middle.",
    ),
]

Risk = Annotated[
    float,
    typer.Option(
        "--risk",
        metavar="PROBABILITY",
        help="Probability with which an error may exceed its protection level.",
        rich_help_panel=ASSUMED,
    ),
]

Budget = Annotated[
    bool,
    typer.Option(
        "--budget", help="State the variance of grasp point, normal and centre by source.", rich_help_panel=ASSUMED
    ),
]

Track = Annotated[
    bool,
    typer.Option(
        "--track",
        help="Track the ring: write track records, and use the track in the next shots.",
        rich_help_panel=TRACK,
    ),
]


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
    risk: Risk = RISK,
    budget: Budget = False,
    grasp_near: GraspNear = None,
    channel: ImageChannel = None,
    camera: LiveCamera = None,
    shots: ShotOptions,
    track: Track = False,
    settings: TrackSettings,
    robot_poses: RobotPosesFile = None,
    robot_convention: RobotConvention = None,
    robot_columns: RobotColumns = None,
    written: LineOptions,
    overlay: Overlay = None,
    report: Report = None,
    jobs: Jobs = 1,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Compute the pose of the ring: one JSON record a shot on stdout, or with --track the record of its track."""
    from ringpose.cli.live_input import live_camera_motion
    from ringpose.files.inputs import SourceReader
    from ringpose.files.rigs import read_rig
    from ringpose.geometry.camera_motion import CameraMotion
    from ringpose.measure.stream import Setup, Stream
    from ringpose.types.rig import NO_ROBOT_POSES

    _check_source(inputs, camera, shots)
    written.check()
    has_pictures = overlay is not None or report is not None
    _check_order(written, jobs, is_live=camera is not None, track=track, pictures=has_pictures)
    _check_method(method, assumed, robot_poses)
    _check_track(track, method, frame, settings)
    known = known_ring(ring, method, assumed.ring_tolerance)
    check_plausible("--risk", risk, plausible.RISK)
    options = replace(assumed.options, risk=risk)
    batch, loaded_rig = Batch(), read_rig(rig)
    if frame is not PoseFrame.CAMERA:
        check_frame(frame, loaded_rig, rig, robot_poses)
        _check_pictures(frame, loaded_rig, pictures=has_pictures)
    is_live_robot = camera is not None and robot_poses == STDIN
    if is_live_robot and (robot_convention or robot_columns):
        raise UsageError("--robot-convention", "is of no use for poses that arrive as JSON lines", "leave it out")
    motion = None if is_live_robot else camera_motion(robot_poses, rig, inputs, robot_convention, robot_columns)
    if motion is None and loaded_rig.mount is not None and frame is loaded_rig.mount.carrier is PoseFrame.BASE:
        motion = CameraMotion(poses=NO_ROBOT_POSES, mount=loaded_rig.mount)  # a track is in the base, too
    setup = Setup(
        rig=loaded_rig,
        method=method,
        frame=frame,
        known=known,
        options=options,
        camera=motion,
        with_budget=budget,
        grasp_near_px=_place_in_image(grasp_near, loaded_rig.camera),
    )
    in_stream = partial(Stream, setup, settings.options(options) if track else None, clock=time)
    lines: AbstractContextManager[Iterator[Measured]]
    with batch, ExitStack() as stack:
        if is_live_robot:
            in_stream = partial(in_stream, motion_until=stack.enter_context(live_camera_motion(rig, batch)))
        file = written.file(stack, force=force)
        if camera is None:
            stream = in_stream()
            read = SourceReader(loaded_rig, channel)
            items = _remaining(batch.valid_inputs(_named(inputs or [])), file, stream, read, batch)
            lines = nullcontext(batch.reported(stream.outcomes(items, read, jobs, with_sources=has_pictures)))
        else:
            lines = _live(camera, shots, loaded_rig, in_stream, batch)
        pictures = _pictures(stack, loaded_rig, rig, overlay, report, force=force) if has_pictures else None
        write = _writer(written.writer(stack, file), track, verbose, batch)
        _write(with_progress(stack.enter_context(lines), "shots", quiet), write, pictures, batch, verbose)
    batch.finish()


def _pictures(
    stack: ExitStack, rig: "Rig", rig_file: Path, overlay: Path | None, report: Path | None, *, force: bool
) -> "PosePictures":
    """Overlays and report, which the stack writes."""
    from ringpose.cli.overlays import PosePictures

    return stack.enter_context(PosePictures(rig, rig_file, overlay, report, force=force))


def _named(inputs: list[str]) -> "Iterator[Input | Problem]":
    """The shots, images and detections that are named."""
    from ringpose.files.images.shots import SHOT_SUFFIXES
    from ringpose.files.inputs import RECORDS_SUFFIX
    from ringpose.files.inputs import inputs as named

    return named(inputs, (RECORDS_SUFFIX, *SHOT_SUFFIXES))


def _remaining(
    items: "Iterable[Input]", file: "LineFile | None", stream: "Stream", read: "SourceReader", batch: Batch
) -> "Iterator[Input]":
    """The inputs without those of which an interrupted run has written the lines, after which the stream continues.

    The first of them is measured again: with other options the file would mix lines of both.
    """
    from ringpose.files.inputs import shot_name
    from ringpose.files.records.line_file import not_of_these_inputs
    from ringpose.files.records.poses import pose_line_of

    remaining, is_first = iter(items), True
    for location, record in () if file is None else file.earlier():
        line = pose_line_of(record, location)
        if line.rig != stream.rig.sha256:
            raise DataError(
                location, "was measured with another rig file", "give that one, or --force without --resume"
            )
        item = next((item for item in remaining if shot_name(item) == line.shot), None)  # those before it had no line
        if item is None:
            raise not_of_these_inputs(location, line.shot)
        if is_first:
            _check_same(line, stream.measure(read(item)).line, location)
            is_first = False
        else:
            stream.continue_after(line)
        if line.pose is None:
            batch.record_status(NO_POSE)
    yield from remaining


def _check_same(earlier: "PoseLine", now: "PoseLine", location: str) -> None:
    """Reject a line that is measured otherwise now."""
    from ringpose.files.records import line_of, parsed_record
    from ringpose.files.records.tracks import line_record

    one, other = (parsed_record(line_of(line_record(line.without_times)).encode(), location) for line in (earlier, now))
    keys = sorted(key for key in one.keys() | other.keys() if one.get(key) != other.get(key))
    if keys:
        finding = f"was measured by other options or another version: its {', '.join(keys[:4])} would not be the same"
        raise DataError(location, finding, "resume with those of the interrupted run, or use --force without --resume")


def _check_order(written: LineOptions, jobs: int, *, is_live: bool, track: bool, pictures: bool) -> None:
    """A live camera and a track need one shot after the other; only whole pose lines hold what a stream keeps."""
    if jobs > 1 and (is_live or track):
        raise UsageError("--jobs", "excludes --camera and --track, which need each shot's result first", "leave it out")
    if not written.resume:
        return
    excluded = {
        "--camera": is_live,
        "--track": track,
        "--brief": written.brief,
        "--format": written.output_format is not Format.RINGPOSE,
        "--overlay and --report": pictures,
    }
    for option, given in excluded.items():
        if given:
            finding = f"excludes {option}: a run is continued after its lines, which must hold all that it needs"
            remedy = (
                "write pose lines first, then run ringpose track" if option == "--track" else "leave one of them out"
            )
            raise UsageError("--resume", finding, remedy)


def _live(
    camera: str, shots: ShotOptions, rig: "Rig", in_stream: "Callable[..., Stream]", batch: Batch
) -> "AbstractContextManager[Iterator[Measured]]":
    """The lines of a live camera."""
    from ringpose.capture.live import live_lines
    from ringpose.cli.acquisition import source_of
    from ringpose.files.images.shots import checked_shot

    return live_lines(shots.request(camera, rig), partial(source_of, batch=batch), in_stream, checked_shot)


def _place_in_image(text: str | None, camera: "Camera") -> tuple[float, float] | None:
    """The place of `--grasp-near`; UsageError unless it is in the image."""
    option, remedy = "--grasp-near", f"give a column and a row, such as {camera.image_width // 2},0"
    size = camera.image_width, camera.image_height
    place = numbers(text, option, remedy, Range(quantity="place", lowest=0, highest=max(size) - 1, unit="pixels"))
    if not place:
        return None
    if len(place) != len(size) or place[0] > size[0] - 1 or place[1] > size[1] - 1:
        raise UsageError(option, f"{text} is not a place in the image of {size[0]} x {size[1]} pixels", remedy)
    return place[0], place[1]


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


def _check_pictures(frame: PoseFrame, rig: "Rig", *, pictures: bool) -> None:
    """Poses in another frame than that of what carries the camera are not drawn."""
    if pictures and rig.mount is not None and frame is not rig.mount.carrier:
        finding = f"{frame} excludes --overlay and --report, which draw poses as the camera sees them"
        raise UsageError("--frame", finding, "leave them out")


def _check_track(track: bool, method: Method, frame: PoseFrame, settings: TrackSettings) -> None:
    """Options of a track need one, and a track needs the measurements of method ml."""
    if not track and settings != TrackSettings():
        raise UsageError("--track", "is missing: the options of a track are given", "add it, or leave them out")
    if track and method is not Method.ML:
        raise UsageError("--track", f"needs measurements, which --method {method.value} has not", "use --method ml")
    if track and frame is PoseFrame.TOOL:
        raise UsageError("--frame", "tool is not an inertial frame, as a track needs", "leave it out")


def _writer(
    write: "Callable[[PoseLine | TrackLine], None]", track: bool, verbose: bool, batch: Batch
) -> "Callable[[Measured], None]":
    """A function that writes a pose line, or the line of the track after it."""

    def pose_written(measured: "Measured") -> None:
        write(measured.line)
        if measured.line.pose is None:
            batch.record_status(NO_POSE)

    if not track:
        return pose_written
    track_written = track_writer(write, verbose, batch)

    def track_of_pose_written(measured: "Measured") -> None:
        if measured.problem is not None:
            batch.report(measured.problem)
        elif measured.track is not None:
            track_written(measured.track)

    return track_of_pose_written


def _write(
    lines: "Iterable[Measured]",
    write: "Callable[[Measured], None]",
    pictures: "PosePictures | None",
    batch: Batch,
    verbose: bool,
) -> None:
    """Write each line as it comes, with what the stream has shown about the rig, then draw the line's picture."""
    from ringpose.pose.advice import remarks_on

    for measured in lines:
        for warning in measured.warnings:
            messages.echo(f"{measured.line.shot}: {warning}")
        write(measured)
        if verbose:
            messages.echo(f"{measured.line.shot}: {remarks_on(measured.line)}")
        if pictures is not None:
            with batch.guarded():
                pictures.add(measured)
