"""`ringpose detect`: images or shots -> break points."""

from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.app import app
from ringpose.cli.options import Force, ImageChannel, Inputs, OptionalRigFile, Overlay, Quiet, Verbose
from ringpose.types.options import SegmentMethod, StripeSource

if TYPE_CHECKING:
    from ringpose.types.detection import Detection
    from ringpose.types.image import Shot
    from ringpose.types.rig import Rig

Output = Annotated[
    str, typer.Option("--output", "-o", metavar="DIR", help="Write one NPZ a shot into this folder; - writes records.")
]
SegmentsOnly = Annotated[
    bool, typer.Option("--segments-only", help="Find straight segments in any image; no rig is needed.")
]
MethodName = Annotated[
    SegmentMethod, typer.Option("--method", help="Of --segments-only: the paper's length, or refined.")
]
StripesFrom = Annotated[
    StripeSource, typer.Option("--stripes", help="Make stripes from column centers or from the paper's segments.")
]
Track = Annotated[
    bool, typer.Option("--track", help="Look near the stripes of the shot before first, then everywhere.")
]
Full = Annotated[bool, typer.Option("--full", help="Write stripes and segments into records too, as NPZ files do.")]


@app.command()
def detect(
    inputs: Inputs,
    rig: OptionalRigFile = None,
    output: Output = "-",
    overlay: Overlay = None,
    segments_only: SegmentsOnly = False,
    method: MethodName = SegmentMethod.REFINED,
    stripes: StripesFrom = StripeSource.CENTERS,
    track: Track = False,
    full: Full = False,
    channel: ImageChannel = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Find the laser stripes, and where they end on the ring."""
    from ringpose.cli import messages
    from ringpose.cli.batch import Batch
    from ringpose.cli.progress import counted
    from ringpose.errors import NO_POSE, UsageError
    from ringpose.files.detections import DetectionSink
    from ringpose.files.inputs import inputs as named
    from ringpose.files.rigs import read_rig
    from ringpose.files.shots import SHOT_SUFFIXES, read_shot
    from ringpose.files.sources import file_named

    if rig is None and not segments_only:
        raise UsageError("", "--rig is missing", "give --rig FILE, or --segments-only for any image")
    rig_of_shots = None if rig is None else read_rig(rig)
    sink = DetectionSink(output, overlay, rig=rig, full=full or segments_only, force=force)
    batch, last = Batch(), None
    for item in counted(batch.good(named(inputs, SHOT_SUFFIXES)), "shots", quiet):
        with batch.item():
            path = file_named(item)
            shot = read_shot(path, channel, rig_of_shots)
            if segments_only or rig_of_shots is None:
                detection = segments_of(shot, method)
            else:
                detection = detection_of(shot, rig_of_shots, stripes, last)
            last = detection if track and detection.found else None
            sink.write(shot, detection, path)
            if verbose:
                messages.say(f"{shot.name}: {detection.summary}")
            if not (detection.found or segments_only):
                batch.met(NO_POSE)
    batch.finish()


def segments_of(shot: "Shot", method: SegmentMethod) -> "Detection":
    """The straight segments of a shot, and nothing else."""
    from ringpose.detect.line_segments import segments_only

    return segments_only(shot, method)


def detection_of(shot: "Shot", rig: "Rig", source: StripeSource, last: "Detection | None") -> "Detection":
    """What is found in a shot, near what was found last if that is given."""
    from ringpose.detect.pipeline import detect as detected
    from ringpose.types.detection import BreakPoints

    predicted = last.break_points if last is not None and isinstance(last.break_points, BreakPoints) else None
    return detected(shot, rig, source, predicted=predicted)
