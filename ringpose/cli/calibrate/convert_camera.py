"""`ringpose convert-camera`: a camera file -> the same camera for another program."""

from pathlib import Path
from typing import Annotated

import typer

from ringpose.cli.app import Force, OutputFile, app
from ringpose.types.options import CameraFormat

CameraInput = Annotated[
    Path, typer.Argument(readable=False, metavar="CAMERA", help="A camera or rig, in any of the formats.")
]
Format = Annotated[CameraFormat, typer.Option("--format", help="The program that will read it.")]


@app.command("convert-camera")
def convert_camera(camera: CameraInput, output: OutputFile, form: Format, force: Force = False) -> None:
    """Write a camera in the format of another program, or one of another program as camera.yaml."""
    from ringpose.files.atomic import reject_inputs
    from ringpose.files.cameras.formats import read_camera, write_camera_as

    reject_inputs([output], [camera])
    write_camera_as(output, read_camera(camera), form, camera, force=force)
