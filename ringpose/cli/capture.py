"""`ringpose capture`: devices or recordings -> a session folder, its shots' names on stdout."""

from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.app import app
from ringpose.cli.options import ImageChannel, Quiet, Verbose

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ringpose.cli.batch import Batch
    from ringpose.files.sessions import Existing, SessionWriter
    from ringpose.types.frame import Shot

CameraUri = Annotated[
    str, typer.Option("--camera", metavar="URI", help="files:FOLDER, files:PATTERN, files:- or sim:SCENE.yaml.")
]
LasersUri = Annotated[
    str | None,
    typer.Option("--lasers", metavar="URI", help="sim: or none: (always on); what suits the camera if not given."),
]
Steps = Annotated[
    str | None,
    typer.Option("--sequence", metavar="STEPS", help="What is lit, frame by frame: off,1,2,3,off or off,all or 1+2."),
]
Exposure = Annotated[float | None, typer.Option("--exposure", metavar="S", min=1e-9, help="Exposure of each frame.")]
Count = Annotated[int | None, typer.Option("--count", metavar="N", min=1, help="Shots to take, at most.")]
Rate = Annotated[float | None, typer.Option("--rate", metavar="HZ", min=1e-3, help="Shots a second, at most.")]
SessionFolder = Annotated[
    Path | None, typer.Option("--output", "-o", metavar="FOLDER", help="The session; session-<UTC time> if not given.")
]
ReplaceSession = Annotated[bool, typer.Option("--force", help="Replace a session that exists already.")]
Append = Annotated[bool, typer.Option("--append", help="Go on with a session that exists already.")]


@app.command()
def capture(
    camera: CameraUri,
    lasers: LasersUri = None,
    sequence: Steps = None,
    exposure: Exposure = None,
    count: Count = None,
    rate: Rate = None,
    output: SessionFolder = None,
    force: ReplaceSession = False,
    append: Append = False,
    channel: ImageChannel = None,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Take shots into a session folder: one frame for each step of the sequence, all lasers off in the end."""
    from ringpose.cli.batch import Batch
    from ringpose.cli.sources import Wanted, source_of
    from ringpose.errors import UsageError
    from ringpose.files.sessions import SessionWriter, folder_of_now
    from ringpose.types.sequence import parsed_sequence

    steps = None if sequence is None else parsed_sequence(sequence)
    wanted = Wanted(
        camera=camera, lasers=lasers, steps=steps, exposure_s=exposure, count=count, rate_hz=rate, channel=channel
    )
    existing, batch = _existing(force, append), Batch()
    source = source_of(wanted, batch)
    folder = output or folder_of_now()
    if folder.resolve() in source.folders:
        raise UsageError("--output", f"{folder} is where the shots are read from", "choose another folder")
    writer = SessionWriter(folder, source.capture, existing)
    with ExitStack() as stack:
        for part in (writer, *source.devices):
            stack.enter_context(part)
        _write(source.shots(writer.read_from), writer, batch, verbose, quiet)
    batch.finish()


def _existing(force: bool, append: bool) -> "Existing":
    from ringpose.errors import UsageError

    if force and append:
        raise UsageError("", "--force and --append contradict each other", "give one of them")
    if append:
        return "append"
    return "replace" if force else "refuse"


def _write(shots: "Iterator[Shot]", writer: "SessionWriter", batch: "Batch", verbose: bool, quiet: bool) -> None:
    """Every shot as it comes; its name goes out when its file is whole."""
    from ringpose.cli import messages
    from ringpose.cli.progress import counted
    from ringpose.files import records

    for shot in counted(shots, "shots", quiet):
        with batch.item():
            records.write_text(f"{writer.add(shot)}\n")
            if verbose:
                messages.say(f"{shot.name}: {len(shot.lasers)} frames")
