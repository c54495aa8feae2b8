"""Options by which poses of a robot are read."""

from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli import messages
from ringpose.cli.app import ROBOT
from ringpose.types.options import STDIN

if TYPE_CHECKING:
    from ringpose.geometry.robot_conventions import PoseConvention
    from ringpose.types.robot import ReportedPoses

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


def report_repeats(robot_poses: str, repeats: int, received: int) -> None:
    """Report how many of the poses of a file, or of standard input (`-`), repeat another one, if any does."""
    if repeats:
        place = "standard input" if robot_poses == STDIN else robot_poses
        messages.echo(f"{place}: {repeats} of {received} poses are exact repeats and are left out")
