"""`ringpose bench study`: simulate, measure and score the shots of a study."""

import sys
from collections.abc import Iterator
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated, Any

import typer

from ringpose.cli.options import Force, Quiet, Report

if TYPE_CHECKING:
    from ringpose.bench.study.executors import Done
    from ringpose.bench.study.table import StudySummary
    from ringpose.files.studies.results import ResultFolder
    from ringpose.files.studies.specification import StudyFile
    from ringpose.report.page import Picture
    from ringpose.types.study import Row, Study

PART_S = (0.5, 10.0)
"""Time after which finished shots are written to a new part file, at first and later: what a killed study loses."""

PART_SHOTS = 5000
"""Number of shots after which they are written earlier."""

LOG_S = 60.0
"""Time between two lines of progress where stderr is not a terminal."""

StudyName = Annotated[str, typer.Argument(metavar="STUDY", help="A study.yaml, or the name of a preset.")]
Output = Annotated[
    Path,
    typer.Option("--output", "-o", readable=False, metavar="DIR", help="Folder of the results; resumed if it exists."),
]
ShotCount = Annotated[
    int | None, typer.Option("--count", metavar="N", min=1, help="Shots of each cell, instead of the study's.")
]
Seed = Annotated[int | None, typer.Option("--seed", metavar="N", min=0, help="Use this seed instead of the study's.")]
Jobs = Annotated[
    int,
    typer.Option("--jobs", "-j", metavar="N", min=0, help="Processes; 0 is one per core. Results do not depend on it."),
]
Scheduler = Annotated[
    str | None, typer.Option("--scheduler", metavar="URI", help="Compute on this dask cluster (tcp://...).")
]
SchedulerFile = Annotated[
    Path | None,
    typer.Option("--scheduler-file", readable=False, metavar="FILE", help="Compute on the dask cluster of this file."),
]
Keep = Annotated[
    str | None, typer.Option("--keep", metavar="worst:N", help="Write the N shots with the largest centre errors.")
]
Wait = Annotated[bool, typer.Option("--wait", help="Wait while another process writes to the folder.")]
Cron = Annotated[bool, typer.Option("--cron", help="Print nothing unless a limit of the study is missed.")]


