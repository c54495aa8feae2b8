"""Options of a track (`ringpose track`, `ringpose pose --track`), and of the format in which lines are written."""

import sys
from collections.abc import Callable, Mapping
from contextlib import ExitStack
from dataclasses import dataclass, replace
from enum import StrEnum
from functools import partial
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, ClassVar

import typer

from ringpose.cli import messages
from ringpose.cli.app import OUTPUT, ROBOT, TRACK, check_plausible, file_option, number_option
from ringpose.cli.batch import Batch
from ringpose.cli.options.robot import tool_poses
from ringpose.errors import NO_POSE, UsageError
from ringpose.types.options import STDIN
from ringpose.types.plausible import GRIPPER_M

if TYPE_CHECKING:
    from ringpose.files.records.line_file import LineFile
    from ringpose.geometry.camera_motion import CameraMotion
    from ringpose.track.explanations import Gripper, TrackOptions
    from ringpose.types.assumptions import AssumptionOptions
    from ringpose.types.pose import PoseLine
    from ringpose.types.track import TrackLine


class Format(StrEnum):
    """Format of the lines."""

    RINGPOSE = "ringpose"
    ROS = "ros"


RobotPosesFile = Annotated[
    str | None,
    typer.Option(
        "--robot-poses",
        metavar="FILE|-",
        help="Poses of the robot with the camera; -: from standard input.",
        rich_help_panel=ROBOT,
    ),
]


@dataclass(frozen=True, slots=True)
class LineOptions:
    """How pose lines and lines of tracks are written to stdout."""

    PURPOSE: ClassVar = OUTPUT

    output_format: Annotated[Format, typer.Option("--format", help="Records, or messages of ROS 2 as JSON.")] = (
        Format.RINGPOSE
    )
    frame_id: Annotated[
        str | None,
        typer.Option(
            "--frame-id", metavar="NAME", help="Of --format ros: name of the frame, for camera, tool or base."
        ),
    ] = None
    json: Annotated[
        bool, typer.Option("--json", help="Write records on a terminal, too, instead of a table for people.")
    ] = False
    newest: Annotated[bool, typer.Option("--newest", help="Skip lines that a slow reader has not read in time.")] = (
        False
    )
    brief: Annotated[
        bool, typer.Option("--brief", help="Write lines without what only filters and experts use, and fewer digits.")
    ] = False
    output: Annotated[
        Path | None,
        file_option("--output", "-o", meaning="Write the lines into this file, which appears when it is complete."),
    ] = None
    resume: Annotated[
        bool, typer.Option("--resume", help="Of --output: continue an interrupted run with the same inputs.")
    ] = False
    no_times: Annotated[
        bool, typer.Option("--no-times", help="Write no durations: the same input gives the same output, byte by byte.")
    ] = False

    def check(self) -> None:
        """Reject options that are of no use together, and an empty name of a frame."""
        if self.resume and self.output is None:
            raise UsageError("--resume", "is of no use without --output", "give --output FILE, too")
        if self.output is not None and self.newest:
            raise UsageError("--newest", "is for readers of standard output", "leave it out, or --output")
        if self.frame_id is not None and self.output_format is not Format.ROS:
            raise UsageError("--frame-id", "is of no use without --format ros", "leave it out, or add the format")
        if self.frame_id is not None and not self.frame_id.strip():
            raise UsageError("--frame-id", "is empty", "name the frame as in the TF tree, as camera_optical_frame")

    def file(self, stack: ExitStack, *, force: bool) -> "LineFile | None":
        """The file of --output, which the stack completes; None without it."""
        if self.output is None:
            return None
        from ringpose.files.records.line_file import LineFile

        return stack.enter_context(LineFile(self.output, force=force, resume=self.resume))

    def writer(self, stack: ExitStack, file: "LineFile | None") -> "Callable[[PoseLine | TrackLine], None]":
        """A function that writes lines to the file, or stdout; with `newest` a slow reader gets the newest one.

        A terminal gets a table unless something is said about the records.
        """
        from ringpose.files import records
        from ringpose.files.records.newest import NewestWriter

        if self == LineOptions(no_times=self.no_times) and sys.stdout is not None and sys.stdout.isatty():
            from ringpose.report.pose_table import PoseTable

            table = PoseTable()
            return lambda line: records.write_text(table.text(line))
        record, write = self._record(), records.write if file is None else file.write
        if self.newest:
            write = stack.enter_context(NewestWriter()).write
        return lambda line: write(record(line.without_times if self.no_times else line))

    def _record(self) -> "Callable[[PoseLine | TrackLine], Mapping[str, Any]]":
        """A function that makes the record of a line, or messages of ROS 2."""
        if self.output_format is Format.ROS:
            from ringpose.files.records.ros import ros_messages

            return partial(ros_messages, frame_id=self.frame_id)
        from ringpose.files.records.tracks import line_record

        if not self.brief:
            return line_record
        from ringpose.files.records.brief import rounded

        return lambda line: rounded(line_record(line, brief=True))


