"""`ringpose calibrate-camera`: images of a board -> camera.yaml."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from ringpose.cli.app import app
from ringpose.cli.board_print import OptionalInputs, OptionalOutput, PrintBoard, given
from ringpose.cli.options import BoardFile, Force, ImageChannel, Quiet, Report, Verbose


class DistortionModel(StrEnum):
    """A distortion model under its name in ROS."""

    PLUMB_BOB = "plumb_bob"
    RATIONAL_POLYNOMIAL = "rational_polynomial"


Overlay = Annotated[
    Path | None, typer.Option("--overlay", metavar="DIR", help="Draw what was found into PNG files in this folder.")
]
Model = Annotated[DistortionModel, typer.Option("--distortion-model", help="How the lens bends rays.")]
FixK3 = Annotated[bool, typer.Option("--fix-k3", help="Hold k3 at zero: for few views or little distortion.")]
ZeroTangential = Annotated[bool, typer.Option("--zero-tangential", help="Hold p1 and p2 at zero.")]
KeepAll = Annotated[bool, typer.Option("--keep-all", help="Leave out no view and no corner, however far off.")]
Compare = Annotated[bool, typer.Option("--compare", help="Solve with the other distortion model too, and compare.")]
Distances = Annotated[
    str, typer.Option("--distances", metavar="METRES", help="Where the uncertainty is given in mm, comma between.")
]
CameraName = Annotated[str, typer.Option("--camera-name", metavar="NAME", help="The camera's name in the file.")]


@app.command("calibrate-camera")
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
    """Estimate the camera's intrinsic parameters from images of a board."""
    from ringpose.calibrate.camera import calibrate_camera as calibrated
    from ringpose.calibrate.camera_assessment import camera_assessment, widened
    from ringpose.calibrate.camera_model import CameraModel
    from ringpose.calibrate.camera_quality import camera_quality, camera_summary
    from ringpose.calibrate.camera_verdict import camera_verdict
    from ringpose.cli import messages
    from ringpose.cli.batch import Batch
    from ringpose.cli.board_views import BoardImages
    from ringpose.cli.progress import counted
    from ringpose.files.atomic import refuse_existing
    from ringpose.files.boards import read_board
    from ringpose.files.cameras import write_camera
    from ringpose.files.inputs import inputs as named
    from ringpose.files.pages import write_page
    from ringpose.files.shots import SHOT_SUFFIXES
    from ringpose.report.requirement import require_matplotlib

    if print_board is not None:
        from ringpose.cli.board_print import print_board as printed

        printed(print_board, board, "charuco", force=force, quiet=quiet)
        return
    output, shown = given(output, "--output"), given(inputs, "INPUT")
    refuse_existing(output, force)
    if report is not None:
        require_matplotlib()
        refuse_existing(report, force)
    at_m = _distances_m(distances)
    model = CameraModel(
        distortion_model=distortion_model.value, fix_k3=fix_k3, zero_tangential=zero_tangential, keep_all=keep_all
    )
    images = BoardImages(read_board(board), overlay, channel=channel, force=force)
    batch = Batch()
    for item in counted(batch.good(named(shown, SHOT_SUFFIXES)), "images", quiet):
        with batch.item():
            images.read(item)
            if verbose:
                messages.say(images.last)
    batch.met(images.reported())
    found = calibrated(images.views, images.width, images.height, model, camera_name)
    result = widened(found, camera_assessment(found, images.views, model, at_m, compare))
    verdict = camera_verdict(*result, len(images.views) + len(images.without_board))
    quality = camera_quality(*result, verdict, images.without_board)
    write_camera(output, result[0].camera, extra=quality, force=force, inputs=[board, *images.paths])
    if report is not None:
        from ringpose.report.camera_report import camera_report

        write_page(report, camera_report(*result, verdict, images.without_board), force=force)
    if not quiet:
        for line in camera_summary(*result, verdict):
            messages.say(line)
    batch.finish()


def _distances_m(words: str) -> list[float]:
    from ringpose.errors import UsageError

    try:
        distances_m = [float(word) for word in words.split(",")]
    except ValueError:
        distances_m = []
    if not distances_m or not all(0 < distance_m < 1000 for distance_m in distances_m):
        raise UsageError("--distances", f"{words!r} are no distances", "give metres, as 0.2,0.5,1")
    return distances_m
