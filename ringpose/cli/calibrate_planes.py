"""`ringpose calibrate-planes`: camera and shots of a board with stripes -> rig.yaml."""

from pathlib import Path
from typing import Annotated

import typer

from ringpose.calibrate.planes_method import PlanesMethod
from ringpose.cli.app import app
from ringpose.cli.options import Force, ImageChannel, Inputs, OutputFile, Quiet, Verbose

CameraFile = Annotated[Path, typer.Option("--camera", metavar="FILE", help="The calibrated camera (camera.yaml).")]
BoardFile = Annotated[Path, typer.Option("--board", metavar="FILE", help="The board file: its kind and its sizes.")]
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
Surround = Annotated[
    float, typer.Option("--surround", metavar="METRES", min=0, help="The flat sheet reaches so far beyond the board.")
]
Overlay = Annotated[
    Path | None, typer.Option("--overlay", metavar="DIR", help="Draw what was found into PNG files in this folder.")
]


@app.command("calibrate-planes")
def calibrate_planes(
    inputs: Inputs,
    camera: CameraFile,
    board: BoardFile,
    output: OutputFile,
    method: MethodName = PlanesMethod.JOINT,
    free_camera: FreeCamera = False,
    laser_names: LaserNames = None,
    laser_order: LaserOrder = None,
    surround: Surround = 0.0,
    overlay: Overlay = None,
    channel: ImageChannel = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Estimate the light planes from shots of a board that the stripes cross."""
    from ringpose.calibrate.planes import calibrate_planes as calibrated
    from ringpose.calibrate.planes_quality import calibrated_rig, planes_quality, planes_summary
    from ringpose.cli import messages
    from ringpose.cli.batch import Batch
    from ringpose.cli.board_views import BoardImages
    from ringpose.cli.progress import counted
    from ringpose.cli.stripe_images import StripeImages
    from ringpose.files.atomic import refuse_existing
    from ringpose.files.boards import read_board
    from ringpose.files.cameras import read_camera
    from ringpose.files.inputs import inputs as named
    from ringpose.files.rigs import write_rig
    from ringpose.files.shots import SHOT_SUFFIXES

    refuse_existing(output, force)
    images = BoardImages(read_board(board), overlay, channel=channel, force=force)
    stripes = StripeImages(images, read_camera(camera), laser_names, laser_order, surround)
    batch = Batch()
    for item in counted(batch.good(named(inputs, SHOT_SUFFIXES)), "shots", quiet):
        with batch.item():
            stripes.read(item)
            if verbose:
                messages.say(images.last)
    batch.met(images.reported())
    calibration = calibrated(stripes.views, stripes.camera, stripes.model(method, free_camera))
    rig = calibrated_rig(calibration)
    quality = planes_quality(calibration, images.without_board)
    write_rig(output, rig, extra=quality, force=force, inputs=[camera, board, *images.paths])
    if not quiet:
        for line in planes_summary(calibration):
            messages.say(line)
    batch.finish()
