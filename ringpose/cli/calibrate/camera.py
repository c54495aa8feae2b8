"""`ringpose calibrate-camera`: images of a board -> camera.yaml."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from ringpose.cli.app import app
from ringpose.cli.calibrate.outputs import CommandWithModes, OptionalInputs, OptionalOutput, PrintBoard, given
from ringpose.cli.options.common import BoardFile, Force, ImageChannel, Overlay, Quiet, Report, Verbose
from ringpose.types.options import DistortionModel

if TYPE_CHECKING:
    from ringpose.calibrate.camera.parameters import CameraModel
    from ringpose.cli.calibrate.board_views import BoardImages
    from ringpose.types.calibration import CameraAssessment, CameraCalibration, Verdict


Model = Annotated[DistortionModel, typer.Option("--distortion-model", help="How the lens bends rays.")]
FixK3 = Annotated[bool, typer.Option("--fix-k3", help="Hold k3 at zero: for few views or little distortion.")]
ZeroTangential = Annotated[bool, typer.Option("--zero-tangential", help="Hold p1 and p2 at zero.")]
KeepAll = Annotated[bool, typer.Option("--keep-all", help="Leave out no view and no corner, and let all count alike.")]
Compare = Annotated[bool, typer.Option("--compare", help="Solve with the other distortion model too, and compare.")]
Distances = Annotated[
    str, typer.Option("--distances", metavar="METRES", help="Where the uncertainty is given in mm, comma between.")
]
CameraName = Annotated[str, typer.Option("--camera-name", metavar="NAME", help="The camera's name in the file.")]


@app.command("calibrate-camera", cls=CommandWithModes)
def calibrate_camera(
    board: BoardFile,
    inputs: OptionalInputs = None,
    output: OptionalOutput = None,
    distortion_model: Model = DistortionModel.PLUMB_BOB,
    fix_k3: FixK3 = False,
    zero_tangential: ZeroTangential = False,
    keep_all: KeepAll = False,
    compare: Compare = False,
    distances: Distances = "0.2,0.5,1",
    camera_name: CameraName = "camera",
    print_board: PrintBoard = None,
    overlay: Overlay = None,
    report: Report = None,
    channel: ImageChannel = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Estimate the camera's intrinsic parameters from images of a board.

    Ten to fifteen images are good: the board flat, tilted by 20 to 40 degrees to different sides, near and far, its
    corners in every part of the image. No board yet: --print-board board.pdf --board board.yaml.
    """
    if print_board is not None:
        from ringpose.cli.calibrate.outputs import print_board as printed

        printed(print_board, board, "charuco", force=force, quiet=quiet)
        return

    from ringpose.calibrate.camera.parameters import CameraModel
    from ringpose.cli.batch import Batch
    from ringpose.cli.calibrate.board_views import BoardImages
    from ringpose.cli.calibrate.outputs import refuse_existing_outputs
    from ringpose.files.boards import read_board

    writing = _Writing(given(output, "--output"), report, force, quiet)
    refuse_existing_outputs(writing.output, report, force, [board])
    model = CameraModel(
        distortion_model=distortion_model.value, fix_k3=fix_k3, zero_tangential=zero_tangential, keep_all=keep_all
    )
    asked = _Asked(model, _distances_m(distances), compare, camera_name)
    images = BoardImages(read_board(board), overlay, channel=channel, force=force)
    images.outputs = (writing.output, report)
    batch = Batch()
    images.read_each(given(inputs, "INPUT"), batch, quiet=quiet, verbose=verbose)
    with batch.guarded():
        batch.record_status(_calibrate(images, asked, writing, board))
    batch.finish()


class _Asked(NamedTuple):
    """What is estimated."""

    model: "CameraModel"
    distances_m: list[float]
    compare: bool
    camera_name: str


class _Writing(NamedTuple):
    """What is written of a calibration."""

    output: Path
    report: Path | None
    force: bool
    quiet: bool


def _calibrate(images: "BoardImages", asked: _Asked, writing: _Writing, board: Path) -> int:
    """The exit status that the verdict asks for."""
    from ringpose.calibrate.camera.assessment import camera_assessment, widened
    from ringpose.calibrate.camera.pipeline import calibrate_camera as calibrated
    from ringpose.calibrate.camera.quality import camera_summary, camera_verdict
    from ringpose.cli.calibrate.outputs import say_verdict

    found = calibrated(images.views, images.width, images.height, asked.model, asked.camera_name)
    result = widened(found, camera_assessment(found, images.views, asked.model, asked.distances_m, asked.compare))
    verdict = camera_verdict(*result, len(images.views) + len(images.without_board))
    _write(*result, verdict, images, writing, [board, *images.paths])
    return say_verdict(verdict, camera_summary(*result, verdict), quiet=writing.quiet)


def _write(
    calibration: "CameraCalibration",
    assessment: "CameraAssessment",
    verdict: "Verdict",
    images: "BoardImages",
    writing: _Writing,
    read: list[Path],
) -> None:
    from ringpose.calibrate.camera.quality import camera_quality
    from ringpose.files.cameras.ros import write_camera
    from ringpose.files.io import write_page

    quality = camera_quality(calibration, assessment, verdict, images.without_board)
    write_camera(writing.output, calibration.camera, extra=quality, force=writing.force, inputs=read)
    if writing.report is not None:
        from ringpose.report.camera import camera_report

        page = camera_report(calibration, assessment, verdict, images.without_board)
        write_page(writing.report, page, force=writing.force)


def _distances_m(words: str) -> list[float]:
    from ringpose.errors import UsageError

    try:
        distances_m = [float(word) for word in words.split(",")]
    except ValueError:
        distances_m = []
    if not distances_m or not all(0 < distance_m < 1000 for distance_m in distances_m):
        raise UsageError("--distances", f"{words!r} is not a list of distances", "give metres, as 0.2,0.5,1")
    return distances_m
