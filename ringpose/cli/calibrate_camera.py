"""`ringpose calibrate-camera`: images of a board -> camera.yaml."""

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from ringpose.cli.app import app
from ringpose.cli.options import Force, ImageChannel, Inputs, OutputFile, Quiet, Verbose


class DistortionModel(StrEnum):
    """A distortion model under its name in ROS."""

    PLUMB_BOB = "plumb_bob"
    RATIONAL_POLYNOMIAL = "rational_polynomial"


BoardFile = Annotated[Path, typer.Option("--board", metavar="FILE", help="The board file: its kind and its sizes.")]
Overlay = Annotated[
    Path | None, typer.Option("--overlay", metavar="DIR", help="Draw what was found into PNG files in this folder.")
]
Model = Annotated[DistortionModel, typer.Option("--distortion-model", help="How the lens bends rays.")]
FixK3 = Annotated[bool, typer.Option("--fix-k3", help="Hold k3 at zero: for few views or little distortion.")]
ZeroTangential = Annotated[bool, typer.Option("--zero-tangential", help="Hold p1 and p2 at zero.")]
KeepAll = Annotated[bool, typer.Option("--keep-all", help="Reject no view, however far it lies from the others.")]
CameraName = Annotated[str, typer.Option("--camera-name", metavar="NAME", help="The camera's name in the file.")]


@app.command("calibrate-camera")
def calibrate_camera(
    inputs: Inputs,
    board: BoardFile,
    output: OutputFile,
    distortion_model: Model = DistortionModel.PLUMB_BOB,
    fix_k3: FixK3 = False,
    zero_tangential: ZeroTangential = False,
    keep_all: KeepAll = False,
    camera_name: CameraName = "camera",
    overlay: Overlay = None,
    channel: ImageChannel = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Estimate the camera's intrinsic parameters from images of a board."""
    from ringpose.calibrate.camera import CameraModel
    from ringpose.calibrate.camera import calibrate_camera as calibrated
    from ringpose.calibrate.camera_quality import camera_quality, camera_summary
    from ringpose.cli import messages
    from ringpose.cli.batch import Batch
    from ringpose.cli.board_views import BoardImages
    from ringpose.cli.progress import counted
    from ringpose.files.atomic import refuse_existing
    from ringpose.files.boards import read_board
    from ringpose.files.cameras import write_camera
    from ringpose.files.inputs import inputs as named
    from ringpose.files.shots import SHOT_SUFFIXES

    refuse_existing(output, force)
    model = CameraModel(
        distortion_model=distortion_model.value, fix_k3=fix_k3, zero_tangential=zero_tangential, keep_all=keep_all
    )
    images = BoardImages(read_board(board), overlay, channel=channel, force=force)
    batch = Batch()
    for item in counted(batch.good(named(inputs, SHOT_SUFFIXES)), "images", quiet):
        with batch.item():
            images.read(item)
            if verbose:
                messages.say(images.last)
    batch.met(images.reported())
    calibration = calibrated(images.views, images.width, images.height, model, camera_name)
    quality = camera_quality(calibration, images.without_board)
    write_camera(output, calibration.camera, extra=quality, force=force, inputs=[board, *images.paths])
    if not quiet:
        for line in camera_summary(calibration):
            messages.say(line)
    batch.finish()
