"""`ringpose bench design`: what accuracy a rig allows over its working volume, and which rig is best."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.app import (
    OUTPUT,
    STDOUT,
    CsvFile,
    Force,
    Quiet,
    Report,
    check_plausible,
    check_report,
    file_option,
    number_option,
    numbers,
)
from ringpose.cli.batch import with_progress
from ringpose.cli.options.known_ring import RadiusInner, RadiusOuter
from ringpose.errors import NO_POSE, DataError, UsageError
from ringpose.types import plausible
from ringpose.types.options import Minimized

if TYPE_CHECKING:
    from ringpose.types.scene import Scene

MAX_DESIGNS = 500
"""Maximum number of rigs in a sweep."""

MAX_FACE_SHARE = 0.25
"""Largest width of a face that is not given, as a share of the outer radius: flanges have 0.1 to 0.4."""


QUANTITY = {
    Minimized.CENTER: "center_m",
    Minimized.NORMAL: "normal_rad",
    Minimized.GRASP: "grasp_m",
    Minimized.RADIUS: "radius_outer_m",
    Minimized.CENTER_KNOWN: "center_known_m",
}


def design(
    rig: Annotated[Path, typer.Argument(metavar="RIG", help="The rig (rig.yaml), with the places of its projectors.")],
    scene: Annotated[
        Path | None, file_option("--scene", meaning="Take ring, laser light, lens, sensor and light from this scene.")
    ] = None,
    vary: Annotated[
        list[str] | None,
        typer.Option(
            "--vary",
            metavar="NAME=VALUES",
            help="Values to try of laser_angle_rad, baseline_m, focal_px, dark_noise_e or lasers, separated by commas; "
            "may be given again: all combinations are tried.",
        ),
    ] = None,
    distances: Annotated[
        str, typer.Option("--distances", metavar="METRES", help="Distances of the ring, separated by commas.")
    ] = "0.2,0.3,0.4,0.5,0.7,1.0",
    offsets: Annotated[
        str,
        typer.Option(
            "--offsets",
            metavar="SHARES",
            help="Horizontal offsets from the image centre, in image widths, separated by commas.",
        ),
    ] = "-0.3,-0.15,0,0.15,0.3",
    pitch: Annotated[float, number_option("--pitch", "DEG", "Pitch of the ring.", -60, 60)] = 0.0,
    yaw: Annotated[float, number_option("--yaw", "DEG", "Yaw of the ring.", -60, 60)] = 0.0,
    radius_outer: RadiusOuter = None,
    radius_inner: RadiusInner = None,
    rig_stability: Annotated[
        float, number_option("--rig-stability", "FACTOR", "Scales the rig's usual stability.", 0)
    ] = 1.0,
    minimize: Annotated[
        Minimized, typer.Option("--minimize", help="The quantity by which the best rig is chosen.")
    ] = Minimized.CENTER,
    min_coverage: Annotated[
        float,
        typer.Option(
            "--min-coverage",
            metavar="SHARE",
            min=0,
            max=1,
            help="Smallest share of the places with all stripes in view.",
        ),
    ] = 0.8,
    csv: CsvFile = None,
    output: Annotated[
        Path | None, file_option("--output", "-o", meaning="Write the best rig (rig.yaml).", purpose=OUTPUT)
    ] = None,
    report: Report = None,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Map the accuracy that a rig allows (Cramer-Rao bounds), and find the best of a sweep."""
    from math import radians
    from textwrap import wrap

    from ringpose.bench.design.crossings import crossing_table, crossings, limit_lines
    from ringpose.bench.design.maps import (
        MEDIANS_NOTE,
        best,
        designs,
        median_table,
        place_table,
        places,
        summary_lines,
    )
    from ringpose.files import records
    from ringpose.files.atomic import reject_existing
    from ringpose.files.io import csv_text, write_result
    from ringpose.types.assumptions import TYPICAL_STABILITY

    sweep = _sweep(vary or [])
    where = places(
        sorted(set(numbers(distances, "--distances", "such as 0.3,0.5,1", plausible.DISTANCE_M))),
        sorted(set(numbers(offsets, "--offsets", "such as -0.3,0,0.3", plausible.OFFSET))),
        radians(pitch),
        radians(yaw),
    )
    check_report(report, force)
    if output is not None:
        reject_existing(output, force)
    base = _scene(rig, scene, radius_inner, radius_outer)
    stability = TYPICAL_STABILITY.scaled(rig_stability)
    mapped = list(with_progress(designs(base, sweep, where, stability), "rigs", quiet))
    chosen = best(mapped, QUANTITY[minimize], min_coverage)
    if csv != STDOUT:
        name = "none" if chosen is None else f"{chosen.name},"
        best_line = (
            f"best by {minimize.value}: {name} with all stripes in view at {100 * min_coverage:g} % of the places"
        )
        turned = radians(pitch), radians(yaw)
        at = crossing_table(
            [crossings(base, distance_m, *turned) for distance_m in sorted({w.distance_m for w in where})]
        )
        lines = [
            *median_table(mapped).lines(),
            *wrap(MEDIANS_NOTE, 80),
            "",
            *summary_lines(mapped),
            "",
            *at.lines(),
            *limit_lines(base, *turned),
        ]
        lines += ["", best_line]
        records.write_text("\n".join(lines) + "\n")
    if csv is not None:
        write_result(csv, csv_text(place_table(mapped)), force=force)
    if chosen is not None and output is not None:
        from ringpose.files.rigs import write_rig

        write_rig(output, chosen.rig, force=force, inputs=[rig])
    if report is not None:
        from ringpose.bench.design.report import design_report
        from ringpose.files.io import provenance, write_page

        write_page(
            report, design_report(mapped, chosen, QUANTITY[minimize], min_coverage, provenance([rig])), force=force
        )
    if chosen is None:
        raise typer.Exit(NO_POSE)


