"""`ringpose simulate`: render shots with ground truth, and calibration views, from a scene."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.app import OUTPUT, Force, Quiet, Verbose, app
from ringpose.cli.batch import Jobs
from ringpose.cli.simulate.console import console
from ringpose.cli.simulate.features import (
    Background,
    Displaced,
    Features,
    MaxRate,
    MaxSpeed,
    Missing,
    RigErrors,
    RingTolerance,
)
from ringpose.cli.simulate.serve import serve

if TYPE_CHECKING:
    from ringpose.files.images.simulations import SimulationFolder
    from ringpose.types.scene import Scene

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="The scene (scene.yaml).")]
OutputFolder = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="DIR",
        help="Folder for rig, shots, truth and calibration views; required without --features.",
        rich_help_panel=OUTPUT,
    ),
]
Count = Annotated[
    int | None,
    typer.Option("--count", metavar="N", min=1, help="Render only the first N shots, and views of each board."),
]
Seed = Annotated[int | None, typer.Option("--seed", metavar="N", min=0, help="Use this seed instead of the scene's.")]
Resume = Annotated[
    bool,
    typer.Option(
        "--resume",
        help="Continue an interrupted run of the same scene, seed and version.",
        rich_help_panel=OUTPUT,
    ),
]


@app.command()
def simulate(
    scene: SceneFile,
    output: OutputFolder = None,
    count: Count = None,
    seed: Seed = None,
    jobs: Jobs = 0,
    resume: Resume = False,
    features: Features = False,
    max_speed: MaxSpeed = None,
    max_rate: MaxRate = None,
    ring_tolerance: RingTolerance = None,
    rig_errors: RigErrors = False,
    displaced: Displaced = None,
    background: Background = None,
    missing: Missing = None,
    force: Force = False,
    verbose: Verbose = False,
    quiet: Quiet = False,
) -> None:
    """Simulate shots of a scene, with their ground truth."""
    from dataclasses import replace

    from ringpose.cli import messages
    from ringpose.cli.batch import with_progress
    from ringpose.cli.simulate.features import deviations_of, report_stripes, write_features
    from ringpose.errors import UsageError
    from ringpose.files import records
    from ringpose.files.images.simulations import TRUTH, SimulationFolder, listed
    from ringpose.files.records.truths import read_truths
    from ringpose.files.scenes.scene import read_scene
    from ringpose.simulate.pipeline import simulate as simulated

    drawn = (max_speed, max_rate, ring_tolerance, rig_errors, displaced, background, missing)
    if not features and any(value is not None and value is not False for value in drawn):
        raise UsageError("", "motion, errors and outliers are drawn for features only", "give --features too")
    if output is None and not features:
        raise UsageError("", "--output is missing", "give --output DIR")
    read = read_scene(scene)
    seeded = read if seed is None else replace(read, seed=seed)
    if resume and features:
        raise UsageError("--resume", "is for rendered shots", "leave it out: features are drawn at once")
    if features or output is None:
        deviations = deviations_of(*drawn, moves=read.motion is not None)
        write_features(seeded, scene, deviations, count, output, force=force, quiet=quiet)
        return
    done = listed(output / TRUTH) if resume else []
    begin = max(len(done) - 1, 0)  # the last one is rendered again, and must be the same
    shots = simulated(seeded, count, jobs, begin)  # checks the motion before anything is written
    folder = SimulationFolder(output, read.rig, force=force, inputs=[scene], resume=resume)
    for name in done[:-1]:
        records.write_name(output / "shots" / f"{name}.npz")
    for shot, truth in with_progress(shots, "shots", quiet):
        records.write_name(folder.add(shot, truth))
        if verbose:
            messages.echo(
                f"{shot.name}: {len(shot.images)} frames of {1e3 * shot.exposure_s[0]:.3f} ms, {truth.expect}"
            )
    report_stripes(list(read_truths(output / TRUTH)), read.rig, quiet=quiet)
    _simulate_boards(seeded, folder, count, jobs, quiet=quiet)


def _simulate_boards(scene: "Scene", folder: "SimulationFolder", count: int | None, jobs: int, *, quiet: bool) -> None:
    """Write the calibration views of a scene."""
    from ringpose.cli.batch import with_progress
    from ringpose.simulate.pipeline import simulated_boards

    for name, boards in (("camera", scene.camera_boards), ("plane", scene.plane_boards)):
        if boards is not None:
            views = simulated_boards(scene, boards, count, jobs, folder.begin_boards(name, boards.board))
            folder.add_boards(name, with_progress(views, f"{name} board views", quiet))


app.command("simulate serve")(serve)
app.command("simulate console")(console)
