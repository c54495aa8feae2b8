"""`ringpose calibrate-planes`: camera and shots of a board with stripes -> rig.yaml."""

from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from ringpose.cli.app import (
    CalibrationOutput,
    Force,
    ImageChannel,
    OptionalInputs,
    Overlay,
    Quiet,
    Report,
    Verbose,
    app,
    file_option,
    finite,
    numbers,
)
from ringpose.cli.calibrate.outputs import (
    LASERS,
    CommandWithModes,
    LaserNames,
    LaserOrder,
    PrintBoard,
    given,
    session_names,
)
from ringpose.types.options import PlanesMethod
from ringpose.types.plausible import EXPECTED_DEG

if TYPE_CHECKING:
    from ringpose.calibrate.planes.pipeline import StripeShots
    from ringpose.calibrate.planes.recheck.update import BoardRecheck, RigRecheck, StreamRecheck
    from ringpose.cli.batch import Batch
    from ringpose.cli.calibrate.board_views import BoardReader
    from ringpose.types.board import BoardView
    from ringpose.types.image import Shot
    from ringpose.types.rig import Camera, Rig


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
ExpectedAngles = Annotated[
    str | None,
    typer.Option(
        "--expected-angles",
        metavar="DEGREES",
        help="Between neighbouring lasers, comma between, as 10,10.",
        rich_help_panel=LASERS,
    ),
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
        "--mount",
        meaning="Where the camera is mounted: tool_from_camera or base_from_camera, covariance, delay.",
    ),
]
Check = Annotated[
    Path | None, file_option("--check", metavar="RIG", meaning="Only see whether this rig agrees with the shots.")
]
Update = Annotated[
    Path | None, file_option("--update", metavar="RIG", meaning="Estimate anew the planes of this rig that moved.")
]
Surround = Annotated[
    float | None,
    typer.Option(
        "--surround",
        metavar="METRES",
        min=0,
        callback=finite,
        help="The flat sheet reaches so far beyond the print, if not as far as the image shows it.",
    ),
]


class _Inputs(NamedTuple):
    """Options by which shots are read."""

    board: Path | None
    names: str | None
    order: str | None
    surround_m: float | None
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
    surround: Surround = None,
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
        _recheck(shots, check, options, None)
        return
    if update is not None:
        _recheck(shots, update, options, given(output, "--output"))
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

    from ringpose.calibrate.planes.pipeline import check_method
    from ringpose.calibrate.planes.quality import calibrated_rig, planes_quality, planes_summary
    from ringpose.cli import messages
    from ringpose.cli.batch import Batch
    from ringpose.cli.calibrate.outputs import reject_existing_outputs, report_verdict
    from ringpose.errors import DataError
    from ringpose.files.cameras.formats import read_camera
    from ringpose.files.io import write_page
    from ringpose.files.rigs import read_mount, write_rig

    files = [given(options.board, "--board"), camera, *([mount] if mount else [])]
    reject_existing_outputs(output, report, options.force, files)
    mounting = None if mount is None else read_mount(mount)
    batch = Batch()
    stripes = _stripe_shots(options._replace(names=options.names or session_names(shots)), read_camera(camera))
    check_method(method, free_camera, stripes.boards.board, stripes.camera)
    reader = _read_shots(shots, stripes, options, batch, (output, report))
    if not stripes.views and (batch.status or stripes.boards.without_board):
        batch.record_status(DataError.status)
        batch.finish()
    with batch.guarded():
        try:
            assessment = stripes.assessment(method, free_camera, expected_rad, working_m)
        except DataError:  # what each shot lacks is the reason
            for view in stripes.views:
                for remark in view.remarks:
                    messages.echo(f"{view.board.name}: {remark}")
            raise
        for shot, finding in assessment.calibration.contradicting:
            with batch.guarded():
                raise DataError(shot, finding)  # reported like any other unusable shot
        rig = replace(calibrated_rig(assessment.calibration), mount=mounting)
        quality = planes_quality(assessment)
        write_rig(output, rig, extra=quality, force=options.force, inputs=[*files, *reader.paths])
        if report is not None:
            from ringpose.report.planes import planes_report

            write_page(report, planes_report(assessment, stripes.views, reader.thumbnails), force=options.force)
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

    for name, finding in zip(rig.lasers.names, steep_stripes(rig), strict=True):
        if finding:
            messages.echo(f"{name}: {finding}: it cannot measure rings")
    if not quiet and stripes.given_names is None and 0 < len(stripes.names) < len(THREE):
        number = f"{len(stripes.names)} laser{'s' * (len(stripes.names) > 1)}"
        names = ", ".join(stripes.names)
        messages.echo(f"{number} by the shots' masks ({names}); if there are more, name all (--laser-names)")


def _recheck(inputs: list[str], rig_file: Path, options: _Inputs, output: Path | None) -> None:
    """Compare a rig with shots of a board or the records of a stream; with an output, write the updated rig."""
    from ringpose.calibrate.planes.recheck.update import BoardRecheck, StreamRecheck
    from ringpose.cli import messages
    from ringpose.cli.batch import Batch
    from ringpose.cli.calibrate.outputs import reject_existing_outputs
    from ringpose.errors import NO_POSE
    from ringpose.files.rigs import median_board_rms_px, read_rig

    rig = read_rig(rig_file, for_rings=False)
    if output is not None:
        reject_existing_outputs(output, None, options.force, [rig_file])
    batch = Batch()
    recheck: RigRecheck
    if options.board is not None:
        recheck = BoardRecheck(rig, median_board_rms_px(rig_file))
        files = _read_views(inputs, recheck, options, batch)
    else:
        recheck = StreamRecheck(rig)
        files = _read_lines(inputs, recheck, batch)
    for line in recheck.summary(good_too=not options.quiet):
        messages.echo(line)
    if recheck.contradicted and (output is None or options.board is None):
        batch.record_status(NO_POSE)
    if output is not None or options.board is None:  # else each view of a board has been judged by itself
        with batch.guarded():
            batch.record_status(_judge_planes(recheck, output, [rig_file, *files], options))
    batch.finish()


