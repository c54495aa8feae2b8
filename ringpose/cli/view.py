"""`ringpose view`: recorded shots with their poses, tracks and truth, in the browser or as one HTML page."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import replace
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

from ringpose.cli import messages
from ringpose.cli.app import OUTPUT, Force, ImageChannel, Inputs, Quiet, RigFile, app, file_option
from ringpose.cli.batch import Batch, with_progress
from ringpose.cli.options.robot import RobotColumns, RobotConvention, check_frame
from ringpose.cli.options.track import RobotPosesFile, camera_motion
from ringpose.cli.pages import PagePort, announce
from ringpose.errors import DataError, NoInputError, UsageError
from ringpose.types.options import PoseFrame

if TYPE_CHECKING:
    from ringpose.console.replay import ReplayCloud, ReplayShot
    from ringpose.geometry.camera_motion import CameraMotion
    from ringpose.types.arrays import Array, Float64
    from ringpose.types.image import Shot
    from ringpose.types.pose import PoseLine
    from ringpose.types.rig import Rig
    from ringpose.types.truth import Truth


@app.command()
def view(
    inputs: Inputs,
    rig: RigFile,
    poses: Annotated[
        list[Path] | None, file_option("--poses", meaning="The output of ringpose pose for these shots.")
    ] = None,
    tracks: Annotated[
        list[Path] | None, file_option("--tracks", meaning="The output of ringpose track for these poses.")
    ] = None,
    truth: Annotated[Path | None, file_option("--truth", meaning="Show the truth and the errors, too.")] = None,
    points: Annotated[
        Path | None, file_option("--points", meaning="The output of ringpose detect --points: .ply or .npz.")
    ] = None,
    robot_poses: RobotPosesFile = None,
    robot_convention: RobotConvention = None,
    robot_columns: RobotColumns = None,
    html: Annotated[
        Path | None, file_option("--html", meaning="Write the replay as one HTML page.", purpose=OUTPUT)
    ] = None,
    port: PagePort = None,
    channel: ImageChannel = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Show recorded shots in the browser: pictures, poses, tracks, errors, a timeline and a three-dimensional view."""
    from ringpose.console.replay import ReplayCloud, replay_page
    from ringpose.files import atomic
    from ringpose.files.images.shots import SHOT_SUFFIXES, read_shot
    from ringpose.files.inputs import inputs as named
    from ringpose.files.inputs import path_of_input
    from ringpose.files.point_clouds import read_point_cloud
    from ringpose.files.records.poses import pose_line_of
    from ringpose.files.records.tracks import pose_line_of_track
    from ringpose.files.records.truths import read_truths
    from ringpose.files.rigs import read_rig

    if html is not None:
        atomic.reject_existing(html, force)
    elif find_spec("viser") is None:
        raise UsageError("view", "viser is not installed", "pip install 'ringpose[console]', or give --html FILE")
    loaded_rig = read_rig(rig)
    cloud = None if points is None else ReplayCloud(cloud=read_point_cloud(points, MAX_POINTS))
    if cloud is not None and cloud.cloud.thinned_by > 1:
        messages.echo(f"{points}: one point in {cloud.cloud.thinned_by} is shown")
    check_frame(PoseFrame.CAMERA if cloud is None else cloud.cloud.frame, loaded_rig, rig, robot_poses)
    motion = camera_motion(robot_poses, rig, inputs, robot_convention, robot_columns) or _at_rest(loaded_rig)
    place = _place_in_cloud(cloud, motion)
    truths = {} if truth is None else {each.shot: each for each in read_truths(truth)}
    batch = Batch()
    lines = _lines_by_shot(poses or [], loaded_rig, batch, pose_line_of, "pose")
    tracked = _lines_by_shot(tracks or [], loaded_rig, batch, pose_line_of_track, "track")
    if (poses and not lines) or (tracks and not tracked):
        batch.finish()  # nothing is shown without what was to be shown
    shots = []
    for item in with_progress(batch.valid_inputs(named(inputs, SHOT_SUFFIXES)), "shots", quiet):
        with batch.guarded():
            shot = read_shot(path_of_input(item), channel, loaded_rig)
            shown = _replay_shot(shot, loaded_rig, lines.get(shot.name), truths.get(shot.name))
            shots.append(
                replace(
                    shown,
                    track=_in_camera_frame(tracked.get(shot.name), motion),
                    camera_from_cloud=place(shot.name, shot.measured_at_s),
                )
            )
    in_cloud = () if cloud is None or not cloud.by_shot else cloud.cloud.shots
    _check_names(
        (("--poses", lines), ("--tracks", tracked), ("--truth", truths), ("--points", in_cloud)),
        [shot.name for shot in shots],
    )
    if not shots:
        batch.finish()
    elif html is not None:
        with atomic.replacing(html, force) as stream:
            stream.write(
                replay_page(shots, loaded_rig, f"{len(shots)} shots of {inputs[0]}", cloud).encode("utf-8", "replace")
            )
        batch.finish()
    else:
        from ringpose.console.recorded import RecordedPage

        with RecordedPage(shots, loaded_rig, "127.0.0.1", port, cloud) as page:
            announce(page.port, port)
            page.serve()


