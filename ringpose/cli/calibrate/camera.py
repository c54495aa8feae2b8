"""`ringpose calibrate-camera`: images of a board -> camera.yaml."""

from pathlib import Path
from typing import Annotated

import typer

from ringpose.cli.app import (
    CalibrationOutput,
    Force,
    ImageChannel,
    OptionalBoardFile,
    OptionalInputs,
    Overlay,
    Quiet,
    Report,
    Verbose,
    app,
    numbers,
)
from ringpose.cli.calibrate.outputs import CommandWithModes, PrintBoard, given
from ringpose.types.options import DistortionModel
from ringpose.types.plausible import DISTANCE_M

Model = Annotated[DistortionModel, typer.Option("--distortion-model", help="How the lens bends rays.")]
FixK3 = Annotated[bool, typer.Option("--fix-k3", help="Hold k3 at zero: for few views or little distortion.")]
ZeroTangential = Annotated[bool, typer.Option("--zero-tangential", help="Hold p1 and p2 at zero.")]
KeepAll = Annotated[bool, typer.Option("--keep-all", help="Use all views and corners, with equal weights.")]
Compare = Annotated[bool, typer.Option("--compare", help="Solve with the other distortion model too, and compare.")]
Distances = Annotated[
    str, typer.Option("--distances", metavar="METRES", help="Where the uncertainty is given in mm, comma between.")
]
ImageSize = Annotated[
    str | None, typer.Option("--image-size", metavar="WxH", help="Of lists of corners: width and height in pixels.")
]
CameraName = Annotated[str, typer.Option("--camera-name", metavar="NAME", help="The camera's name in the file.")]


@app.command("calibrate-camera", cls=CommandWithModes)
def calibrate_camera(
    board: OptionalBoardFile = None,
    inputs: OptionalInputs = None,
    output: CalibrationOutput = None,
    distortion_model: Model = DistortionModel.PLUMB_BOB,
    fix_k3: FixK3 = False,
    zero_tangential: ZeroTangential = False,
    keep_all: KeepAll = False,
    compare: Compare = False,
    distances: Distances = "0.2,0.5,1",
    camera_name: CameraName = "camera",
    image_size: ImageSize = None,
    print_board: PrintBoard = None,
    overlay: Overlay = None,
    report: Report = None,
    channel: ImageChannel = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Estimate the camera's intrinsic parameters from images of a board, or from lists of its corners.

    Ten to fifteen images are good: the board flat, tilted by 20 to 40 degrees to different sides, near and far, its
    corners in every part of the image. No board yet: --print-board board.pdf --board board.yaml.
    """
    if print_board is not None:
        from ringpose.cli.calibrate.outputs import print_board as printed

        printed(print_board, given(board, "--board"), "charuco", force=force, quiet=quiet)
        return

    from ringpose.calibrate.boards.shots import BoardShots
    from ringpose.calibrate.camera.parameters import CameraModel
    from ringpose.calibrate.camera.pipeline import assessed_camera
    from ringpose.calibrate.camera.quality import camera_quality, camera_summary, camera_verdict
    from ringpose.cli.batch import Batch
    from ringpose.cli.calibrate.board_views import BoardReader, listed_views
    from ringpose.cli.calibrate.outputs import reject_existing_outputs, report_verdict
    from ringpose.errors import UsageError
    from ringpose.files.boards import read_board
    from ringpose.files.cameras.ros import write_camera
    from ringpose.files.corner_lists import is_corner_list
    from ringpose.files.io import write_page

    output = given(output, "--output")
    reject_existing_outputs(output, report, force, [] if board is None else [board])
    model = CameraModel(
        distortion_model=distortion_model.value, fix_k3=fix_k3, zero_tangential=zero_tangential, keep_all=keep_all
    )
    distances_m = numbers(distances, "--distances", "give metres, as 0.2,0.5,1", DISTANCE_M)
    inputs, batch = given(inputs, "INPUT"), Batch()
    read, thumbnails = [] if board is None else [board], {}
    if any(map(is_corner_list, inputs)):
        without = {"--overlay": overlay, "--channel": channel}
        boards = listed_views(inputs, board, image_size, batch, without)
        read += map(Path, inputs)
    else:
        if image_size is not None:
            raise UsageError("--image-size", "is that of lists of corners, and images are given", "leave it out")
        boards = BoardShots(read_board(given(board, "--board")), names_differ=overlay is not None)
        reader = BoardReader(
            boards, overlay=overlay, channel=channel, outputs=(output, report), force=force,
            thumbnails_too=report is not None,
        )  # fmt: skip
        reader.read_each(inputs, batch, quiet=quiet, verbose=verbose)
        read, thumbnails = [*read, *reader.paths], reader.thumbnails
    with batch.guarded():
        assessment = assessed_camera(boards, model, camera_name, distances_m, compare)
        verdict = camera_verdict(assessment, boards.images)
        quality = camera_quality(assessment, verdict, boards.without_board)
        write_camera(output, assessment.calibration.camera, extra=quality, force=force, inputs=read)
        if report is not None:
            from ringpose.report.camera import camera_report

            html = camera_report(assessment, verdict, boards.without_board, thumbnails)
            write_page(report, html, force=force)
        batch.record_status(report_verdict(verdict, camera_summary(assessment, verdict), quiet=quiet))
    batch.finish()
