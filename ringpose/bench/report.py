"""The report of `ringpose bench --json`, in metres and radians, scores as CSV, and scores from a report."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

from ringpose.bench.assumptions import CountedAssumptions, StatedAssumptions, assumptions_text, counted
from ringpose.bench.score import QUANTITIES, Matching, Score
from ringpose.bench.summary import Summary
from ringpose.errors import DataError
from ringpose.files.records.codec import RecordType, definition_of
from ringpose.files.schema import Fields
from ringpose.types.record import Key
from ringpose.types.table import Table

SCHEMA = "bench/3"

SCHEMA_2 = "bench/2"
"""The previous version, which is read but not written: all poses are those of a still and perfect ring."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Report:
    """What `ringpose bench --json` writes."""

    assumptions: Annotated[tuple[CountedAssumptions, ...], Key("What the poses assume, each with the number of shots.")]
    truths: Annotated[tuple[str, ...], Key("Hashes of the truth files.")]
    matching: Annotated[
        Matching | None, Key("How records were assigned to truths; null if this run computed the poses.")
    ]
    groups: Annotated[tuple[Summary, ...], Key("Figures of groups of shots, the last of each method of all shots.")]
    shots: Annotated[tuple[Score, ...], Key("Scores of each shot and method.")]
    missed: Annotated[tuple[str, ...], Key("Messages about exceeded limits.")]
    provenance: Annotated[Mapping[str, Any], Key("Version, command, time and inputs.")]


RECORD = RecordType(
    cls=Report,
    version=SCHEMA,
    description="The output of `ringpose bench --json`: poses compared with the truth. Metres, radians, seconds.",
    is_file=True,
)


def report(
    summaries: Sequence[Summary],
    scores: Sequence[Score],
    missed: Sequence[str],
    matched: Matching | None,
    truths: Iterable[str],
    provenance: Mapping[str, Any],
) -> dict[str, Any]:
    """The report: groups (an empty `group` is all shots), shots, and the messages about exceeded limits.

    `matched` is None if the poses were computed by this run; `truths` are the SHA-256 of the truth files.
    """
    made = Report(
        assumptions=counted(score.assumptions for score in scores),
        truths=tuple(sorted(truths)),
        matching=matched,
        groups=tuple(summaries),
        shots=tuple(scores),
        missed=tuple(missed),
        provenance=provenance,
    )
    return RECORD.write(made)


def score_table(scores: Sequence[Score]) -> Table:
    """A row for each shot and method, in metres and radians; wrong quantities share a cell."""
    names = list(dict.fromkeys(name for score in scores for name in score.groups))
    rows = [
        [
            *(score.shot, score.method, str(score.outcome)),
            *(score.groups.get(name) for name in names),
            *(score.errors.get(name) for name in QUANTITIES),
            *(score.status, " ".join(score.wrong), score.latency_s),
            None if score.assumptions is None else assumptions_text(score.assumptions),
        ]
        for score in scores
    ]
    headings = ["shot", "method", "outcome", *names, *QUANTITIES, "status", "wrong", "latency_s", "assumptions"]
    return Table(headings=headings, rows=rows)


def recorded_scores(fields: Fields) -> list[Score]:
    """The scores that the JSON report of `ringpose bench` contains.

    Reports of version 2 do not state assumptions: their poses are those of a still and perfect ring.
    """
    schema = fields.values.get("ringpose")
    if schema not in (SCHEMA, SCHEMA_2):
        finding = f"is a {schema!r} file" if schema else "is not a table of ringpose bench"
        remedy = "give the output of bench --json, or pose records (.jsonl)"
        raise DataError(fields.file, f"{finding}, must be {SCHEMA!r}", remedy)
    if schema == SCHEMA:
        return list(definition_of(Report).value("shots", fields))
    shots = [{**shot.values, "assumptions": None} for shot in fields.each("shots")]
    earlier = definition_of(Report).value("shots", Fields(fields.file, {"shots": shots}))
    return [replace(score, assumptions=StatedAssumptions()) for score in earlier]
