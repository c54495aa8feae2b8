"""`ringpose track`: pose records -> track records, one a measurement or at a fixed rate."""

from collections.abc import Iterator
from contextlib import ExitStack
from enum import StrEnum
from pathlib import Path
from time import time
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.app import app
from ringpose.cli.options import Inputs, OptionalRigFile, Quiet, Verbose, finite
from ringpose.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Callable

    from ringpose.cli.batch import Batch
    from ringpose.files.inputs import Input
    from ringpose.geometry.camera_motion import CameraMotion
    from ringpose.track.lines import Gripper
    from ringpose.track.pipeline import Tracker
    from ringpose.types.track import Attempt, TrackLine


class Format(StrEnum):
    """Format of the lines."""

    RINGPOSE = "ringpose"
    ROS = "ros"


Rate = Annotated[
    float | None,
    typer.Option(
        "--rate", metavar="HZ", min=0.01, max=1000, callback=finite, help="Lines a second, by this computer's clock."
    ),
]
PredictFor = Annotated[
    float,
    typer.Option(
        "--predict-for", metavar="S", min=0, callback=finite, help="Longest prediction, then two shots must agree."
    ),
]
LostAfter = Annotated[
    float,
    typer.Option("--lost-after", metavar="S", min=0, callback=finite, help="Time without a shot that ends the track."),
]
MaxSpeed = Annotated[
    float,
    typer.Option(
        "--max-speed", metavar="M_PER_S", min=0, callback=finite, help="Of the ring at the start: two sigmas per axis."
    ),
]
MaxRate = Annotated[
    float,
    typer.Option(
        "--max-rate", metavar="DEG_PER_S", min=0, callback=finite, help="Of its rates at the start: two sigmas."
    ),
]
GripperRadial = Annotated[
    float | None,
    typer.Option(
        "--gripper-radial-m", metavar="M", min=0, callback=finite, help="How far the band may be from the grasp point."
    ),
]
GripperTilt = Annotated[
    float | None,
    typer.Option(
        "--gripper-tilt-deg", metavar="DEG", min=0, max=90, callback=finite, help="How far the normal may be off."
    ),
]
RobotPoses = Annotated[
    Path | None,
    typer.Option("--robot-poses", readable=False, metavar="FILE", help="Poses of the robot that carries the camera."),
]
OutputFormat = Annotated[Format, typer.Option("--format", help="Records, or messages of ROS 2 as JSON.")]
Newest = Annotated[bool, typer.Option("--newest", help="Drop lines that a slow reader has not read in time.")]
Brief = Annotated[bool, typer.Option("--brief", help="Write lines without attempts and evidence.")]


