"""`ringpose calibrate-mount`: views of a board and poses of the robot -> the mount, in rig.yaml."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.app import BoardFile, Force, ImageChannel, Inputs, Overlay, Quiet, Verbose, app, file_option
from ringpose.cli.options.robot import RobotColumns, RobotConvention, tool_poses
from ringpose.errors import UsageError
from ringpose.types.options import PoseFrame

if TYPE_CHECKING:
    from ringpose.calibrate.mount.pipeline import MountCalibration
    from ringpose.types.image import Shot
    from ringpose.types.rig import Mount

CameraFile = Annotated[
    Path, file_option("--camera", meaning="The calibrated camera, or the rig whose mount is written (rig.yaml).")
]
RobotPosesFile = Annotated[
    str,
    typer.Option("--robot-poses", metavar="FILE|DIR|-", help="Poses of the tool in the robot's base, one a view."),
]
Output = Annotated[Path | None, file_option("--output", "-o", meaning="Where the rig, or the mount alone, is written.")]
EyeToHand = Annotated[
    bool, typer.Option("--eye-to-hand", help="The camera is fixed beside the robot, whose tool carries the board.")
]
RefineCamera = Annotated[
    bool, typer.Option("--refine-camera", help="Let the views improve the camera, from its covariance.")
]
Check = Annotated[
    Path | None, file_option("--check", metavar="MOUNT", meaning="Only compare this mount (of a rig) with the views.")
]


@app.command("calibrate-mount")
def calibrate_mount(
    board: BoardFile,
    inputs: Inputs,
    camera: CameraFile,
    robot_poses: RobotPosesFile,
    output: Output = None,
    robot_convention: RobotConvention = None,
    robot_columns: RobotColumns = None,
    eye_to_hand: EyeToHand = False,
    refine_camera: RefineCamera = False,
    check: Check = None,
    overlay: Overlay = None,
    channel: ImageChannel = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Estimate where the camera is mounted on a robot, from views of a resting board and the robot's poses.

    Ten to fifteen views are good, each with the robot at rest, turned by 20 degrees or more about two axes.
    """
    from ringpose.calibrate.boards.shots import BoardShots
    from ringpose.calibrate.mount.quality import compared_mount, comparison_lines, comparison_verdict
    from ringpose.cli.batch import Batch
    from ringpose.cli.calibrate.board_views import BoardReader
    from ringpose.cli.calibrate.outputs import given, reject_existing_outputs, report_verdict
    from ringpose.files.boards import read_board
    from ringpose.files.cameras.formats import read_camera
    from ringpose.files.inputs import holds_records

    known = None if check is None else _given_mount(check, output, eye_to_hand)
    files = [board, camera, *([Path(robot_poses)] if Path(robot_poses).is_file() else [])]
    if check is None:
        reject_existing_outputs(given(output, "--output"), None, force, files)
    poses, convention = tool_poses(robot_poses, robot_convention, robot_columns)
    boards = BoardShots(read_board(board), names_differ=True)
    read_cam = read_camera(camera)
    batch = Batch()
    stamps_s: dict[str, float] = {}

    def stamp(shot: "Shot", view: object) -> str:
        stamps_s[shot.name] = float(shot.stamp_s[0] + shot.exposure_s[0] / 2)
        return "board found"

    reader = BoardReader(boards, overlay=overlay, channel=channel, outputs=(output,), force=force)
    reader.read_each(inputs, batch, stamp, quiet=quiet, verbose=verbose)
    with batch.guarded():
        from ringpose.calibrate.mount.matching import matched_poses
        from ringpose.calibrate.mount.pipeline import calibrate_mount as calibrated
        from ringpose.calibrate.mount.pipeline import stations_of

        names = [view.name for view in boards.views]
        matched = matched_poses(names, [stamps_s[name] for name in names], poses.poses, robot_poses)
        for problem in matched:
            if isinstance(problem, Exception):
                batch.report(problem)
        calibration = calibrated(
            stations_of(boards.views, matched), read_cam, eye_to_hand=eye_to_hand, refine_camera=refine_camera,
            convention=convention,
        )  # fmt: skip
        if known is not None:
            comparison = compared_mount(calibration, known)
            verdict = comparison_verdict(comparison)
            batch.record_status(report_verdict(verdict, comparison_lines(comparison, verdict), quiet=quiet))
        elif output is not None:
            records = [Path(robot_poses)] if holds_records(Path(robot_poses)) else []
            inputs_read = list(dict.fromkeys([*files, *records, *reader.paths]))
            batch.record_status(_write(calibration, camera, output, inputs_read, force=force, quiet=quiet))
    batch.finish()


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
