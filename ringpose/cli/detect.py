"""`ringpose detect`: images or shots -> break points."""

from collections.abc import Callable
from contextlib import ExitStack
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
from ringpose.cli.options.points import PointOptions
from ringpose.errors import NO_POSE, UsageError
from ringpose.types.options import SegmentMethod, StripeSource

if TYPE_CHECKING:
    from ringpose.files.inputs import Input
    from ringpose.files.records.detections import DetectionSink
    from ringpose.geometry.camera_motion import CameraMotion
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
    space: PointOptions,
    resume: Resume = False,
    jobs: Jobs = 1,
    channel: ImageChannel = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Find the laser stripes, and where they end on the ring, also as points in space."""
    from ringpose.files.images.shots import SHOT_SUFFIXES
    from ringpose.files.inputs import inputs as named
    from ringpose.files.records.detections import DetectionSink
    from ringpose.files.rigs import read_rig

    _check_search(rig, method, segments_only=segments_only, track=track, stripes=stripes)
    _check_order(track, jobs, resume, output)
    space.check(None if segments_only else rig, output, force, resume)
    loaded_rig = None if rig is None else read_rig(rig)
    motion = space.motion(loaded_rig, rig, inputs)
    sha256 = "" if segments_only or loaded_rig is None else loaded_rig.sha256
    sink = DetectionSink(output, rig=rig, rig_sha256=sha256, full=full or segments_only, force=force)
    batch = Batch()
    work = DetectInput(
        rig=loaded_rig,
        channel=channel,
        segments_only=segments_only,
        method=method,
        stripes=stripes,
        track=track,
        options=assumed.options,
        camera=None if motion is None or motion.is_at_rest else motion,
    )
    items = named(inputs, SHOT_SUFFIXES)
    detections = batch.results(work, (item for item in items if not (resume and sink.has(item))), jobs)
    with batch, ExitStack() as stack:
        write_points = space.writer(loaded_rig, rig, motion, assumed.options, batch, stack, force)
        write = _writer(sink if not space.on_stdout else None, overlay, write_points, loaded_rig, force)
        for path, shot, detection in with_progress(detections, "shots", quiet):
            with batch.guarded():
                write(path, shot, detection)
                if verbose:
                    messages.echo(f"{shot.name}: {detection.summary}")
                if not (detection.found or segments_only or space.on_stdout):
                    batch.record_status(NO_POSE)
    batch.finish()


def _writer(
    sink: "DetectionSink | None",
    overlay: Path | None,
    write_points: "Callable[[Shot, Detection], None]",
    rig: "Rig | None",
    force: bool,
) -> "Callable[[Path, Shot, Detection], None]":
    """A function that writes the picture and the points of a shot, and then its record or the name of its file."""
    from ringpose.cli.overlays import OverlayFolder

    overlays = None if overlay is None else OverlayFolder(overlay, force=force)

    def write(path: Path, shot: "Shot", detection: "Detection") -> None:
        if overlays is not None:  # first, so that all files exist when the detection's name is printed
            from ringpose.report.overlay import overlay as drawn
            from ringpose.report.overlay import picture_of

            overlays.write(shot.name, drawn(picture_of(shot), detection, rig=rig))
        write_points(shot, detection)
        if sink is not None:
            sink.write(detection, path)

    return write


def _check_search(
    rig: Path | None, method: SegmentMethod, *, segments_only: bool, track: bool, stripes: StripeSource
) -> None:
    """Options of a search for break points: a rig, and none of a search for segments."""
    if segments_only:
        if track or stripes is not StripeSource.CENTERS:
            raise UsageError("--segments-only", "searches no stripes", "leave out --track and --stripes")
        return
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
    camera: "CameraMotion | None" = None
    """The motion of a camera that a robot carries."""
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
            shot,
            self.rig,
            Prior(predicted=self.previous, assumptions=assumptions, camera=self.camera),
            source=self.stripes,
        )
        if self.track:
            self.previous = detection.break_points if isinstance(detection.break_points, BreakPoints) else None
        return path, shot, detection