def study(
    study: StudyName,
    output: Output,
    count: ShotCount = None,
    seed: Seed = None,
    jobs: Jobs = 0,
    scheduler: Scheduler = None,
    scheduler_file: SchedulerFile = None,
    keep: Keep = None,
    report: Report = None,
    wait: Wait = False,
    cron: Cron = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Simulate, measure and score the shots of a study; resumes a study that was interrupted."""
    from ringpose.bench.study.table import exceeded_limits, study_text, summarized
    from ringpose.cli import messages
    from ringpose.cli.batch import Batch
    from ringpose.errors import NO_POSE, UsageError
    from ringpose.files import records
    from ringpose.files.studies.results import opened
    from ringpose.files.studies.specification import read_study, study_path
    from ringpose.types.study import columns

    if scheduler is not None and scheduler_file is not None:
        raise UsageError("--scheduler-file", "excludes --scheduler", "give one of them")
    if scheduler is not None or scheduler_file is not None:
        _require("distributed", "--scheduler", "cluster")
    worst = _worst(keep)
    if report is not None:
        from ringpose.files.atomic import reject_existing
        from ringpose.report.page import require_matplotlib

        require_matplotlib()
        reject_existing(report, force)
    read = read_study(study_path(study), count, seed)
    metadata = _metadata(read)
    batch = Batch()
    with opened(output, metadata, force=force, wait=wait) as folder:
        prepared = _prepared(read.study, output / "calibrated-rig.yaml", jobs)
        missing = _missing(prepared, folder)
        _compute(prepared, folder, missing, jobs, scheduler, scheduler_file, quiet=quiet or cron)
        folder.write_tables(columns(prepared), metadata)
        summary = summarized(prepared, folder.rows())
        exceeded = exceeded_limits(prepared, summary)
        if not cron or exceeded:
            records.write_text(study_text(prepared, summary))
        if worst:
            _write_worst(prepared, folder, worst)
        if report is not None:
            _write_report(prepared, summary, folder, report, metadata, force=force)
    for message in exceeded:
        messages.echo(message)
        batch.record_status(NO_POSE)
    batch.finish()


def _require(module: str, option: str, extra: str) -> None:
    from importlib.util import find_spec

    from ringpose.errors import UsageError

    if find_spec(module) is None:
        raise UsageError(option, f"{module} is not installed", f"pip install 'ringpose[{extra}]'")


def _worst(keep: str | None) -> int:
    """N of `worst:N`."""
    from ringpose.errors import UsageError

    if keep is None:
        return 0
    word, _, number = keep.partition(":")
    if word != "worst" or not number.isdecimal() or not 0 < int(number) <= 1000:
        raise UsageError("--keep", f"is {keep!r}", "give worst:N with N from 1 to 1000")
    return int(number)


def _metadata(read: "StudyFile") -> dict[str, Any]:
    """What identifies the results, and where they come from."""
    import shlex
    from datetime import UTC, datetime

    from ringpose.bench.study.executors import software

    return {
        "ringpose": "study_results/1",
        "title": read.study.title,
        "study_sha256": read.sha256,
        **software(),
        "seed": read.study.seed,
        "count": read.study.count,
        "shots": read.study.shots,
        "level": read.study.level,
        "factors": [factor.name for factor in read.study.factors],
        "methods": [method.value for method in read.study.methods],
        "rig_sha256": read.study.scene.rig.sha256,
        "files": [str(file) for file in read.files],
        "command": shlex.join(["ringpose", *sys.argv[1:]]),
        "started": datetime.now(UTC).isoformat(timespec="seconds"),
    }


def _prepared(study: "Study", rig_file: Path, jobs: int) -> "Study":
    """The study with the rig that measures: if it asks for that, calibrated first, and kept in the folder."""
    from dataclasses import replace

    from ringpose.files.rigs import read_rig, write_rig

    if not study.calibrate:
        return study
    if not rig_file.exists():
        from ringpose.bench.study.calibrated_rig import calibrated_rig
        from ringpose.bench.study.executors import cores

        write_rig(rig_file, calibrated_rig(study.scene, jobs or cores()))
    return replace(study, rig=read_rig(rig_file))


def _missing(study: "Study", folder: "ResultFolder") -> list[int]:
    """Shots that are not finished, in order."""
    done = folder.finished(study.shots)
    return [index for index in range(study.shots) if index not in done]


def _compute(
    study: "Study",
    folder: "ResultFolder",
    missing: list[int],
    jobs: int,
    scheduler: str | None,
    scheduler_file: Path | None,
    *,
    quiet: bool,
) -> None:
    """Compute the missing shots and write them as they are finished; what is finished survives an interrupt."""
    from functools import partial

    from ringpose.bench.study import executors
    from ringpose.bench.study.shots import failed_rows, study_rows

    if not missing:
        return
    work, processes = partial(study_rows, study), jobs or executors.cores()
    done: Iterator[Done]
    if scheduler is not None or scheduler_file is not None:
        done = executors.by_cluster(work, missing, scheduler, None if scheduler_file is None else str(scheduler_file))
    elif processes == 1:
        done = executors.here(work, missing)
    else:
        done = executors.by_processes(work, missing, processes)
    unwritten: dict[int, list[Row]] = {}
    begun_s = last_s = monotonic()
    try:
        for shot in _reported(done, len(missing), study.shots, quiet):
            rows = shot.rows
            unwritten[shot.shot] = failed_rows(study, shot.shot, "killed its worker") if rows is None else rows
            now_s = monotonic()
            due_s = last_s + min(max(PART_S[0], 0.1 * (now_s - begun_s)), PART_S[1])
            if len(unwritten) >= PART_SHOTS or now_s > due_s:
                folder.add(unwritten)
                unwritten, last_s = {}, now_s
    finally:
        if unwritten:
            folder.add(unwritten)


def _reported(done: "Iterator[Done]", missing: int, shots: int, quiet: bool) -> "Iterator[Done]":
    """The shots as they come; progress with rate and time left, on a terminal or as a line a minute."""
    if quiet or sys.stderr is None:
        yield from done
        return
    if sys.stderr.isatty():
        from ringpose.cli.progress import with_total

        yield from with_total(done, "shots", shots, shots - missing)
        return
    from ringpose.cli import messages

    begun_s = last_s = monotonic()
    for number, shot in enumerate(done, start=1):
        yield shot
        now_s = monotonic()
        if now_s - last_s >= LOG_S:
            rate, last_s = number / (now_s - begun_s), now_s
            left_s = (missing - number) / rate
            finished = shots - missing + number
            messages.echo(f"{finished} of {shots} shots, {rate:.3g} shots/s, {left_s / 60:.0f} min left")


OVERLAYS = 4
"""Number of the worst shots whose images are in the report."""


def _write_report(
    study: "Study",
    summary: "StudySummary",
    folder: "ResultFolder",
    report: Path,
    metadata: dict[str, Any],
    *,
    force: bool,
) -> None:
    from ringpose.bench.study.report import study_report
    from ringpose.files.io import write_page

    overlays = list(_overlays(study, folder)) if study.level == "images" else []
    write_page(report, study_report(study, summary, folder.rows, overlays, metadata), force=force)


def _overlays(study: "Study", folder: "ResultFolder") -> "Iterator[Picture]":
    """The shots with the largest errors, computed again, with what was detected in them."""
    import cv2

    from ringpose.bench.study.shots import setting_of, study_shot
    from ringpose.bench.study.table import worst_shots
    from ringpose.detect.pipeline import detect
    from ringpose.report.overlay import overlay, picture_of
    from ringpose.report.page import Picture
    from ringpose.types.image import Shot
    from ringpose.types.study import StudyMethod

    method = (StudyMethod.ML if StudyMethod.ML in study.methods else study.methods[0]).value
    worst = worst_shots(folder.rows(), method, OVERLAYS)
    rows = {row["shot"]: row for row in folder.rows() if row["method"] == method and row["shot"] in worst}
    for index in worst:
        shot = study_shot(study, index, setting_of(study, index))
        if isinstance(shot.source, Shot):
            picture = overlay(picture_of(shot.source), detect(shot.source, shot.scene.rig))
            png = cv2.imencode(".png", cv2.resize(picture, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))[1]
            error, reason = rows[index]["center_m"], rows[index]["reason"]
            found = f"centre error {1e3 * float(error):.3g} mm" if error is not None else f"no pose: {reason}"
            setting = ", ".join(f"{name} {value}" for name, value in shot.setting.items())
            yield Picture(png=png.tobytes(), caption=f"Shot {index} ({method}): {found}; {setting}")


def _write_worst(study: "Study", folder: "ResultFolder", count: int) -> None:
    """The shots with the largest errors, computed again, with their truth: a data set for `ringpose bench`."""
    from ringpose.bench.study.shots import setting_of, study_shot
    from ringpose.bench.study.table import worst_shots
    from ringpose.files.images.simulations import SimulationFolder
    from ringpose.types.image import Shot
    from ringpose.types.study import StudyMethod

    method = StudyMethod.ML if StudyMethod.ML in study.methods else study.methods[0]
    indices = worst_shots(folder.rows(), method.value, count)
    content = "shots" if study.level == "images" else "detections"
    kept = SimulationFolder(
        folder.folder / "worst", study.rig or study.scene.rig, force=True, inputs=[], content=content
    )
    for index in indices:
        shot = study_shot(study, index, setting_of(study, index))
        if isinstance(shot.source, Shot):
            kept.add(shot.source, shot.truth)
        else:
            kept.add_detection(shot.source, shot.truth)
