"""`ringpose track`: pose records -> track records, one a measurement or at a fixed rate."""

from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path
from time import time
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli import messages
from ringpose.cli.app import Force, Quiet, Verbose, app, file_option, number_option, with_option_groups
from ringpose.cli.batch import Batch, with_progress
from ringpose.cli.options.assumptions import Assumed, MaxRate, MaxSpeed
from ringpose.cli.options.robot import RobotColumns, RobotConvention
from ringpose.cli.options.track import (
    LineOptions,
    RobotPosesFile,
    TrackSettings,
    camera_motion,
    track_writer,
)
from ringpose.errors import DataError, NoInputError, UsageError

if TYPE_CHECKING:
    from ringpose.files.inputs import Input
    from ringpose.files.records.line_file import LineFile
    from ringpose.track.pipeline import Tracker
    from ringpose.types.track import Attempt, TrackLine


OptionalRig = Annotated[
    Path | None,
    file_option("--rig", meaning="The rig of the records; required if it has a covariance, and with --robot-poses."),
]


@app.command()
@with_option_groups
def track(
    *,
    inputs: Annotated[
        list[str],
        typer.Argument(
            metavar="INPUT...",
            help="Files of pose records (.jsonl), or folders of these; - reads records or names from standard input.",
        ),
    ],
    rig: OptionalRig = None,
    rate: Annotated[
        float | None, number_option("--rate", "HZ", "Lines a second, by this computer's clock.", 0.01, 1000)
    ] = None,
    settings: TrackSettings,
    max_speed: MaxSpeed = None,
    max_rate: MaxRate = None,
    robot_poses: RobotPosesFile = None,
    robot_convention: RobotConvention = None,
    robot_columns: RobotColumns = None,
    written: LineOptions,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Track a moving ring through pose records: one JSON record a measurement, or --rate a second."""
    from ringpose.files.inputs import RECORDS_SUFFIX
    from ringpose.files.inputs import inputs as named
    from ringpose.files.rigs import read_rig
    from ringpose.track.pipeline import Tracker

    written.check()
    if written.resume and rate is not None:
        raise UsageError("--resume", "is of no use with --rate, by which lines are of the present", "leave it out")
    assumed = Assumed(max_speed=max_speed, max_rate=max_rate).options
    motion = camera_motion(robot_poses, rig, inputs, robot_convention, robot_columns)
    tracker = Tracker(read_rig(rig) if rig is not None else None, settings.options(assumed), motion)
    batch = Batch()
    items = batch.valid_inputs(named(inputs, (RECORDS_SUFFIX,)))
    with batch, ExitStack() as stack:
        file = written.file(stack, force=force)
        write = track_writer(written.writer(stack, file), verbose, batch)
        lines = _lines(items, tracker, batch, quiet) if rate is None else _at_rate(items, tracker, batch, rate)
        for line in lines if file is None else _after(lines, file):
            write(line)
    batch.finish()


def _after(lines: "Iterator[TrackLine]", file: "LineFile") -> "Iterator[TrackLine]":
    """The lines after those that an interrupted run has written; all are computed again, as each needs those before."""
    from ringpose.files.records.line_file import not_of_these_inputs

    for location, record in file.earlier():
        line = next(lines, None)
        if line is None or line.shot != record.get("shot"):
            raise not_of_these_inputs(location, record.get("shot"))
    yield from lines


class _Records:
    """Adds records to a track; what concerns all records of a stream is reported once, on stderr."""

    def __init__(self, tracker: "Tracker", batch: Batch) -> None:
        self._tracker, self._batch = tracker, batch
        self._reported: set[str] = set()

    def added(self, item: "Input", at_rate: bool = False) -> "Attempt | None":
        """Add a record and return how it was used; None, with a message, if it does not belong to this track."""
        from ringpose.files.records.poses import pose_line_of

        attempt = None
        with self._batch.guarded():
            if isinstance(item, Path):
                if not item.exists():
                    raise NoInputError(str(item), "does not exist")
                raise DataError(str(item), "is not a file of pose records", "give the output of ringpose pose")
            line, now_s = pose_line_of(item.values, item.location), time()
            try:
                attempt = self._tracker.add(line, now_s)
            except DataError as problem:
                raise DataError(item.location, problem.finding, problem.remedy) from problem
            if line.pose is not None and line.measurement is None:
                self._report_once(
                    f"{item.location}: has no measurement", "measure with --method ml and without --brief"
                )
            age_s = now_s - attempt.stamp_s
            if at_rate and age_s > self._tracker.options.lost_after_s:
                finding = f"{item.location}: is {age_s:.3g} s old by this computer's clock, so that the track is lost"
                self._report_once(finding, "leave out --rate for recorded poses, or set the clock")
        return attempt

    def _report_once(self, finding: str, remedy: str) -> None:
        if remedy not in self._reported:
            self._reported.add(remedy)
            messages.echo(f"{finding}; {remedy} (reported once)")


def _lines(items: "Iterator[Input]", tracker: "Tracker", batch: Batch, quiet: bool) -> "Iterator[TrackLine]":
    """A line after each record."""
    records = _Records(tracker, batch)
    for item in with_progress(items, "records", quiet):
        attempt = records.added(item)
        if attempt is not None:
            yield tracker.line_of(attempt, time())


def _at_rate(items: "Iterator[Input]", tracker: "Tracker", batch: Batch, rate_hz: float) -> "Iterator[TrackLine]":
    """Lines at a fixed rate of this computer's clock; a thread reads the records meanwhile."""
    from ringpose.cli.live_input import at_ticks

    records, now_s = _Records(tracker, batch), time()
    for arrived in at_ticks(items, 1.0 / rate_hz):
        last_s, now_s = now_s, time()
        if now_s < last_s:  # the next line would be older than the last one, and what was measured too young
            messages.echo(f"this computer's clock was set back by {last_s - now_s:.3g} s; the track starts anew")
            tracker.start_anew()
        for item in arrived:
            records.added(item, at_rate=True)
        yield tracker.line_at(now_s, now_s + 1.0 / rate_hz, now_s)
