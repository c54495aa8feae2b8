"""`ringpose calibrate-mount`: views of a board and poses of the robot -> the mount, in rig.yaml."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli import messages
from ringpose.cli.app import OUTPUT, BoardFile, Force, ImageChannel, Inputs, Overlay, Quiet, Verbose, app, file_option
from ringpose.cli.calibrate.outputs import LaserNames, LaserOrder
from ringpose.cli.options.robot import RobotColumns, RobotConvention, tool_poses
from ringpose.errors import DataError, UsageError
from ringpose.types.options import PoseFrame

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from ringpose.calibrate.mount.moving import ToolMotion
    from ringpose.calibrate.mount.pipeline import MountCalibration
    from ringpose.calibrate.mount.stations import Station
    from ringpose.types.board import BoardView
    from ringpose.types.image import Shot
    from ringpose.types.rig import Mount
    from ringpose.types.robot import ReportedPoses

CameraFile = Annotated[
    Path | None,
    file_option(
        "--camera",
        meaning="The calibrated camera, or the rig whose mount is written (rig.yaml); required without --whole-rig.",
    ),
]
RobotPosesFile = Annotated[
    str,
    typer.Option("--robot-poses", metavar="FILE|DIR|-", help="Poses of the tool in the robot's base, one a view."),
]
Output = Annotated[
    Path | None,
    file_option("--output", "-o", meaning="Where the rig, or the mount alone, is written.", purpose=OUTPUT),
]
EyeToHand = Annotated[
    bool, typer.Option("--eye-to-hand", help="The camera is fixed beside the robot, whose tool carries the board.")
]
RefineCamera = Annotated[
    bool, typer.Option("--refine-camera", help="Let the views improve the camera, from its covariance.")
]
Whole = Annotated[
    bool, typer.Option("--whole-rig", help="Calibrate camera and light planes, too, from shots that show stripes.")
]
Moving = Annotated[
    bool, typer.Option("--moving", help="The robot moves at the views: estimate the offset of its clock, too.")
]
Check = Annotated[
    Path | None, file_option("--check", metavar="MOUNT", meaning="Only compare this mount (of a rig) with the views.")
]


@app.command("calibrate-mount")
def calibrate_mount(
    board: BoardFile,
    inputs: Inputs,
    robot_poses: RobotPosesFile,
    camera: CameraFile = None,
    output: Output = None,
    robot_convention: RobotConvention = None,
    robot_columns: RobotColumns = None,
    eye_to_hand: EyeToHand = False,
    refine_camera: RefineCamera = False,
    whole_rig: Whole = False,
    laser_names: LaserNames = None,
    laser_order: LaserOrder = None,
    moving: Moving = False,
    check: Check = None,
    overlay: Overlay = None,
    channel: ImageChannel = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Estimate where the camera is mounted on a robot, from views of a resting board and the robot's poses.

    Ten to fifteen views are good, each with the robot at rest (else give --moving), turned by 20 degrees or more about
    two axes.
    """
    from ringpose.calibrate.boards.shots import BoardShots
    from ringpose.cli.batch import Batch
    from ringpose.cli.calibrate.board_views import BoardReader
    from ringpose.cli.calibrate.outputs import given, reject_existing_outputs
    from ringpose.files.boards import read_board
    from ringpose.files.cameras.formats import read_camera
    from ringpose.files.inputs import holds_records

    if whole_rig:
        from ringpose.cli.calibrate.whole_rig import RobotOptions, ShotOptions, calibrate_whole_rig

        _reject_useless(
            "--whole-rig", {"--camera": camera, "--check": check, "--refine-camera": refine_camera, "--moving": moving}
        )
        shots = ShotOptions(board, laser_names, laser_order, overlay, channel, force, verbose, quiet)
        robot = RobotOptions(robot_poses, robot_convention, robot_columns, eye_to_hand)
        calibrate_whole_rig(inputs, given(output, "--output"), shots, robot)
        return
    _reject_useless("a mount without --whole-rig", {"--laser-names": laser_names, "--laser-order": laser_order})
    camera = given(camera, "--camera", "or give --whole-rig, with shots that show stripes")
    known = None if check is None else _given_mount(check, output, eye_to_hand)
    files = [board, camera, *([Path(robot_poses)] if Path(robot_poses).is_file() else [])]
    if check is None:
        reject_existing_outputs(given(output, "--output"), None, force, files)
    poses, convention = tool_poses(robot_poses, robot_convention, robot_columns)
    boards = BoardShots(read_board(board), names_differ=True)
    read_cam = read_camera(camera)
    batch = Batch()
    times_s: dict[str, tuple[float, float]] = {}

    def note_time(shot: "Shot", view: object) -> str:
        times_s[shot.name] = time_of_board(shot, moving)
        return "board found"

    reader = BoardReader(boards, overlay=overlay, channel=channel, outputs=(output,), force=force)
    reader.read_each(inputs, batch, note_time, quiet=quiet, verbose=verbose)
    with batch.guarded():
        from ringpose.calibrate.mount.pipeline import calibrate_mount as calibrated

        views = [view for view in boards.views if view.name in times_s]
        times = [times_s[view.name] for view in views]
        if moving:
            from ringpose.calibrate.mount.pipeline import moving_stations

            stamps_s, exposures_s = [middle_s for middle_s, _ in times], [exposure_s for _, exposure_s in times]
            stations, problems = moving_stations(
                views, read_cam, stamps_s, exposures_s, _motion(poses, robot_poses), eye_to_hand=eye_to_hand,
                convention=convention,
            )  # fmt: skip
        else:
            stations, problems = resting_stations(views, times, poses, robot_poses)
        for problem in problems:
            batch.report(problem)
        calibration = calibrated(
            stations, read_cam, eye_to_hand=eye_to_hand, refine_camera=refine_camera, convention=convention
        )
        records = [Path(robot_poses)] if holds_records(Path(robot_poses)) else []
        inputs_read = list(dict.fromkeys([*files, *records, *reader.paths]))
        batch.record_status(
            _compared(calibration, known, quiet=quiet)
            if known is not None
            else _write(calibration, camera, given(output, "--output"), inputs_read, force=force, quiet=quiet)
        )
    batch.finish()


