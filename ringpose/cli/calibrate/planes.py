"""`ringpose calibrate-planes`: camera and shots of a board with stripes -> rig.yaml."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from ringpose.cli.app import app
from ringpose.cli.calibrate.outputs import CommandWithModes, OptionalInputs, OptionalOutput, PrintBoard, given
from ringpose.cli.options import BoardFile, Force, ImageChannel, Overlay, Quiet, Report, Verbose, finite
from ringpose.types.options import PlanesMethod

if TYPE_CHECKING:
    from ringpose.calibrate.planes.quality import PlanesAssessment
    from ringpose.cli.batch import Batch
    from ringpose.cli.calibrate.stripe_images import StripeImages
    from ringpose.types.arrays import Array, Float64
    from ringpose.types.camera import Camera

CameraFile = Annotated[
    Path | None, typer.Option("--camera", readable=False, metavar="FILE", help="The calibrated camera (camera.yaml).")
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
    typer.Option("--mount", readable=False, metavar="FILE", help="Where the camera is mounted: tool_from_camera."),
]
Check = Annotated[
    Path | None,
    typer.Option("--check", readable=False, metavar="RIG", help="Only see whether this rig agrees with the shots."),
]
Surround = Annotated[
    float,
    typer.Option(
        "--surround", metavar="METRES", min=0, callback=finite, help="The flat sheet reaches so far beyond the board."
    ),
]


class _Reading(NamedTuple):
    """How shots are read."""

    board: Path
    names: str | None
    order: str | None
    surround_m: float
    overlay: Path | None
    channel: str | None
    force: bool
    verbose: bool
    quiet: bool


class _Writing(NamedTuple):
    """What is written of a calibration."""

    output: Path
    camera: Path
    mount: Path | None
    report: Path | None
    expected_rad: list[float]
    working_m: float | None


@app.command("calibrate-planes", cls=CommandWithModes)
def calibrate_planes(
    board: BoardFile,
    inputs: OptionalInputs = None,
    camera: CameraFile = None,
    output: OptionalOutput = None,
    method: MethodName = PlanesMethod.JOINT,
    free_camera: FreeCamera = False,
    laser_names: LaserNames = None,
    laser_order: LaserOrder = None,
    expected_angles: ExpectedAngles = None,
    working_distance: WorkingDistance = None,
    mount: Mount = None,
    check: Check = None,
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

        printed(print_board, board, "four_markers", force=force, quiet=quiet)
        return
    shots = given(inputs, "INPUT")
    reading = _Reading(board, laser_names, laser_order, surround, overlay, channel, force, verbose, quiet)
    if check is not None:
        _check(shots, check, reading)
        return
    angles_rad = _angles_rad(expected_angles)
    writing = _Writing(
        given(output, "--output"), given(camera, "--camera"), mount, report, angles_rad, working_distance
    )
    _calibrate(shots, reading, writing, method, free_camera)


def _calibrate(shots: list[str], reading: _Reading, writing: _Writing, method: PlanesMethod, free_camera: bool) -> None:
    from ringpose.calibrate.planes.quality import planes_summary
    from ringpose.cli.batch import Batch
    from ringpose.cli.calibrate.outputs import refuse_existing_outputs, say_verdict
    from ringpose.errors import NO_POSE, DataError
    from ringpose.files.cameras.formats import read_camera
    from ringpose.files.rigs import read_mount

    files = [reading.board, writing.camera, *([writing.mount] if writing.mount else [])]
    refuse_existing_outputs(writing.output, writing.report, reading.force, files)
    tool_from_camera = None if writing.mount is None else read_mount(writing.mount)
    batch = Batch()
    stripes = _stripe_images(reading, read_camera(writing.camera))
    stripes.images.outputs = (writing.output, writing.report)
    stripes.require_method(method, free_camera)
    _read(shots, reading, stripes, batch)
    batch.met(NO_POSE if stripes.without_stripe else 0)
    if not stripes.views and batch.status:
        batch.met(DataError.status)
        batch.finish()
    with batch.item():
        assessment = _assessment(stripes, method, free_camera, writing)
        _say_contradicting(assessment, batch)
        _write(assessment, tool_from_camera, writing, [reading.board, *stripes.images.paths], reading.force)
        if not reading.quiet:
            stripes.say_number()
        batch.met(say_verdict(assessment.verdict, planes_summary(assessment), quiet=reading.quiet))
    batch.finish()


def _say_contradicting(assessment: "PlanesAssessment", batch: "Batch") -> None:
    """The shots that are left out because they contradict the others, as any bad shot."""
    from ringpose.errors import DataError

    for shot, found in assessment.calibration.contradicting:
        with batch.item():
            raise DataError(shot, found)


def _assessment(
    stripes: "StripeImages", method: PlanesMethod, free_camera: bool, writing: _Writing
) -> "PlanesAssessment":
    from ringpose.calibrate.boards.layout import marker_size_findings
    from ringpose.calibrate.planes.acceptance import planes_verdict
    from ringpose.calibrate.planes.pipeline import calibrate_planes as calibrated
    from ringpose.calibrate.planes.quality import PlanesAssessment
    from ringpose.errors import DataError
    from ringpose.types.verdict import Verdict

    model = stripes.model(method, free_camera)
    stripes.require_angles(len(writing.expected_rad))
    board = marker_size_findings([view.board for view in stripes.views])
    try:
        calibration = calibrated(stripes.views, stripes.camera, model)
    except DataError as error:
        stripes.say_remarks()
        remedies = [*Verdict(findings=board).advice, *([error.remedy] if error.remedy else [])]
        raise DataError(error.place, error.found, "; ".join(remedies)) from error
    return PlanesAssessment(
        calibration=calibration,
        verdict=planes_verdict(calibration, writing.expected_rad, board, writing.working_m),
        paper=stripes.by_the_paper(model),
        without_board=stripes.images.without_board,
    )


def _write(
    assessment: "PlanesAssessment",
    tool_from_camera: "Float64[Array, '4 4'] | None",
    writing: _Writing,
    read: list[Path],
    force: bool,
) -> None:
    from dataclasses import replace

    from ringpose.calibrate.planes.quality import calibrated_rig, planes_quality
    from ringpose.files.io import write_page
    from ringpose.files.rigs import write_rig

    rig = replace(calibrated_rig(assessment.calibration), tool_from_camera=tool_from_camera)
    files = [writing.camera, *([writing.mount] if writing.mount else []), *read]
    write_rig(writing.output, rig, extra=planes_quality(assessment), force=force, inputs=files)
    if writing.report is not None:
        from ringpose.report.planes import planes_report

        write_page(writing.report, planes_report(assessment), force=force)


def _check(shots: list[str], rig_file: Path, reading: _Reading) -> None:
    from ringpose.calibrate.planes.check import rig_check, rig_check_lines
    from ringpose.cli import messages
    from ringpose.cli.batch import Batch
    from ringpose.errors import NO_POSE
    from ringpose.files.rigs import read_rig, usual_board_px

    rig, usual_px = read_rig(rig_file), usual_board_px(rig_file)
    batch = Batch()
    stripes = _stripe_images(reading._replace(names=",".join(rig.lasers.names)), rig.camera)
    _read(shots, reading, stripes, batch)
    for view in stripes.views:
        found = rig_check(view, rig, usual_px)
        if not found.holds:
            batch.met(NO_POSE)
        if not (reading.quiet and found.holds):
            for line in rig_check_lines(found):
                messages.say(line)
    batch.finish()


def _stripe_images(reading: _Reading, camera: "Camera") -> "StripeImages":
    """Nothing read yet but the board."""
    from ringpose.cli.calibrate.board_views import BoardImages
    from ringpose.cli.calibrate.stripe_images import StripeImages
    from ringpose.files.boards import read_board

    images = BoardImages(read_board(reading.board), reading.overlay, channel=reading.channel, force=reading.force)
    return StripeImages(images, camera, reading.names, reading.order, reading.surround_m)


def _read(shots: list[str], reading: _Reading, stripes: "StripeImages", batch: "Batch") -> None:
    """The views that the shots show; what they do not show is said."""
    stripes.images.read_each(shots, batch, stripes.read, quiet=reading.quiet, verbose=reading.verbose)


def _angles_rad(words: str | None) -> list[float]:
    from math import radians

    from ringpose.errors import UsageError

    try:
        angles = [float(word) for word in (words or "").split(",") if words]
    except ValueError as error:
        raise UsageError("--expected-angles", f"{words!r} are no angles", "give degrees, as 10,10") from error
    if not all(0 <= angle <= 180 for angle in angles):
        raise UsageError("--expected-angles", f"{words!r} are not all from 0 to 180", "give degrees, as 10,10")
    return [radians(angle) for angle in angles]
