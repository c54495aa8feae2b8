"""`ringpose calibrate-planes`: camera and shots of a board with stripes -> rig.yaml."""

from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from ringpose.cli.app import app
from ringpose.cli.calibrate.outputs import CommandWithModes, PrintBoard, given
from ringpose.cli.options.common import (
    CalibrationOutput,
    Force,
    ImageChannel,
    OptionalInputs,
    Overlay,
    Quiet,
    Report,
    Verbose,
    file_option,
    finite,
    numbers,
)
from ringpose.types.options import PlanesMethod
from ringpose.types.plausible import EXPECTED_DEG

if TYPE_CHECKING:
    from ringpose.calibrate.planes.shots import StripeShots
    from ringpose.cli.batch import Batch
    from ringpose.cli.calibrate.board_views import BoardImages
    from ringpose.pose.drift import RigEvidence
    from ringpose.types.rig import Camera, Rig

USUAL_DISTANCE_M = 0.5
"""Distance at which motions of planes are given in millimetres where the shots show none."""

BoardFile = Annotated[
    Path | None,
    file_option("--board", meaning="The board file: kind and sizes; required unless a stream is checked (--check)."),
]
CameraFile = Annotated[
    Path | None,
    file_option("--camera", meaning="The calibrated camera (camera.yaml); required without --check and --update."),
]
MethodName = Annotated[PlanesMethod, typer.Option("--method", help="How the light planes are estimated.")]
FreeCamera = Annotated[
    bool, typer.Option("--free-camera", help="Let the boards and stripes improve the camera, from its covariance.")
]
LaserNames = Annotated[
    str | None,
    typer.Option("--laser-names", metavar="NAMES", help="Names by mask bit, comma between, as left,middle,right."),
]
LaserOrder = Annotated[
    str | None,
    typer.Option("--laser-order", metavar="NAMES", help="Order of the stripes down the image, if all lasers are on."),
]
ExpectedAngles = Annotated[
    str | None,
    typer.Option("--expected-angles", metavar="DEGREES", help="Between neighbouring lasers, comma between, as 10,10."),
]
WorkingDistance = Annotated[
    float | None,
    typer.Option(
        "--working-distance",
        metavar="METRES",
        min=0.05,
        callback=finite,
        help="Where rings will be measured: judged there.",
    ),
]
Mount = Annotated[
    Path | None,
    file_option(
        "--mount", meaning="Where the camera is mounted: tool_from_camera, with covariance and delay if known."
    ),
]
Check = Annotated[
    Path | None, file_option("--check", metavar="RIG", meaning="Only see whether this rig agrees with the shots.")
]
Update = Annotated[
    Path | None, file_option("--update", metavar="RIG", meaning="Estimate anew the planes of this rig that moved.")
]
Surround = Annotated[
    float,
    typer.Option(
        "--surround", metavar="METRES", min=0, callback=finite, help="The flat sheet reaches so far beyond the board."
    ),
]


class _Inputs(NamedTuple):
    """Options by which shots are read."""

    board: Path | None
    names: str | None
    order: str | None
    surround_m: float
    overlay: Path | None
    channel: str | None
    force: bool
    verbose: bool
    quiet: bool