@app.command()
def track(
    inputs: Inputs,
    rig: OptionalRigFile = None,
    rate: Rate = None,
    predict_for: PredictFor = 2.0,
    lost_after: LostAfter = 3.0,
    max_speed: MaxSpeed = 0.05,
    max_rate: MaxRate = 5.0,
    robot_poses: RobotPoses = None,
    gripper_radial_m: GripperRadial = None,
    gripper_tilt_deg: GripperTilt = None,
    output_format: OutputFormat = Format.RINGPOSE,
    newest: Newest = False,
    brief: Brief = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Track a moving ring through pose records: one JSON record a measurement, or --rate a second."""
    from ringpose.cli.batch import Batch
    from ringpose.files.inputs import RECORDS_SUFFIX
    from ringpose.files.inputs import inputs as named
    from ringpose.files.rigs import read_rig
    from ringpose.track.explanations import TrackOptions
    from ringpose.track.lines import LineOptions
    from ringpose.track.pipeline import Tracker
    from ringpose.types.assumptions import motion_prior

    if lost_after < predict_for:
        raise UsageError("--lost-after", f"is {lost_after:g} s, must not be shorter than --predict-for {predict_for:g}")
    if max_speed == 0 or max_rate == 0:
        raise UsageError("--max-speed, --max-rate", "must be larger than 0: a track is of a target that may move")
    gripper = _gripper(gripper_radial_m, gripper_tilt_deg)
    options = TrackOptions(
        predict_for_s=predict_for,
        lost_after_s=lost_after,
        motion=motion_prior(max_speed, max_rate),
    )
    batch = Batch()
    rig_of_records = read_rig(rig) if rig is not None else None
    tracker = Tracker(rig_of_records, options, LineOptions(gripper=gripper), _camera_motion(robot_poses, rig))
    items = batch.valid_inputs(named(inputs, (RECORDS_SUFFIX,)))
    with ExitStack() as stack:
        write = _writer(stack, output_format, newest, brief, verbose, batch)
        if rate is None:
            for line in _lines(items, tracker, batch, quiet):
                write(line)
        else:
            for line in _lines_at_rate(items, tracker, batch, rate):
                write(line)
    batch.finish()


def _camera_motion(robot_poses: Path | None, rig: Path | None) -> "CameraMotion | None":
    from ringpose.files.robot_poses import read_mount_with_errors, read_robot_poses
    from ringpose.geometry.camera_motion import CameraMotion

    if robot_poses is None:
        return None
    if rig is None:
        raise UsageError("--robot-poses", "needs the mount of the camera", "give the rig file with --rig")
    return CameraMotion(poses=read_robot_poses(robot_poses), mount=read_mount_with_errors(rig))


def _gripper(radial_m: float | None, tilt_deg: float | None) -> "Gripper | None":
    from math import radians

    from ringpose.track.lines import Gripper

    if radial_m is None and tilt_deg is None:
        return None
    if radial_m is None or tilt_deg is None:
        missing = "--gripper-radial-m" if radial_m is None else "--gripper-tilt-deg"
        raise UsageError(missing, "is missing: the probability needs both limits of the gripper")
    return Gripper(radial_m=radial_m, tilt_rad=radians(tilt_deg))


def _writer(
    stack: ExitStack, output_format: Format, newest: bool, brief: bool, verbose: bool, batch: "Batch"
) -> "Callable[[TrackLine], None]":
    """Writes lines to stdout, and with `verbose` what became of each measurement to stderr."""
    from ringpose.cli import messages
    from ringpose.errors import NO_POSE
    from ringpose.files import records
    from ringpose.files.records.newest import NewestWriter
    from ringpose.files.ros import ros_messages
    from ringpose.files.tracks import track_record

    write = stack.enter_context(NewestWriter()).write if newest else records.write_text

    def written(line: "TrackLine") -> None:
        record = ros_messages(line) if output_format is Format.ROS else track_record(line, brief)
        write(records.line_of(record))
        if line.pose is None:
            batch.record_status(NO_POSE)
        for each in line.attempts if verbose else ():
            messages.echo(f"{each.shot}: {each.fusion_status}, the track is {line.validity}")

    return written


def _added(item: "Input", tracker: "Tracker", batch: "Batch") -> "Attempt | None":
    """Add a record to the track; None if it is not a record of this track, which is reported on stderr."""
    from ringpose.errors import DataError, NoInputError
    from ringpose.files.poses import pose_line_of

    attempt = None
    with batch.guarded():
        if isinstance(item, Path):
            if not item.exists():
                raise NoInputError(str(item), "does not exist")
            raise DataError(str(item), "is not a file of pose records", "give the output of ringpose pose")
        line = pose_line_of(item.values, item.location)
        try:
            attempt = tracker.add(line, time())
        except DataError as problem:
            raise DataError(f"{item.location}: {problem.location}", problem.found, problem.remedy) from problem
    return attempt


def _lines(items: "Iterator[Input]", tracker: "Tracker", batch: "Batch", quiet: bool) -> "Iterator[TrackLine]":
    """A line after each record."""
    from ringpose.cli.progress import with_progress

    for item in with_progress(items, "records", quiet):
        attempt = _added(item, tracker, batch)
        if attempt is not None:
            yield tracker.line_of(attempt)


def _lines_at_rate(
    items: "Iterator[Input]", tracker: "Tracker", batch: "Batch", rate_hz: float
) -> "Iterator[TrackLine]":
    """Lines at a fixed rate of this computer's clock; a thread reads the records meanwhile."""
    from ringpose.cli.ticks import Ticks

    for arrived in Ticks(items, 1.0 / rate_hz):
        for item in arrived:
            _added(item, tracker, batch)
        now_s = time()
        yield tracker.line_at(now_s, now_s + 1.0 / rate_hz)
