"""`ringpose bench capture`: score runs in which a gripper was guided to the ring."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ringpose.cli.batch import Batch
from ringpose.cli.bench.score import report_missed
from ringpose.errors import DataError, UsageError

if TYPE_CHECKING:
    from ringpose.types.capture import CaptureLine


def capture(
    inputs: Annotated[
        list[Path],
        typer.Argument(metavar="FILE", readable=False, help="Runs: captures.jsonl of a study, or of another program."),
    ],
    by: Annotated[
        str | None, typer.Option("--by", metavar="GROUPS", help="Make a table of these groups, separated by commas.")
    ] = None,
    min_success: Annotated[
        float | None,
        typer.Option("--min-success", metavar="SHARE", min=0.0, max=1.0, help="Lowest share of successes in each row."),
    ] = None,
    max_miss: Annotated[
        float | None,
        typer.Option("--max-miss", metavar="SHARE", min=0.0, max=1.0, help="Highest share of misses in each row."),
    ] = None,
) -> None:
    """Score runs in which a gripper was guided to the ring: successes with their lower bounds, misses, claims."""
    from ringpose.bench.capture.score import captures_text, missed_limits, refuted_claims
    from ringpose.files import records
    from ringpose.files.records.captures import read_captures

    lines: list[CaptureLine] = []
    for file in inputs:
        of_file = list(read_captures(file))
        if not of_file:
            raise DataError(str(file), "has no run", "give captures.jsonl of ringpose bench study")
        lines += of_file
    names = [name.strip() for name in (by or "").split(",") if name.strip()]
    for name in names:
        if not any(name in line.groups for line in lines):
            raise UsageError("--by", f'no run has a group "{name}"')
    records.write_text(captures_text(lines, names))
    given = {"min_success_share": min_success, "max_miss_share": max_miss}
    limits = {name: limit for name, limit in given.items() if limit is not None}
    missed = refuted_claims(lines)
    for method in dict.fromkeys(line.method for line in lines):
        missed += missed_limits(limits, method, lines, names)
    batch = Batch()
    report_missed(missed, batch)
    batch.finish()
