"""Options by which poses of a robot are read."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli import messages
from ringpose.cli.app import ROBOT
from ringpose.errors import UsageError
from ringpose.types.options import STDIN, PoseFrame

if TYPE_CHECKING:
    from ringpose.geometry.robot_conventions import PoseConvention
    from ringpose.types.rig import Rig
    from ringpose.types.robot import ReportedPoses

Frame = Annotated[
    PoseFrame,
    typer.Option(
        "--frame",
        help="Frame of the vectors: tool and base need the rig's mount, and maybe --robot-poses.",
        rich_help_panel=ROBOT,
    ),
]
RobotConvention = Annotated[
    str | None,
    typer.Option(
        "--robot-convention",
        metavar="NAME",
        help="How the poses are stated: abb, kuka, fanuc, ur ..., or mm,ZYX,deg.",
        rich_help_panel=ROBOT,
    ),
]
RobotColumns = Annotated[
    str | None,
    typer.Option(
        "--robot-columns",
        metavar="NAMES",
        help="The columns of a table, comma between, as shot,x,y,z,a,b,c.",
        rich_help_panel=ROBOT,
    ),
]


def tool_poses(
    source: str, convention: str | None, columns: str | None
) -> "tuple[ReportedPoses, PoseConvention | None]":
    """The poses that the options give, and the convention; repeats are reported."""
    from ringpose.files.robot_tables import convention_of, read_tool_poses

    known, is_tum = convention_of(convention)
    names = [] if columns is None else [name.strip() for name in columns.split(",")]
    poses = read_tool_poses(source, known, names, is_tum)
    report_repeats(source, poses.repeats, poses.repeats + len(poses.poses))
    return poses, known


def check_frame(frame: PoseFrame, rig: "Rig", rig_file: Path, robot_poses: str | None) -> None:
    """Vectors in the frame of tool or base need the mount, and unless that is in it, the poses of the robot."""
    from ringpose.files.rigs import require_mount

    if frame is PoseFrame.CAMERA:
        return
    require_mount(rig, rig_file)
    if rig.mount is not None and frame is not rig.mount.carrier and robot_poses is None:
        finding = f"{frame} needs the poses of the robot, as the rig's mount is in the frame of the {rig.mount.carrier}"
        raise UsageError("--frame", finding, "give them with --robot-poses")


def report_repeats(robot_poses: str, repeats: int, received: int) -> None:
    """Report how many of the poses of a file, or of standard input (`-`), repeat another one, if any does."""
    if repeats:
        place = "standard input" if robot_poses == STDIN else robot_poses
        messages.echo(f"{place}: {repeats} of {received} poses are exact repeats and are left out")
