"""Options of `ringpose detect` by which it writes the stripes as points in space."""

from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, ClassVar

import typer

from ringpose.cli import messages
from ringpose.cli.app import OUTPUT, ROBOT
from ringpose.cli.batch import Batch
from ringpose.cli.options.robot import Frame, RobotColumns, RobotConvention, check_frame
from ringpose.cli.options.track import RobotPosesFile, camera_motion
from ringpose.errors import NO_POSE, UsageError
from ringpose.types.options import STDIN, PoseFrame

if TYPE_CHECKING:
    from ringpose.geometry.camera_motion import CameraMotion
    from ringpose.types.assumptions import AssumptionOptions
    from ringpose.types.detection import Detection
    from ringpose.types.image import Shot
    from ringpose.types.points import ShotPoints
    from ringpose.types.rig import Rig


@dataclass(frozen=True, slots=True)
class PointOptions:
    """Where points are written, and in which frame."""

    PURPOSE: ClassVar = ROBOT

    points: Annotated[
        str | None,
        typer.Option(
            "--points",
            metavar="FILE",
            help="Write the stripes as points in space: .ply or .npz; -: as records, instead of the detections.",
            rich_help_panel=OUTPUT,
        ),
    ] = None
    frame: Frame = PoseFrame.CAMERA
    robot_poses: RobotPosesFile = None
    robot_convention: RobotConvention = None
    robot_columns: RobotColumns = None

    @property
    def on_stdout(self) -> bool:
        """Whether records of points are written instead of detections."""
        return self.points == STDIN

    def check(self, rig: Path | None, output: str, force: bool, resume: bool) -> None:
        """Reject options that points are missing for, and a file that cannot be written."""
        if self.points is None:
            for field in fields(self):
                if getattr(self, field.name) != field.default:
                    option = f"--{field.name.replace('_', '-')}"
                    raise UsageError(option, "is of no use without --points", "leave it out, or name a file of points")
        elif rig is None:
            raise UsageError("--points", "needs the rig: without it there are no points", "leave out --segments-only")
        elif resume:
            raise UsageError(
                "--points", "and --resume exclude each other: shots left out have no points", "leave one out"
            )
        elif self.on_stdout and output != STDIN:
            raise UsageError("--points", "and --output both write on standard output", "name a .ply or .npz file")
        elif not self.on_stdout:
            from ringpose.files import atomic, point_clouds  # not imported without points

            point_clouds.check_name(Path(self.points))
            atomic.reject_existing(Path(self.points), force)

    def motion(self, rig: "Rig | None", rig_file: Path | None, inputs: list[str]) -> "CameraMotion | None":
        """The motion of the camera by the robot's poses; None without them."""
        if rig is not None and rig_file is not None:
            check_frame(self.frame, rig, rig_file, self.robot_poses)
        return camera_motion(self.robot_poses, rig_file, inputs, self.robot_convention, self.robot_columns)

    def writer(
        self,
        rig: "Rig | None",
        rig_file: Path | None,
        motion: "CameraMotion | None",
        assumed: "AssumptionOptions",
        batch: Batch,
        stack: ExitStack,
        force: bool,
    ) -> "Callable[[Shot, Detection], None]":
        """A function that writes the points of a shot, or nothing without `--points`. The stack completes the file."""
        if self.points is None or rig is None or rig_file is None:
            return lambda shot, detection: None
        from ringpose.measure.points import stripe_points

        write = self._write(rig, rig_file, stack, force)

        def written(shot: "Shot", detection: "Detection") -> None:
            stability = assumed.about_shot(rig.stability, still=shot.still).stability
            points = stripe_points(detection, rig, stability, self.frame, motion)
            write(points)
            missing = points.left_out.no_robot_pose
            if missing:
                why = "" if motion is None else motion.why_not_at(shot.measured_at_s)
                messages.echo(f"{shot.name}: {missing} points are left out: {why or 'the robot pose is not known'}")
            if missing or not len(points.points.laser):
                batch.record_status(NO_POSE)

        return written

    def _write(self, rig: "Rig", rig_file: Path, stack: ExitStack, force: bool) -> "Callable[[ShotPoints], None]":
        from ringpose.files import records
        from ringpose.files.point_clouds import point_cloud_file
        from ringpose.files.records.points import points_record

        if self.on_stdout:
            return lambda points: records.write(points_record(points))
        path = Path(str(self.points))
        file = point_cloud_file(path, self.frame, rig.lasers.names, force=force, inputs=[rig_file])
        return stack.enter_context(file).add
