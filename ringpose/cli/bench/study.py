"""`ringpose bench study`: simulate, measure and score the shots of a study."""

import shlex
import sys
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli import messages
from ringpose.cli.app import OUTPUT, Force, Quiet, Report, check_report, file_option
from ringpose.cli.batch import Batch, Jobs, with_total
from ringpose.cli.bench.score import Cron, report_missed
from ringpose.errors import UsageError

if TYPE_CHECKING:
    from ringpose.bench.study.executors import Done

LOG_S = 60.0
"""Time between two lines of progress where stderr is not a terminal."""


def study(
    study: Annotated[
        str,
        typer.Argument(
            metavar="STUDY",
            help="A study.yaml, or a preset: "
            "paper-synthetic, paper-lights, calibrated, tumbling, capture, capture-lights, violations, outliers, "
            "integrity, dirt, sizes, sizes-rendered.",
        ),
    ],
    output: Annotated[
        Path,
        file_option(
            "--output", "-o", meaning="Folder of the results; resumed if it exists.", metavar="DIR", purpose=OUTPUT
        ),
    ],
    count: Annotated[
        int | None,
        typer.Option(
            "--count", metavar="N", min=1, help="Number of shots in each cell of the grid, instead of the study's."
        ),
    ] = None,
    seed: Annotated[
        int | None, typer.Option("--seed", metavar="N", min=0, help="Use this seed instead of the study's.")
    ] = None,
    jobs: Jobs = 0,
    scheduler: Annotated[
        str | None, typer.Option("--scheduler", metavar="URI", help="Compute on this dask cluster (tcp://...).")
    ] = None,
    scheduler_file: Annotated[
        Path | None, file_option("--scheduler-file", meaning="Compute on the dask cluster of this file.")
    ] = None,
    keep: Annotated[
        str | None, typer.Option("--keep", metavar="worst:N", help="Write the N shots with the largest centre errors.")
    ] = None,
    report: Report = None,
    wait: Annotated[bool, typer.Option("--wait", help="Wait while another process writes to the folder.")] = False,
    cron: Cron = False,
    force: Force = False,
    quiet: Quiet = False,
) -> None:
    """Simulate, measure and score the shots of a study; resumes a study that was interrupted."""
    from ringpose.bench.study import pipeline
    from ringpose.bench.study.table import exceeded_limits, study_text, summarized
    from ringpose.files import records
    from ringpose.files.studies.results import opened
    from ringpose.files.studies.specification import read_study, study_path
    from ringpose.types.study import columns

    if scheduler is not None and scheduler_file is not None:
        raise UsageError("--scheduler-file", "excludes --scheduler", "give one of them")
    if (scheduler is not None or scheduler_file is not None) and find_spec("distributed") is None:
        raise UsageError("--scheduler", "distributed is not installed", "pip install 'ringpose[cluster]'")
    worst = 0 if keep is None else _number_of_worst(keep)
    check_report(report, force)
    read = read_study(study_path(study), count, seed)
    of_captures = read.capture is not None
    if of_captures and (worst or report is not None):
        raise UsageError("--report" if worst == 0 else "--keep", "is not for studies of captures", "leave it out")
    metadata = pipeline.metadata(read, shlex.join(["ringpose", *sys.argv[1:]]))
    batch = Batch()
    with opened(output, metadata, force=force, wait=wait) as folder:
        prepared = pipeline.prepared(read, folder, jobs)
        finished = folder.finished(prepared.shots)
        missing = [index for index in range(prepared.shots) if index not in finished]
        done = pipeline.computed(prepared, missing, jobs, scheduler, scheduler_file)
        pipeline.write_finished(prepared, folder, _reported(done, len(missing), prepared.shots, quiet or cron))
        folder.write_tables(columns(prepared), metadata)
        if of_captures:
            text, exceeded = pipeline.written_captures(prepared, folder)
        else:
            summary = summarized(prepared, folder.rows())
            text, exceeded = study_text(prepared, summary), exceeded_limits(prepared, summary)
        if not cron or exceeded:
            records.write_text(text)
        if worst:
            pipeline.write_worst(prepared, folder, worst)
        if report is not None:
            from ringpose.bench.study.report import study_report
            from ringpose.files.io import write_page

            pictures = pipeline.pictures_of_worst(prepared, folder)
            write_page(report, study_report(prepared, summary, folder.rows, pictures, metadata), force=force)
    report_missed(exceeded, batch)
    batch.finish()


def _number_of_worst(keep: str) -> int:
    """The number N in the option value `worst:N`."""
    word, _, number = keep.partition(":")
    if word != "worst" or not number.isdecimal() or not 0 < int(number) <= 1000:
        raise UsageError("--keep", f"is {keep!r}", "give worst:N with N from 1 to 1000")
    return int(number)


def _reported(done: "Iterator[Done]", missing: int, shots: int, quiet: bool) -> "Iterator[Done]":
    """The shots as they come; progress with rate and time left, on a terminal or as a line a minute."""
    if quiet or sys.stderr is None:
        yield from done
        return
    if sys.stderr.isatty():
        yield from with_total(done, "shots", shots, shots - missing)
        return
    begun_s = last_s = monotonic()
    for number, shot in enumerate(done, start=1):
        yield shot
        now_s = monotonic()
        if now_s - last_s >= LOG_S:
            rate, last_s = number / (now_s - begun_s), now_s
            left_s = (missing - number) / rate
            finished = shots - missing + number
            messages.echo(f"{finished} of {shots} shots, {rate:.3g} shots/s, {left_s / 60:.0f} min left")