@dataclass(frozen=True, slots=True)
class TrackSettings:
    """The options of a track; None for those that are not given."""

    PURPOSE: ClassVar = TRACK

    predict_for: Annotated[
        float | None,
        number_option(
            "--predict-for",
            "S",
            "Longest prediction; after it, two shots that agree start the track anew; default: 2.",
            0,
        ),
    ] = None
    lost_after: Annotated[
        float | None, number_option("--lost-after", "S", "Time without a shot that ends a track; default: 3.", 0)
    ] = None
    gripper_radial_m: Annotated[
        float | None,
        number_option(
            "--gripper-radial-m", "M", "How far the middle of the ring's band may be from the grasp point.", 0
        ),
    ] = None
    gripper_tilt_deg: Annotated[
        float | None,
        number_option("--gripper-tilt-deg", "DEG", "How far the ring's normal may be from the reported one.", 0, 90),
    ] = None

    def options(self, assumed: "AssumptionOptions") -> "TrackOptions":
        """What the track is followed with; it begins with the motion that is assumed within a shot."""
        from ringpose.measure.stream import track_options

        options = replace(track_options(assumed), gripper=self._gripper())
        if self.predict_for is not None:
            options = replace(options, predict_for_s=self.predict_for)
        if self.lost_after is not None:
            options = replace(options, lost_after_s=self.lost_after)
        if options.lost_after_s < options.predict_for_s:
            finding = f"is {options.lost_after_s:g} s, must not be shorter than --predict-for {options.predict_for_s:g}"
            raise UsageError("--lost-after", finding, "raise it, or lower --predict-for")
        for option, value in (("--max-speed", assumed.max_speed_m_s), ("--max-rate", assumed.max_rate_deg_s)):
            if value == 0:
                raise UsageError(option, "is 0, but a track is of a target that may move", "give more, or leave it out")
        return options

    def _gripper(self) -> "Gripper | None":
        """The limits of the gripper, if they are given."""
        from ringpose.track.explanations import Gripper

        radial_m, tilt_deg = self.gripper_radial_m, self.gripper_tilt_deg
        check_plausible("--gripper-radial-m", radial_m, GRIPPER_M)
        if radial_m is None and tilt_deg is None:
            return None
        if radial_m is None or tilt_deg is None:
            missing = "--gripper-radial-m" if radial_m is None else "--gripper-tilt-deg"
            raise UsageError(missing, "is missing: the probability needs both limits of the gripper", "give both")
        return Gripper(radial_m=radial_m, tilt_rad=radians(tilt_deg))


def camera_motion(
    robot_poses: str | None,
    rig: Path | None,
    inputs: list[str] | None,
    convention: str | None = None,
    columns: str | None = None,
) -> "CameraMotion | None":
    """The motion of the camera, from robot poses that are all read first.

    `inputs` are the arguments of which only one may be `-` together with `robot_poses`. `convention` and `columns` say
    how the poses of a table are stated.
    """
    if robot_poses is None:
        for option, given in (("--robot-convention", convention), ("--robot-columns", columns)):
            if given is not None:
                raise UsageError(option, "is of no use without --robot-poses", "leave it out, or give the poses")
        return None
    from ringpose.files.rigs import read_mount
    from ringpose.files.robot_tables import whole_motion
    from ringpose.geometry.camera_motion import CameraMotion

    if rig is None:
        raise UsageError("--robot-poses", "needs the mount of the camera", "give the rig file with --rig")
    if robot_poses == STDIN and STDIN in (inputs or ()):
        raise UsageError("--robot-poses", "and the input are both standard input", "give one of them as a file")
    mount = read_mount(rig)
    reported, _ = tool_poses(robot_poses, convention, columns)
    return CameraMotion(poses=whole_motion(reported, robot_poses), mount=mount)


def track_writer(write: "Callable[[TrackLine], None]", verbose: bool, batch: Batch) -> "Callable[[TrackLine], None]":
    """A function that writes lines of a track, and with `verbose` reports what became of each measurement."""

    def written(line: "TrackLine") -> None:
        write(line)
        if line.pose is None:
            batch.record_status(NO_POSE)
        for attempt in line.attempts if verbose else ():
            why = f" ({attempt.reason})" if attempt.reason else ""
            messages.echo(f"{attempt.shot}: {attempt.fusion_status}{why}, the track is {line.validity}")

    return written
