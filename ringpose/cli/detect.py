"""`ringpose detect`: images or shots -> break points."""

from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.app import app
from ringpose.cli.assumption_options import (
    MaxRate,
    MaxSpeed,
    RigStabilityFactor,
    RingTolerance,
    Still,
    assumption_options,
)
from ringpose.cli.options import Force, ImageChannel, Inputs, OptionalRigFile, Overlay, Quiet, Verbose
from ringpose.types.options import SegmentMethod, StripeSource

if TYPE_CHECKING:
    from ringpose.types.arrays import Array, UInt8
    from ringpose.types.assumptions import AssumptionOptions
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
    bool, typer.Option("--track", help="Search near the stripes of the previous shot first, then the whole image.")
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
    still: Still = False,
    max_speed: MaxSpeed = None,
    max_rate: MaxRate = None,
    ring_tolerance: RingTolerance = None,
    rig_stability: RigStabilityFactor = 1.0,
    full: Full = False,
    channel: ImageChannel = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Find the laser stripes, and where they end on the ring."""
    from ringpose.cli import messages
    from ringpose.cli.batch import Batch
    from ringpose.cli.overlays import OverlayFolder
    from ringpose.cli.progress import with_progress
    from ringpose.errors import NO_POSE, UsageError
    from ringpose.files.images.shots import SHOT_SUFFIXES, read_shot
    from ringpose.files.inputs import inputs as named
    from ringpose.files.records.detections import DetectionSink
    from ringpose.files.rigs import read_rig
    from ringpose.files.sources import path_of_input

    if rig is None and not segments_only:
        raise UsageError("", "--rig is missing", "give --rig FILE, or --segments-only for any image")
    options = assumption_options(still, max_speed, max_rate, ring_tolerance, rig_stability)
    loaded_rig = None if rig is None else read_rig(rig)
    sink = DetectionSink(output, rig=rig, full=full or segments_only, force=force)
    overlays = None if overlay is None else OverlayFolder(overlay, force=force)
    batch, previous = Batch(), None
    for item in with_progress(batch.valid_inputs(named(inputs, SHOT_SUFFIXES)), "shots", quiet):
        with batch.guarded():
            path = path_of_input(item)
            shot = read_shot(path, channel, loaded_rig)
            if segments_only or loaded_rig is None:
                detection = segments_of(shot, method)
            else:
                detection = detection_of(shot, loaded_rig, stripes, previous, options)
            previous = detection if track and detection.found else None
            if overlays is not None:  # first, so that all files exist when the detection's name is printed
                overlays.write(shot.name, detection_overlay(shot, detection))
            sink.write(detection, path)
            if verbose:
                messages.echo(f"{shot.name}: {detection.summary}")
            if not (detection.found or segments_only):
                batch.record_status(NO_POSE)
    batch.finish()


def detection_overlay(shot: "Shot", detection: "Detection") -> "UInt8[Array, 'row column 3']":
    """The picture of one shot with its detection."""
    from ringpose.report.overlay import overlay, picture_of  # not needed without --overlay

    return overlay(picture_of(shot), detection)


def segments_of(shot: "Shot", method: SegmentMethod) -> "Detection":
    """The straight line segments of a shot, without stripes or break points."""
    from ringpose.detect.line_segments import segments_only

    return segments_only(shot, method)


def detection_of(
    shot: "Shot", rig: "Rig", source: StripeSource, previous: "Detection | None", options: "AssumptionOptions"
) -> "Detection":
    """The detection in a shot; the search starts near the break points of the previous detection if it is given."""
    from ringpose.detect.pipeline import detect as detected
    from ringpose.types.detection import BreakPoints

    points = None if previous is None else previous.break_points
    predicted = points if isinstance(points, BreakPoints) else None
    assumptions = options.about_shot(rig.stability, still=shot.still)
    return detected(shot, rig, source, predicted=predicted, assumptions=assumptions)