def _sweep(words: list[str]) -> dict[str, list[float]]:
    """Names and values of --vary."""
    from math import prod

    varied = {
        "laser_angle_rad": plausible.LASER_ANGLE_RAD,
        "baseline_m": plausible.BASELINE_M,
        "focal_px": plausible.FOCAL_PX,
        "dark_noise_e": plausible.DARK_NOISE_E,
        "lasers": plausible.LASERS,
    }
    sweep: dict[str, list[float]] = {}
    for word in words:
        name, _, values = word.partition("=")
        if name in sweep:
            raise UsageError("--vary", f"{name!r} is given twice", "give all its values in one --vary")
        if name not in varied:
            known = f"give NAME=VALUES, where NAME is one of {', '.join(varied)}"
            raise UsageError("--vary", f"{name!r} cannot be varied", known)
        remedy = f"give {varied[name].unit} separated by commas"
        sweep[name] = sorted(set(numbers(values, f"--vary {name}", remedy, varied[name])))
        if name == "lasers" and any(value != round(value) for value in sweep[name]):
            raise UsageError("--vary lasers", f"{values!r} are not whole numbers")
    number = prod(map(len, sweep.values()))
    if number > MAX_DESIGNS:
        raise UsageError("--vary", f"gives {number} rigs, at most {MAX_DESIGNS} are tried", "give fewer values")
    return sweep


def _scene(rig: Path, scene: Path | None, radius_inner_m: float | None, radius_outer_m: float | None) -> "Scene":
    """The scene with the rig to be judged, and a ring of these radii."""
    from dataclasses import replace

    import numpy as np

    from ringpose.files.rigs import read_rig
    from ringpose.files.scenes.scene import read_scene
    from ringpose.files.studies.specification import PRESETS

    judged, base = read_rig(rig), read_scene(scene or PRESETS / "paper-physical-scene.yaml")
    if np.isnan(judged.lasers.projector_m).any():
        raise DataError(str(rig), "has no positions of the projectors", "add projector_m to each laser")
    count = len(judged.lasers.names)
    sequence = (0, *(1 << laser for laser in range(count)), (1 << count) - 1)
    ring = base.ring
    if radius_outer_m is None and radius_inner_m is not None:
        raise UsageError("--radius-inner", "needs --radius-outer")
    if radius_outer_m is not None and radius_inner_m is None:  # the scene's face, or that of a small flange
        face_m = ring.radius_outer_m - ring.radius_inner_m
        radius_inner_m = radius_outer_m - min(face_m, MAX_FACE_SHARE * radius_outer_m)
    if radius_inner_m is not None and radius_outer_m is not None:
        check_plausible("--radius-inner", radius_inner_m, plausible.RING_RADIUS_M)
        check_plausible("--radius-outer", radius_outer_m, plausible.RING_RADIUS_M)
        if not radius_inner_m < radius_outer_m:
            raise UsageError("--radius-inner", "is not smaller than --radius-outer", "exchange them")
        radii_m = [radius_inner_m, radius_inner_m, radius_outer_m, radius_outer_m]
        profile_m = np.column_stack([radii_m, [0.0, ring.height_m, ring.height_m, 0.0]])
        ring = replace(ring, profile_m=profile_m)
    return replace(base, rig=judged, sequence=sequence, ring=ring)