def _judge_planes(recheck: "RigRecheck", output: Path | None, files: list[Path], options: _Inputs) -> int:
    """Report which light planes have moved, and with an output update them; the exit status is returned."""
    from ringpose.cli import messages
    from ringpose.errors import NO_POSE, DataError

    moved = recheck.moved_lasers()
    for line in recheck.evidence_lines(moved) if moved != [] or not options.quiet else ():
        messages.echo(line)
    if output is None:
        return 0 if moved == [] else NO_POSE
    if moved is None:
        finding = "the shots contradict it, but not by one light plane alone"
        raise DataError(str(files[0]), finding, "give shots of a board, or calibrate it again")
    if moved:
        _write_update(recheck, moved, output, files, options)
    else:
        messages.echo(f"{files[0]}: its light planes hold: nothing to update, {output} is not written")
    return 0


def _read_views(inputs: list[str], recheck: "BoardRecheck", options: _Inputs, batch: "Batch") -> list[Path]:
    """Add the views of all board shots; the files read are returned."""
    from ringpose.errors import NO_POSE

    rig = recheck.rig
    stripes = _stripe_shots(options._replace(names=",".join(rig.lasers.names)), rig.camera)
    paths = _read_shots(inputs, stripes, options, batch).paths
    batch.record_status(NO_POSE if stripes.boards.without_board else 0)  # it is not known whether the rig holds there
    for view in stripes.views:
        recheck.add(view)
    return [given(options.board, "--board"), *paths]


def _read_lines(inputs: list[str], recheck: "StreamRecheck", batch: "Batch") -> list[Path]:
    """Add the pose records of all inputs; the files among these are returned."""
    from ringpose.errors import UsageError
    from ringpose.files.inputs import RECORDS_SUFFIX, Record, holds_records
    from ringpose.files.inputs import inputs as named
    from ringpose.files.records.poses import pose_line_of
    from ringpose.types.rig import reject_other_rig

    for item in batch.valid_inputs(named(inputs, [RECORDS_SUFFIX])):
        if not isinstance(item, Record):
            raise UsageError(
                "--board", f"is missing: {item} is not a file of pose records", "give --board or FILE.jsonl"
            )
        with batch.guarded():
            line = pose_line_of(item.values, item.location)
            remedy = "give the rig by which the stream was measured"
            reject_other_rig(line.rig, recheck.rig.sha256, item.location, remedy)
            recheck.add(line)
    return [Path(word) for word in inputs if holds_records(Path(word))]


def _write_update(recheck: "RigRecheck", moved: list[int], output: Path, files: list[Path], options: _Inputs) -> None:
    """Write the rig updated by the evidence, with the quality of its calibration and a list of the changes."""
    from ringpose.cli import messages
    from ringpose.files.rigs import calibration_quality, write_rig

    quality = dict(calibration_quality(files[0]))
    quality["updated"] = [*quality.get("updated", ()), *recheck.changes(moved)]
    write_rig(output, recheck.updated_rig(moved), extra={"quality": quality}, force=options.force, inputs=files)
    if not options.quiet:
        for line in recheck.change_lines(moved):
            messages.echo(f"{output}: {line}")


def _stripe_shots(options: _Inputs, camera: "Camera") -> "StripeShots":
    from ringpose.calibrate.boards.shots import BoardShots
    from ringpose.calibrate.planes.pipeline import StripeShots
    from ringpose.files.boards import read_board

    boards = BoardShots(read_board(given(options.board, "--board")), names_differ=options.overlay is not None)
    return StripeShots(boards, camera, options.names, options.order, options.surround_m)


def _read_shots(
    inputs: list[str],
    stripes: "StripeShots",
    options: _Inputs,
    batch: "Batch",
    outputs: tuple[Path | None, Path | None] = (None, None),
) -> "BoardReader":
    """Add the views of all shots, report shots without board, and draw the overlays; `outputs` are rig and report."""
    from ringpose.cli.calibrate.board_views import BoardReader
    from ringpose.files.images.codecs import write_image
    from ringpose.report.boards import stripe_overlay

    def add(shot: "Shot", board: "BoardView") -> str:
        view = stripes.add(shot, board)
        if options.overlay is not None:
            drawn = stripe_overlay(shot.images.max(axis=0), view)
            write_image(options.overlay / f"{shot.name}.png", drawn, force=True)
        number = sum(len(px) > 0 for px in (*view.stripes_px, *view.unlabelled_px))
        return "; ".join([f"{len(board.ids)} corners, {number} stripes", *view.remarks])

    reader = BoardReader(
        stripes.boards, overlay=options.overlay, channel=options.channel, luminance_too=True, outputs=outputs,
        force=options.force, thumbnails_too=outputs[1] is not None,
    )  # fmt: skip
    reader.read_each(inputs, batch, add, quiet=options.quiet, verbose=options.verbose)
    return reader
