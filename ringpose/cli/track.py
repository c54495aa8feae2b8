"""`ringpose track`: pose records -> track records, one a measurement or at a fixed rate."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from time import time
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.app import app
from ringpose.cli.assumption_options import MaxRate, MaxSpeed, assumption_options
from ringpose.cli.options import Inputs, OptionalRigFile, Quiet, Verbose, finite
from ringpose.cli.track_options import (
    Format,
    GripperRadial,
    GripperTilt,
    LostAfter,
    Newest,
    OutputFormat,
    PredictFor,
    RobotPosesFile,
    TrackSettings,
    camera_motion,
    record_writer,
    track_writer,
)

if TYPE_CHECKING:
    from ringpose.cli.batch import Batch
    from ringpose.files.inputs import Input
    from ringpose.track.pipeline import Tracker
    from ringpose.types.track import Attempt, TrackLine

Rate = Annotated[
    float | None,
    typer.Option(
        "--rate", metavar="HZ", min=0.01, max=1000, callback=finite, help="Lines a second, by this computer's clock."
    ),
]
Brief = Annotated[bool, typer.Option("--brief", help="Write lines without attempts and evidence.")]


@app.command()
def track(
    inputs: Inputs,
    rig: OptionalRigFile = None,
    rate: Rate = None,
    predict_for: PredictFor = None,
    lost_after: LostAfter = None,
    max_speed: MaxSpeed = None,
    max_rate: MaxRate = None,
    robot_poses: RobotPosesFile = None,
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

    settings = TrackSettings(predict_for, lost_after, gripper_radial_m, gripper_tilt_deg)
    assumed, motion = assumption_options(False, max_speed, max_rate, None, 1.0), camera_motion(robot_poses, rig, inputs)
    tracker = settings.tracker(read_rig(rig) if rig is not None else None, assumed, motion)
    batch = Batch()
    items = batch.valid_inputs(named(inputs, (RECORDS_SUFFIX,)))
    with ExitStack() as stack:
        write = track_writer(record_writer(stack, newest), output_format, brief, verbose, batch)
        for line in _lines(items, tracker, batch, quiet) if rate is None else _at_rate(items, tracker, batch, rate):
            write(line)
    batch.finish()


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


def _at_rate(items: "Iterator[Input]", tracker: "Tracker", batch: "Batch", rate_hz: float) -> "Iterator[TrackLine]":
    """Lines at a fixed rate of this computer's clock; a thread reads the records meanwhile."""
    from ringpose.cli.ticks import Ticks

    for arrived in Ticks(items, 1.0 / rate_hz):
        for item in arrived:
            _added(item, tracker, batch)
        now_s = time()
        yield tracker.line_at(now_s, now_s + 1.0 / rate_hz)