MAX_POINTS = 30_000
"""Largest number of points that is shown: a browser without a GPU draws them in a tenth of a second."""


def _at_rest(rig: "Rig") -> "CameraMotion | None":
    """The camera by its mount alone, without poses of the robot; None without a mount."""
    from ringpose.geometry.camera_motion import CameraMotion
    from ringpose.types.rig import NO_ROBOT_POSES

    return None if rig.mount is None else CameraMotion(poses=NO_ROBOT_POSES, mount=rig.mount)


def _place_in_cloud(
    cloud: "ReplayCloud | None", motion: "CameraMotion | None"
) -> "Callable[[str, float], Float64[Array, '4 4'] | None]":
    """A function that returns the pose of the cloud's frame in the camera frame of a shot; None if it is not known."""
    import numpy as np

    frame = PoseFrame.CAMERA if cloud is None else cloud.cloud.frame

    def camera_from_cloud(shot: str, stamp_s: float) -> "Float64[Array, '4 4'] | None":
        if cloud is None:
            return None
        if frame is PoseFrame.CAMERA or motion is None:
            return np.eye(4)
        where = motion.in_frame(frame, stamp_s)
        if where is None:
            messages.echo(f"{shot}: is shown without the points: {motion.why_not_at(stamp_s)}")
            return None
        return np.linalg.inv(where[0])

    return camera_from_cloud


def _in_camera_frame(track: "PoseLine | None", motion: "CameraMotion | None") -> "PoseLine | None":
    """A track where the camera sees it at its time; without its ring if the robot's pose is not known then."""
    import numpy as np

    from ringpose.pose.transform import pose_in_frame, velocity_in_frame

    if track is None or track.pose is None or track.frame is PoseFrame.CAMERA:
        return track
    where = None if motion is None else motion.in_frame(track.frame, track.pose_stamp_s)
    if where is None:
        return replace(track, pose=None, velocity=None)
    camera_from_base, velocity = np.linalg.inv(where[0]), track.velocity
    return replace(
        track,
        frame=PoseFrame.CAMERA,
        pose=pose_in_frame(track.pose, camera_from_base),
        velocity=None if velocity is None else velocity_in_frame(velocity, track.pose, camera_from_base),
    )


def _lines_by_shot(
    files: list[Path], rig: "Rig", batch: Batch, line_of: "Callable[[Mapping[str, Any], str], PoseLine]", kind: str
) -> "dict[str, PoseLine]":
    """The line of each shot; invalid ones are reported by the batch."""
    from ringpose.files.inputs import RECORDS_SUFFIX, Record
    from ringpose.files.inputs import inputs as named
    from ringpose.types.rig import reject_other_rig

    lines: dict[str, PoseLine] = {}
    for file in map(str, files):
        for item in batch.valid_inputs(named([file], (RECORDS_SUFFIX,))):
            with batch.guarded():
                if not isinstance(item, Record):
                    if not item.exists():
                        raise NoInputError(file, "does not exist")
                    raise DataError(file, f"holds no {kind} lines", f"give the .jsonl output of ringpose {kind}")
                line = line_of(item.values, item.location)
                reject_other_rig(line.rig, rig.sha256, item.location, "give the rig of the poses")
                if line.shot in lines and kind == "pose":
                    raise DataError(item.location, f"is a second pose line of the shot {line.shot}", "give one run")
                if line.shot:  # a track also has lines of instants without a shot
                    lines[line.shot] = line
    return lines


def _replay_shot(shot: "Shot", rig: "Rig", line: "PoseLine | None", truth: "Truth | None") -> "ReplayShot":
    """The picture of a shot, and the errors of its pose, which must be in the camera frame to be compared."""
    from ringpose.bench.score import estimate_of, score
    from ringpose.console.replay import ReplayShot, replay_picture
    from ringpose.estimate.pose_errors import truth_at
    from ringpose.measure.stream import Setup
    from ringpose.report.overlay import overlay, picture_of

    picture = overlay(picture_of(shot), Setup(rig=rig).detection(shot), line, rig, with_numbers=False)
    errors: Mapping[str, float] = {}
    if line is not None and truth is not None:
        estimate = estimate_of(line, shot.name)
        errors = score(truth, estimate, estimate.method, rig.camera).errors
        truth = truth_at(truth, estimate.stamp_s, line.stamp_s)
    shown = {name: value for name, value in errors.items() if name in SHOWN_ERRORS}
    return ReplayShot(
        name=shot.name, stamp_s=shot.measured_at_s, jpeg=replay_picture(picture), line=line, truth=truth, errors=shown
    )


SHOWN_ERRORS = ("center_m", "normal_rad", "radius_outer_m", "grasp_m")
"""Errors that a replay shows, by their names in `ringpose bench`."""


def _check_names(given: Iterable[tuple[str, Iterable[str]]], shots: list[str]) -> None:
    """Report files that name none of the shots."""
    for option, names in given:
        named = list(names)
        if named and not set(named) & set(shots):
            raise DataError(option, f"names none of the shots; its first is {named[0]}", "give the file of these shots")
