"""Options of `ringpose simulate --features`: detections drawn from the ring's model, without images."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.app import finite
from ringpose.errors import UsageError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from ringpose.simulate.features import Deviations
    from ringpose.types.rig import Rig
    from ringpose.types.scene import Scene
    from ringpose.types.truth import Truth

OF_FEATURES = "With --features"

Features = Annotated[
    bool, typer.Option("--features", help="Draw detection records from the ring's model; no images are rendered.")
]
MaxSpeed = Annotated[
    float | None,
    typer.Option(
        "--max-speed",
        metavar="M_PER_S",
        min=0,
        callback=finite,
        help="Two standard deviations of the velocity of the ring's centre, per axis.",
        rich_help_panel=OF_FEATURES,
    ),
]
MaxRate = Annotated[
    float | None,
    typer.Option(
        "--max-rate",
        metavar="DEG_PER_S",
        min=0,
        callback=finite,
        help="Two standard deviations of the ring's rates across its normal, per axis.",
        rich_help_panel=OF_FEATURES,
    ),
]
RingTolerance = Annotated[
    float | None,
    typer.Option(
        "--ring-tolerance",
        metavar="M",
        min=0,
        callback=finite,
        help="Standard deviation of the ring's edges and face from circles and a plane.",
        rich_help_panel=OF_FEATURES,
    ),
]
RigErrors = Annotated[
    bool,
    typer.Option(
        "--rig-errors", help="Draw the true rig from the covariance of the scene's.", rich_help_panel=OF_FEATURES
    ),
]
Displaced = Annotated[
    str | None,
    typer.Option(
        "--displaced",
        metavar="SHARE[:PX,PX]",
        help="Share of break points displaced along their stripe, and by how much.",
        rich_help_panel=OF_FEATURES,
    ),
]
Background = Annotated[
    str | None,
    typer.Option(
        "--background",
        metavar="SHARE[:M,M]",
        help="Share of stripes on a surface behind the ring, and its distance.",
        rich_help_panel=OF_FEATURES,
    ),
]
Missing = Annotated[
    float | None,
    typer.Option(
        "--missing",
        metavar="SHARE",
        min=0,
        max=1,
        callback=finite,
        help="Share of missing stripes.",
        rich_help_panel=OF_FEATURES,
    ),
]


def deviations_of(
    max_speed: float | None,
    max_rate: float | None,
    ring_tolerance: float | None,
    rig_errors: bool,
    displaced: str | None,
    background: str | None,
    missing: float | None,
    *,
    moves: bool,
) -> "Deviations":
    """The deviations that the options ask for; velocities are not drawn for a scene whose target `moves`."""
    from ringpose.simulate.features import Deviations
    from ringpose.types.assumptions import motion_prior

    standard = Deviations()
    displaced_share, displaced_px = _share_and_range("--displaced", displaced, standard.displaced_px)
    background_share, background_m = _share_and_range("--background", background, standard.background_m)
    if moves and (max_speed or max_rate):
        option = "--max-speed" if max_speed else "--max-rate"
        raise UsageError(option, "draws velocities, but the scene has a motion", "remove one of them")
    motion = motion_prior(max_speed or 0.0, max_rate or 0.0)
    return Deviations(
        rig_errors=rig_errors,
        motion=motion if max_speed or max_rate else None,
        ring_tolerance_m=ring_tolerance or 0.0,
        displaced_share=displaced_share,
        displaced_px=displaced_px,
        background_share=background_share,
        background_m=background_m,
        missing_share=missing or 0.0,
    )


def write_features(
    scene: "Scene",
    source: Path,
    deviations: "Deviations",
    count: int | None,
    output: Path | None,
    *,
    force: bool,
    quiet: bool,
) -> None:
    """Draw the detections of a scene: records on stdout, or a folder with rig, truth and NPZ files."""
    from ringpose.files import records
    from ringpose.files.images.simulations import SimulationFolder
    from ringpose.files.records.detections import detection_record
    from ringpose.simulate.features import drawn_features

    folder, truths = None, []
    for shot in drawn_features(scene, deviations, count):
        truths.append(shot.truth)
        if output is None:
            records.write(detection_record(shot.detection))
            continue
        folder = folder or SimulationFolder(output, scene.rig, force=force, inputs=[source], content="detections")
        records.write_name(folder.add_detection(shot.detection, shot.truth))
    report_stripes(truths, scene.rig, quiet=quiet)


def report_stripes(truths: "Sequence[Truth]", rig: "Rig", *, quiet: bool) -> None:
    """Report on stderr how many shots show how many stripes of which lasers."""
    from ringpose.cli import messages
    from ringpose.report.stripes import stripes_shown

    if not quiet and (shown := stripes_shown(truths, rig.lasers.names)):
        messages.echo(shown)


def _share_and_range(option: str, text: str | None, usual: tuple[float, float]) -> tuple[float, tuple[float, float]]:
    """Share and range of SHARE[:LEAST,MOST]."""
    if text is None:
        return 0.0, usual
    share, colon, limits = text.partition(":")
    try:
        least, most = map(float, limits.split(",")) if colon else usual
        probability = float(share)
    except ValueError:
        raise UsageError(option, f"is {text!r}", "write it as 0.1 or 0.1:3,15") from None
    if not (0 <= probability <= 1 and 0 <= least <= most < float("inf")):
        raise UsageError(option, f"is {text!r}", "give a share of 0 to 1, and a range of two ascending numbers")
    return probability, (least, most)
