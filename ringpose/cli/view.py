"""`ringpose view`: a replay of recorded shots with their poses and their truth."""

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.app import app
from ringpose.cli.options import Force, ImageChannel, Inputs, Quiet, RigFile
from ringpose.errors import UsageError

if TYPE_CHECKING:
    from ringpose.cli.batch import Batch
    from ringpose.report.replay import ReplayShot
    from ringpose.types.image import Shot
    from ringpose.types.pose import PoseLine
    from ringpose.types.rig import Rig
    from ringpose.types.truth import Truth

Poses = Annotated[
    list[Path] | None,
    typer.Option("--poses", readable=False, metavar="FILE", help="The output of ringpose pose for these shots."),
]
TruthFile = Annotated[
    Path | None, typer.Option("--truth", readable=False, metavar="FILE", help="Show the truth and the errors, too.")
]
HtmlFile = Annotated[
    Path | None, typer.Option("--html", readable=False, metavar="FILE", help="Write the replay as one HTML page.")
]


@app.command()
def view(
    inputs: Inputs,
    rig: RigFile,
    poses: Poses = None,
    truth: TruthFile = None,
    html: HtmlFile = None,
    channel: ImageChannel = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Make a replay of recorded shots: pictures, poses, errors, a timeline and a three-dimensional view."""
    from ringpose.cli.batch import Batch
    from ringpose.cli.progress import with_progress
    from ringpose.files import atomic
    from ringpose.files.images.shots import SHOT_SUFFIXES, read_shot
    from ringpose.files.inputs import inputs as named
    from ringpose.files.records.truths import read_truths
    from ringpose.files.rigs import read_rig
    from ringpose.files.sources import path_of_input
    from ringpose.report.replay import replay_page

    if html is None:
        raise UsageError("--html", "is missing", "give --html FILE")
    atomic.reject_existing(html, force)
    loaded_rig = read_rig(rig)
    truths = {} if truth is None else {each.shot: each for each in read_truths(truth)}
    batch = Batch()
    lines = _pose_lines(poses or [], batch)
    shots = []
    for item in with_progress(batch.valid_inputs(named(inputs, SHOT_SUFFIXES)), "shots", quiet):
        with batch.guarded():
            shot = read_shot(path_of_input(item), channel, loaded_rig)
            shots.append(_replay_shot(shot, loaded_rig, lines.get(shot.name), truths.get(shot.name)))
    _check_names((("--poses", lines), ("--truth", truths)), [shot.name for shot in shots])
    if not shots:
        batch.finish()
    title = f"{len(shots)} shots of {inputs[0]}"
    page = replay_page(shots, loaded_rig, title)
    with atomic.replacing(html, force) as stream:
        stream.write(page.encode())
    batch.finish()


def _pose_lines(files: list[Path], batch: "Batch") -> "dict[str, PoseLine]":
    """The pose line of each shot; invalid ones are reported by the batch."""
    from ringpose.errors import DataError, NoInputError
    from ringpose.files.inputs import RECORDS_SUFFIX, Record
    from ringpose.files.inputs import inputs as named
    from ringpose.files.poses import pose_line_of

    lines: dict[str, PoseLine] = {}
    for item in batch.valid_inputs(named(list(map(str, files)), (RECORDS_SUFFIX,))):
        with batch.guarded():
            if not isinstance(item, Record):
                if not item.exists():
                    raise NoInputError(str(item), "does not exist")
                raise DataError(str(item), "holds no pose lines", "give the .jsonl output of ringpose pose")
            line = pose_line_of(item.values, item.location)
            if line.shot in lines:
                raise DataError(item.location, f"is a second pose line of the shot {line.shot}", "give one run")
            lines[line.shot] = line
    return lines


def _replay_shot(shot: "Shot", rig: "Rig", line: "PoseLine | None", truth: "Truth | None") -> "ReplayShot":
    """The picture of a shot, and the errors of its pose, which must be in the camera frame to be compared."""
    from ringpose.bench.score import estimate_of, score
    from ringpose.detect.pipeline import detect
    from ringpose.estimate.pose_errors import truth_at
    from ringpose.report.overlay import overlay, picture_of
    from ringpose.report.replay import ReplayShot, replay_picture

    picture = overlay(picture_of(shot), detect(shot, rig), line, rig)
    errors = {}
    if line is not None and truth is not None:
        estimate = estimate_of(line, shot.name)
        truth_now = truth_at(truth, estimate.stamp_s, estimate.shot_stamp_s)
        errors = {
            name: value
            for name, value in score(truth, estimate, estimate.method, rig.camera).errors.items()
            if name in SHOWN_ERRORS
        }
        truth = truth_now
    return ReplayShot(
        name=shot.name, stamp_s=shot.measured_at_s, jpeg=replay_picture(picture), line=line, truth=truth, errors=errors
    )


SHOWN_ERRORS = ("center_m", "normal_rad", "radius_outer_m", "grasp_m")
"""Errors that a replay shows, by their names in `ringpose bench`."""


def _check_names(given: Iterable[tuple[str, Iterable[str]]], shots: list[str]) -> None:
    """Report files that name none of the shots."""
    from ringpose.errors import DataError

    for option, names in given:
        named = list(names)
        if named and not set(named) & set(shots):
            raise DataError(option, f"names none of the shots; its first is {named[0]}", "give the file of these shots")