@app.command("calibrate-planes", cls=CommandWithModes)
def calibrate_planes(
    board: BoardFile = None,
    inputs: OptionalInputs = None,
    camera: CameraFile = None,
    output: CalibrationOutput = None,
    method: MethodName = PlanesMethod.JOINT,
    free_camera: FreeCamera = False,
    laser_names: LaserNames = None,
    laser_order: LaserOrder = None,
    expected_angles: ExpectedAngles = None,
    working_distance: WorkingDistance = None,
    mount: Mount = None,
    check: Check = None,
    update: Update = None,
    print_board: PrintBoard = None,
    surround: Surround = 0.0,
    overlay: Overlay = None,
    report: Report = None,
    channel: ImageChannel = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Estimate the light planes from shots of a board that the stripes cross.

    Six to ten shots are good, the board nearer and farther, each with a frame for every laser alone, as ringpose
    capture takes them with --sequence off,1,2,3,off. No board yet: --print-board board.pdf --board board.yaml.
    """
    if print_board is not None:
        from ringpose.cli.calibrate.outputs import print_board as printed

        printed(print_board, given(board, "--board"), "four_markers", force=force, quiet=quiet)
        return
    to_compare = ", or the pose records of a stream (.jsonl)" if check is not None or update is not None else ""
    shots = given(inputs, "INPUT", f"give shots of a board and its file (--board){to_compare}")
    options = _Inputs(board, laser_names, laser_order, surround, overlay, channel, force, verbose, quiet)
    if check is not None:
        _check(shots, check, options, None)
        return
    if update is not None:
        _check(shots, update, options, given(output, "--output"))
        return
    angles_deg = numbers(expected_angles, "--expected-angles", "give degrees, as 10,10", EXPECTED_DEG)
    _calibrate(
        shots, options, given(output, "--output"), given(camera, "--camera"), mount, report, method=method,
        free_camera=free_camera, expected_rad=[radians(angle) for angle in angles_deg], working_m=working_distance,
    )  # fmt: skip


def _calibrate(
    shots: list[str], options: _Inputs, output: Path, camera: Path, mount: Path | None, report: Path | None,
    *, method: PlanesMethod, free_camera: bool, expected_rad: list[float], working_m: float | None,
) -> None:  # fmt: skip
    """Estimate the light planes, and write the rig with its mount, and the report."""
    from dataclasses import replace

    from ringpose.calibrate.planes.quality import calibrated_rig, planes_quality, planes_summary
    from ringpose.calibrate.planes.shots import check_method
    from ringpose.cli import messages
    from ringpose.cli.batch import Batch
    from ringpose.cli.calibrate.outputs import reject_existing_outputs, report_verdict
    from ringpose.errors import NO_POSE, DataError
    from ringpose.files.cameras.formats import read_camera
    from ringpose.files.io import write_page
    from ringpose.files.rigs import read_mount, write_rig

    files = [given(options.board, "--board"), camera, *([mount] if mount else [])]
    reject_existing_outputs(output, report, options.force, files)
    mounting = None if mount is None else read_mount(mount)
    batch = Batch()
    images, stripes = _sources(options, read_camera(camera))
    images.outputs = (output, report)
    check_method(method, free_camera, stripes.board, stripes.camera)
    _read(shots, options, images, stripes, batch)
    batch.record_status(NO_POSE if stripes.any_without_stripe else 0)
    if not stripes.views and batch.status:
        batch.record_status(DataError.status)
        batch.finish()
    with batch.guarded():
        try:
            assessment = stripes.assessment(method, free_camera, expected_rad, working_m, images.without_board)
        except DataError:  # what each shot lacks is the reason
            for view in stripes.views:
                for remark in view.remarks:
                    messages.echo(f"{view.board.name}: {remark}")
            raise
        for shot, found in assessment.calibration.contradicting:
            with batch.guarded():
                raise DataError(shot, found)  # reported like any other unusable shot
        rig = replace(calibrated_rig(assessment.calibration), mount=mounting)
        quality = planes_quality(assessment)
        write_rig(output, rig, extra=quality, force=options.force, inputs=[*files, *images.paths])
        if report is not None:
            from ringpose.report.planes import planes_report

            write_page(report, planes_report(assessment), force=options.force)
        _report_lasers(stripes, rig, quiet=options.quiet)
        batch.record_status(report_verdict(assessment.verdict, planes_summary(assessment), quiet=options.quiet))
    batch.finish()


def _report_lasers(stripes: "StripeShots", rig: "Rig", *, quiet: bool) -> None:
    """Report lasers that cannot measure rings, and a small number of lasers if only the masks give it.

    A laser that is missing in the masks may be dark.
    """
    from ringpose.calibrate.planes.stripes.labels import THREE
    from ringpose.cli import messages
    from ringpose.files.rigs import steep_stripes

    for name, finding in zip(rig.lasers.names, steep_stripes(rig.lasers), strict=True):
        if finding:
            messages.echo(f"{name}: {finding}: it cannot measure rings")
    if not quiet and stripes.given_names is None and 0 < len(stripes.names) < len(THREE):
        number = f"{len(stripes.names)} laser{'s' * (len(stripes.names) > 1)}"
        names = ", ".join(stripes.names)
        messages.echo(f"{number} by the shots' masks ({names}); if there are more, name all (--laser-names)")


def _check(inputs: list[str], rig_file: Path, options: _Inputs, output: Path | None) -> None:
    """Compare a rig with shots of a board or the records of a stream; with an output, write the updated rig."""
    from ringpose.calibrate.planes.recheck.update import checked_shots, evidence_lines, moved_lasers
    from ringpose.cli import messages
    from ringpose.cli.batch import Batch
    from ringpose.cli.calibrate.outputs import reject_existing_outputs
    from ringpose.errors import NO_POSE, DataError
    from ringpose.files.rigs import read_rig

    rig = read_rig(rig_file, for_rings=False)
    if output is not None:
        reject_existing_outputs(output, None, options.force, [rig_file])
    batch = Batch()
    boards = options.board is not None
    if boards:
        evidence, files, depth_m = _board_evidence(inputs, rig_file, rig, options, batch, update=output is not None)
    else:
        evidence, files, depth_m = _stream_evidence(inputs, rig, batch, quiet=options.quiet)
    moved: list[int] | None = []
    with batch.guarded():
        if output is not None or not boards:
            checked_shots(evidence, boards=boards)
            moved = moved_lasers(evidence, boards=boards)
            for line in evidence_lines(evidence, moved, depth_m) if moved != [] or not options.quiet else ():
                messages.echo(line)
        if output is None:
            batch.record_status(0 if moved == [] else NO_POSE)
        elif moved is None:
            found = "the shots contradict it, but not by one light plane alone"
            raise DataError(str(rig_file), found, "give shots of a board, or calibrate it again")
        elif moved:
            _write_update(evidence, moved, output, [rig_file, *files], depth_m, options)
        else:
            messages.echo(f"{rig_file}: its light planes hold: nothing to update, {output} is not written")
    batch.finish()


def _board_evidence(
    inputs: list[str], rig_file: Path, rig: "Rig", options: _Inputs, batch: "Batch", *, update: bool
) -> "tuple[RigEvidence, list[Path], float]":
    """Compare each shot of a board with a rig; for an update, return what all shots together show about its planes."""
    import numpy as np

    from ringpose.calibrate.planes.recheck.board_check import rig_check, rig_check_lines
    from ringpose.calibrate.planes.recheck.update import board_evidence
    from ringpose.cli import messages
    from ringpose.errors import NO_POSE
    from ringpose.files.rigs import median_board_rms_px
    from ringpose.pose.drift import RigEvidence

    usual_px = median_board_rms_px(rig_file)
    images, stripes = _sources(options._replace(names=",".join(rig.lasers.names)), rig.camera)
    _read(inputs, options, images, stripes, batch)
    evidence, depths = RigEvidence(rig, rig.stability, left_out=0), []
    for view in stripes.views:
        found = rig_check(view, rig, usual_px)
        if not found.holds and not update:
            batch.record_status(NO_POSE)
        if not (options.quiet and found.holds):
            for line in rig_check_lines(found):
                messages.echo(line)
        if update and found.board_rms_px <= found.board_limit_px:
            evidence.add(board_evidence(view, rig))
            depths.append(found.distance_m)
    return (
        evidence,
        [*([options.board] if options.board else []), *images.paths],
        float(np.median(depths or [USUAL_DISTANCE_M])),
    )


def _stream_evidence(
    inputs: list[str], rig: "Rig", batch: "Batch", *, quiet: bool
) -> "tuple[RigEvidence, list[Path], float]":
    """What the pose records of a stream show about the rig that took it."""
    import numpy as np

    from ringpose.cli import messages
    from ringpose.errors import NO_POSE, UsageError
    from ringpose.files.inputs import RECORDS_SUFFIX, Record, holds_records
    from ringpose.files.inputs import inputs as named
    from ringpose.files.records.poses import pose_line_of
    from ringpose.pose.drift import CONTRADICTORY, RigEvidence, evidence_for_file
    from ringpose.types.rig import reject_other_rig

    evidence, depths, shots, contradictory = RigEvidence(rig, rig.stability), [], 0, 0
    for item in batch.valid_inputs(named(inputs, [RECORDS_SUFFIX])):
        if not isinstance(item, Record):
            raise UsageError(
                "--board", f"is missing: {item} is not a file of pose records", "give --board or FILE.jsonl"
            )
        with batch.guarded():
            line = pose_line_of(item.values, item.location)
            reject_other_rig(line.rig, rig.sha256, item.location, "give the rig by which the stream was measured")
            shots += 1
            contradictory += bool(line.flags & CONTRADICTORY)
            found = evidence_for_file(line)
            if found is not None and evidence.add(found):
                depths.append(float(found.place_m[2]))
    if not quiet:
        messages.echo(f"{shots} shots, {evidence.shots} of them show the light planes at different poses of the ring")
    if contradictory > shots / 2:
        messages.echo(f"{contradictory} of {shots} shots contradict this rig: check the wiring, or calibrate it again")
        batch.record_status(NO_POSE)
    files = [Path(word) for word in inputs if holds_records(Path(word))]
    return evidence, files, float(np.median(depths or [USUAL_DISTANCE_M]))


def _write_update(
    evidence: "RigEvidence", moved: list[int], output: Path, files: list[Path], depth_m: float, options: _Inputs
) -> None:
    """Write the rig updated by the evidence, with the quality of its calibration and a list of the changes."""
    from ringpose.calibrate.planes.recheck.update import change_line, updated_rig
    from ringpose.cli import messages
    from ringpose.files.rigs import calibration_quality, write_rig

    planes = [evidence.moved_plane(laser, moved) for laser in moved]
    names = evidence.rig.lasers.names
    changes = [
        {"laser": names[plane.laser], "change": plane.change, "covariance": plane.covariance, "shots": evidence.shots}
        for plane in planes
    ]
    quality = dict(calibration_quality(files[0]))
    quality["updated"] = [*quality.get("updated", ()), *changes]
    rig = updated_rig(evidence.rig, evidence, moved)
    write_rig(output, rig, extra={"quality": quality}, force=options.force, inputs=files)
    if not options.quiet:
        for plane in planes:
            messages.echo(f"{output}: {change_line(names[plane.laser], plane, depth_m)}")


def _sources(options: _Inputs, camera: "Camera") -> "tuple[BoardImages, StripeShots]":
    from ringpose.calibrate.planes.shots import StripeShots
    from ringpose.cli.calibrate.board_views import BoardImages
    from ringpose.files.boards import read_board

    board = read_board(given(options.board, "--board"))
    images = BoardImages(board, options.overlay, channel=options.channel, force=options.force)
    images.luminance_too = True
    return images, StripeShots(
        images.board, camera, options.names, options.order, options.surround_m, images.find_board
    )


def _read(shots: list[str], options: _Inputs, images: "BoardImages", stripes: "StripeShots", batch: "Batch") -> None:
    """Add the views of all shots to `stripes`; report shots without them."""
    from ringpose.files.images.codecs import write_image
    from ringpose.files.inputs import Input
    from ringpose.report.boards import stripe_overlay

    def read(item: Input) -> None:
        found = images.read(item)
        if found is None:
            return
        shot, board = found
        view = stripes.add(shot, board)
        number = sum(len(px) > 0 for px in (*view.stripes_px, *view.unlabelled_px))
        images.last += f", {number} stripes" + "".join(f"; {remark}" for remark in view.remarks)
        if images.overlay is not None:
            drawn = stripe_overlay(shot.images.max(axis=0), view)
            write_image(images.overlay / f"{shot.name}.png", drawn, force=True)

    images.read_each(shots, batch, read, quiet=options.quiet, verbose=options.verbose)
