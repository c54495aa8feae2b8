"""`ringpose detect`: images or shots -> break points."""

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli import messages
from ringpose.cli.app import (
    OUTPUT,
    STDOUT,
    Force,
    ImageChannel,
    Inputs,
    Overlay,
    Quiet,
    Verbose,
    app,
    file_option,
    with_option_groups,
)
from ringpose.cli.batch import Batch, Jobs, with_progress
from ringpose.cli.options.assumptions import Assumed
from ringpose.errors import NO_POSE, UsageError
from ringpose.types.options import SegmentMethod, StripeSource

if TYPE_CHECKING:
    from ringpose.files.inputs import Input
    from ringpose.types.assumptions import AssumptionOptions
    from ringpose.types.detection import BreakPoints, Detection
    from ringpose.types.image import Shot
    from ringpose.types.rig import Rig

OptionalRig = Annotated[
    Path | None,
    file_option("--rig", meaning="The calibrated rig (rig.yaml); required without --segments-only."),
]
Output = Annotated[
    str,
    typer.Option(
        "--output",
        "-o",
        metavar="DIR",
        help="Write one NPZ a shot into this folder; - writes records.",
        rich_help_panel=OUTPUT,
    ),
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
Full = Annotated[
    bool,
    typer.Option(
        "--full", help="Write stripes and segments into records too, as NPZ files do.", rich_help_panel=OUTPUT
    ),
]
Resume = Annotated[
    bool,
    typer.Option(
        "--resume", help="Of --output: leave out shots whose files are there already.", rich_help_panel=OUTPUT
    ),
]


@app.command()
@with_option_groups
def detect(
    *,
    inputs: Inputs,
    rig: OptionalRig = None,
    output: Output = "-",
    overlay: Overlay = None,
    segments_only: SegmentsOnly = False,
    method: MethodName = SegmentMethod.REFINED,
    stripes: StripesFrom = StripeSource.CENTERS,
    track: Track = False,
    assumed: Assumed,
    full: Full = False,
    resume: Resume = False,
    jobs: Jobs = 1,
    channel: ImageChannel = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Find the laser stripes, and where they end on the ring."""
    from ringpose.cli.overlays import OverlayFolder
    from ringpose.files.images.shots import SHOT_SUFFIXES
    from ringpose.files.inputs import inputs as named
    from ringpose.files.records.detections import DetectionSink
    from ringpose.files.rigs import read_rig

    if segments_only and (track or stripes is not StripeSource.CENTERS):
        raise UsageError("--segments-only", "searches no stripes", "leave out --track and --stripes")
    if not segments_only:
        _check_search(rig, method)
    if track and jobs > 1:
        raise UsageError("--jobs", "is of no use with --track", "each shot needs the result of the previous one")
    loaded_rig = None if rig is None else read_rig(rig)
    sink = DetectionSink(output, rig=rig, full=full or segments_only, force=force)
    overlays = None if overlay is None else OverlayFolder(overlay, force=force)
    batch = Batch()
    work = DetectInput(
        rig=loaded_rig,
        channel=channel,
        segments_only=segments_only,
        method=method,
        stripes=stripes,
        track=track,
        options=assumed.options,
    )
    items = named(inputs, SHOT_SUFFIXES)
    detections = batch.results(work, (item for item in items if not (resume and sink.has(item))), jobs)
    with batch:
        for path, shot, detection in with_progress(detections, "shots", quiet):
            with batch.guarded():
                if overlays is not None:  # first, so that all files exist when the detection's name is printed
                    from ringpose.report.overlay import overlay as drawn
                    from ringpose.report.overlay import picture_of

                    overlays.write(shot.name, drawn(picture_of(shot), detection, rig=loaded_rig))
                sink.write(detection, path)
                if verbose:
                    messages.echo(f"{shot.name}: {detection.summary}")
                if not (detection.found or segments_only):
                    batch.record_status(NO_POSE)
    batch.finish()


def _check_search(rig: Path | None, method: SegmentMethod) -> None:
    """Options of a search for break points: a rig, and none of a search for segments."""
    if rig is None:
        raise UsageError("", "--rig is missing", "give --rig FILE, or --segments-only for any image")
    if method is not SegmentMethod.REFINED:
        raise UsageError("--method", "is of use with --segments-only only", "add it, or leave --method out")


def _check_order(track: bool, jobs: int, resume: bool, output: str) -> None:
    """With --track each shot needs the one before; only what is in a folder can be left out."""
    if track and jobs > 1:
        raise UsageError("--jobs", "is of no use with --track", "each shot needs the result of the previous one")
    if resume and (output == STDOUT or track):
        raise UsageError("--resume", "is of use with --output DIR, and not with --track", "leave it out")


@dataclass(slots=True, kw_only=True)
class DetectInput:
    """Reads inputs and searches them; with `track` the search starts near the break points of the previous one."""

    rig: "Rig | None"
    """The rig to which the shots must belong, if it is given."""
    channel: str | None
    segments_only: bool
    """Whether only segments are searched for, by this method; else there must be a rig."""
    method: SegmentMethod
    stripes: StripeSource
    track: bool
    options: "AssumptionOptions"
    previous: "BreakPoints | None" = None

    def __call__(self, item: "Input") -> "tuple[Path, Shot, Detection]":
        """Path, shot and detection of an input."""
        from ringpose.files.images.shots import read_shot
        from ringpose.files.inputs import path_of_input
        from ringpose.types.detection import BreakPoints

        path = path_of_input(item)
        shot = read_shot(path, self.channel, self.rig)
        if self.segments_only or self.rig is None:
            from ringpose.detect.line_segments import segments_only

            return path, shot, segments_only(shot, self.method)
        from ringpose.detect.pipeline import Prior
        from ringpose.detect.pipeline import detect as detected

        assumptions = self.options.about_shot(self.rig.stability, still=shot.still)
        detection = detected(
            shot, self.rig, Prior(predicted=self.previous, assumptions=assumptions), source=self.stripes
        )
        if self.track:
            self.previous = detection.break_points if isinstance(detection.break_points, BreakPoints) else None
        return path, shot, detection
