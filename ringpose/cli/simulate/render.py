"""`ringpose simulate`: render shots with ground truth, and calibration views, from a scene."""

from pathlib import Path
from typing import Annotated

import typer

from ringpose.cli.app import Force, Quiet, Verbose, app
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

SceneFile = Annotated[Path, typer.Argument(metavar="SCENE", help="The scene (scene.yaml).")]
OutputFolder = Annotated[
    Path | None,
    typer.Option(
        "--output",
        "-o",
        metavar="DIR",
        help="Folder for rig, shots, truth and calibration views; required without --features.",
    ),
]
Count = Annotated[
    int | None,
    typer.Option("--count", metavar="N", min=1, help="Render only the first N shots, and views of each board."),
]
Seed = Annotated[int | None, typer.Option("--seed", metavar="N", min=0, help="Use this seed instead of the scene's.")]
Jobs = Annotated[
    int,
    typer.Option(
        "--jobs",
        "-j",
        metavar="N",
        min=0,
        help="Processes; 0 is one per core. Shots do not depend on it.",
    ),
]


@app.command()
def simulate(
    scene: SceneFile,
    output: OutputFolder = None,
    count: Count = None,
    seed: Seed = None,
    jobs: Jobs = 0,
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
    from ringpose.files.images.simulations import SimulationFolder
    from ringpose.files.scenes.scene import read_scene
    from ringpose.processes import cores
    from ringpose.simulate.pipeline import simulate as simulated
    from ringpose.simulate.pipeline import simulated_boards

    drawn = (max_speed, max_rate, ring_tolerance, rig_errors, displaced, background, missing)
    if not features and any(value is not None and value is not False for value in drawn):
        raise UsageError("", "motion, errors and outliers are drawn for features only", "give --features too")
    if output is None and not features:
        raise UsageError("", "--output is missing", "give --output DIR")
    read = read_scene(scene)
    seeded = read if seed is None else replace(read, seed=seed)
    if features or output is None:
        deviations = deviations_of(*drawn, moves=read.motion is not None)
        write_features(seeded, scene, deviations, count, output, force=force, quiet=quiet)
        return
    processes = jobs or cores()
    shots = simulated(seeded, count, processes)  # checks the motion before anything is written
    folder = SimulationFolder(output, read.rig, force=force, inputs=[scene])
    truths = []
    for shot, truth in with_progress(shots, "shots", quiet):
        records.write_name(folder.add(shot, truth))
        truths.append(truth)
        if verbose:
            messages.echo(
                f"{shot.name}: {len(shot.images)} frames of {1e3 * shot.exposure_s[0]:.3f} ms, {truth.expect}"
            )
    report_stripes(truths, read.rig, quiet=quiet)
    for name, boards in (("camera", seeded.camera_boards), ("plane", seeded.plane_boards)):
        if boards is not None:
            views = with_progress(simulated_boards(seeded, boards, count, processes), f"{name} board views", quiet)
            folder.add_boards(name, boards.board, views)


app.command("simulate serve")(serve)
app.command("simulate console")(console)