def _reject_useless(mode: str, options: "Mapping[str, object]") -> None:
    """Reject options that the mode would ignore."""
    for option, value in options.items():
        if value:
            raise UsageError(option, f"is of no use for {mode}", "leave it out")


def time_of_board(shot: "Shot", moving: bool) -> tuple[float, float]:
    """Middle and length of the exposure in which the board is searched; DataError if a moving board is in several."""
    import numpy as np

    off = np.flatnonzero(shot.lasers == 0)
    if moving and not len(off) and len(shot.lasers) > 1:
        raise DataError(shot.name, "has no frame with the lasers off, and the robot moves", "give a shot with one")
    frame = int(off[0]) if len(off) else 0
    exposure_s = float(shot.exposure_s[frame])
    return float(shot.stamp_s[frame]) + exposure_s / 2, exposure_s


def resting_stations(
    views: "Sequence[BoardView]", times: "Sequence[tuple[float, float]]", poses: "ReportedPoses", location: str
) -> "tuple[list[Station], list[DataError]]":
    """The views with the poses of a robot that rests at each of them; a warning if it does not."""
    from ringpose.calibrate.mount.matching import matched_poses, motion_finding
    from ringpose.calibrate.mount.pipeline import stations_of

    stamps_s = [middle_s for middle_s, _ in times]
    matched = matched_poses([view.name for view in views], stamps_s, poses.poses, location)
    if len(poses.poses) > 1 and all(pose.stamp_s is not None and not pose.name for pose in poses.poses):
        finding = motion_finding(stamps_s, _motion(poses, location))
        if finding:
            messages.echo(f"{location}: warning: {finding}; give --moving")
    return stations_of(views, matched), [each for each in matched if isinstance(each, DataError)]


def _motion(poses: "ReportedPoses", location: str) -> "ToolMotion":
    """The motion of the tool by its poses, which name their lines."""
    from ringpose.calibrate.mount.moving import ToolMotion
    from ringpose.files.robot_tables import whole_motion

    motion = whole_motion(poses, location)
    in_time = sorted(poses.poses, key=lambda pose: pose.stamp_s or 0.0)
    return ToolMotion(poses=motion, locations=tuple(pose.location for pose in in_time))


def _given_mount(check: Path, output: Path | None, eye_to_hand: bool) -> "Mount":
    """The mount to compare with the views, of a camera that is where these have it."""
    from ringpose.files.rigs import read_mount

    if output is not None:
        raise UsageError("--check", "only compares", "leave out --output")
    given = read_mount(check)
    if (given.carrier is PoseFrame.BASE) != eye_to_hand:
        remedy = "leave out --eye-to-hand" if eye_to_hand else "give --eye-to-hand"
        raise UsageError("--check", f"{check} has its camera in the frame of the {given.carrier}", remedy)
    return given


def _compared(calibration: "MountCalibration", known: "Mount", *, quiet: bool) -> int:
    """Report how a given mount compares with that of the views; the exit status is returned."""
    from ringpose.calibrate.mount.quality import compared_mount, comparison_lines, comparison_verdict
    from ringpose.cli.calibrate.outputs import report_verdict

    comparison = compared_mount(calibration, known)
    verdict = comparison_verdict(comparison)
    return report_verdict(verdict, comparison_lines(comparison, verdict), quiet=quiet)


def _write(
    calibration: "MountCalibration", camera: Path, output: Path, read: list[Path], *, force: bool, quiet: bool
) -> int:
    """Write the rig with its mount, or the mount alone where there is only a camera; the exit status is returned."""
    from ringpose.calibrate.mount.quality import mount_quality, mount_summary, mount_verdict
    from ringpose.cli.calibrate.outputs import report_verdict
    from ringpose.files.rigs import write_mount

    verdict = mount_verdict(calibration)
    write_mount(output, calibration.mount, camera, mount_quality(calibration, verdict), force=force, inputs=read)
    return report_verdict(verdict, mount_summary(calibration, verdict), quiet=quiet)
