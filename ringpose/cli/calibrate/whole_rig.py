"""`ringpose calibrate-mount --whole-rig`: shots of a board with stripes and robot poses -> camera, planes and mount."""

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, NamedTuple

from ringpose.calibrate.boards.corner_errors import without_distortion_bias
from ringpose.calibrate.boards.shots import BoardShots
from ringpose.calibrate.camera.pipeline import assessed_camera
from ringpose.calibrate.camera.quality import camera_quality, camera_summary, camera_verdict
from ringpose.calibrate.mount import quality
from ringpose.calibrate.mount.pipeline import calibrate_mount
from ringpose.calibrate.mount.whole_rig import WholeRig, whole_rig
from ringpose.calibrate.planes.pipeline import PlanesModel, StripeShots, evidence_of
from ringpose.calibrate.planes.quality import calibrated_rig, planes_quality, planes_summary
from ringpose.calibrate.planes.stripes.labels import laser_order
from ringpose.cli import messages
from ringpose.cli.batch import Batch
from ringpose.cli.calibrate.board_views import BoardReader
from ringpose.cli.calibrate.mount import resting_stations, time_of_board
from ringpose.cli.calibrate.outputs import reject_existing_outputs, report_verdict, session_names
from ringpose.cli.options.robot import tool_poses
from ringpose.files.boards import read_board
from ringpose.files.images.shots import read_shots
from ringpose.files.inputs import holds_records
from ringpose.files.rigs import write_rig
from ringpose.types.options import PlanesMethod

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ringpose.calibrate.mount.stations import Station
    from ringpose.geometry.robot_conventions import PoseConvention
    from ringpose.types.calibration import CameraAssessment
    from ringpose.types.image import Shot


class ShotOptions(NamedTuple):
    """Options by which shots are read."""

    board: Path
    laser_names: str | None
    laser_order: str | None
    overlay: Path | None
    channel: str | None
    force: bool
    verbose: bool
    quiet: bool


class RobotOptions(NamedTuple):
    """Options by which poses of the robot are read."""

    poses: str
    convention: str | None
    columns: str | None
    eye_to_hand: bool


def calibrate_whole_rig(inputs: list[str], output: Path, options: ShotOptions, robot: RobotOptions) -> None:
    """Estimate camera, light planes and mount from one session, and write the rig."""
    files = [options.board, *([Path(robot.poses)] if Path(robot.poses).is_file() else [])]
    reject_existing_outputs(output, None, options.force, files)
    poses, convention = tool_poses(robot.poses, robot.convention, robot.columns)
    boards = BoardShots(read_board(options.board), names_differ=True)
    names = options.laser_names or session_names(inputs)
    batch = Batch()
    times_s: dict[str, tuple[float, float]] = {}

    def note_time(shot: "Shot", view: object) -> str:
        times_s[shot.name] = time_of_board(shot, moving=False)
        return "board found"

    reader = BoardReader(
        boards, overlay=options.overlay, channel=options.channel, luminance_too=True, outputs=(output,),
        force=options.force,
    )  # fmt: skip
    reader.read_each(inputs, batch, note_time, quiet=options.quiet, verbose=options.verbose)
    with batch.guarded():
        views = [view for view in boards.views if view.name in times_s]
        stations, problems = resting_stations(views, [times_s[view.name] for view in views], poses, robot.poses)
        for problem in problems:
            batch.report(problem)
        camera = assessed_camera(boards)
        shots = StripeShots(boards, camera.calibration.camera, names, options.laser_order)
        _add_stripes(shots, reader.paths, options.channel, batch)
        rig = _solved(camera, shots, stations, convention, eye_to_hand=robot.eye_to_hand)
        records = [Path(robot.poses)] if holds_records(Path(robot.poses)) else []
        read = list(dict.fromkeys([*files, *records, *reader.paths]))
        batch.record_status(_write(rig, boards, output, read, force=options.force, quiet=options.quiet))
    batch.finish()


def _add_stripes(stripes: StripeShots, paths: "Sequence[Path]", channel: str | None, batch: Batch) -> None:
    """Read the shots once more: their stripes are searched with the camera that their boards have given."""
    views = {view.name: view for view in stripes.boards.views}
    for path in paths:
        for shot in read_shots(path, channel):
            if shot.name in views:
                with batch.guarded():
                    stripes.add(shot, views[shot.name])


def _solved(
    camera: "CameraAssessment", stripes: StripeShots, stations: "Sequence[Station]",
    convention: "PoseConvention | None", *, eye_to_hand: bool,
) -> WholeRig:  # fmt: skip
    """The better one of the separate and the joint solution."""
    own = camera.calibration.camera
    mount = calibrate_mount(stations, own, eye_to_hand=eye_to_hand, convention=convention)
    planes = stripes.assessment(PlanesMethod.JOINT)
    views = [replace(view, board=without_distortion_bias(view.board, own)) for view in stripes.views]
    order = laser_order(stripes.given_order, stripes.names)
    evidence, _, _ = evidence_of(views, own, PlanesModel(names=stripes.names, order=order))
    return whole_rig(camera, planes, evidence, mount)


def _write(rig: WholeRig, boards: BoardShots, output: Path, read: list[Path], *, force: bool, quiet: bool) -> int:
    """Write the rig, and report its parts; the exit status is that of the worst verdict."""
    mount_verdict = quality.mount_verdict(rig.mount)
    seen_verdict = camera_verdict(rig.camera, boards.images)
    values = {
        **planes_quality(rig.planes)["quality"],
        "camera": camera_quality(rig.camera, seen_verdict, boards.without_board)["quality"],
        "mount": quality.mount_quality(rig.mount, mount_verdict),
        "whole_rig": quality.whole_rig_quality(rig),
    }
    written = replace(calibrated_rig(rig.planes.calibration), mount=rig.mount.mount)
    write_rig(output, written, extra={"quality": values}, force=force, inputs=read)
    parts = [
        ("camera, by the corners alone", seen_verdict, camera_summary(rig.camera, seen_verdict)),
        ("light planes", rig.planes.verdict, planes_summary(rig.planes)),
        ("mount", mount_verdict, quality.mount_summary(rig.mount, mount_verdict)),
    ]
    if rig.is_joint:  # planes and mount have the joint solution's camera, with its covariance
        parts = parts[1:]
    for line in quality.whole_rig_lines(rig) if not quiet else ():
        messages.echo(line)
    statuses = []
    for name, verdict, lines in parts:
        if not quiet:
            messages.echo(f"{name}:")
        statuses.append(report_verdict(verdict, lines, quiet=quiet))
    return max(statuses)
