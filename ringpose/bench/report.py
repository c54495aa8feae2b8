"""Summaries and scores as plain values for JSON and CSV, in metres and radians, and scores from these values."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from typing import Any, Literal, cast

from ringpose.bench.assumptions import (
    AssumedRadii,
    StatedAssumptions,
    assumptions_record,
    assumptions_text,
    counted_records,
)
from ringpose.bench.score import QUANTITIES, Judgement, Matching, Outcome, Score
from ringpose.bench.summary import Summary
from ringpose.errors import DataError
from ringpose.files.records.codec import definition_of
from ringpose.files.schema import Fields
from ringpose.types.pose import Priors, RigPriors
from ringpose.types.table import Table

SCHEMA = "bench/3"

STATUSES = ("ok", "degraded", "none", "lost")

SCHEMA_2 = "bench/2"
"""The previous version, which is read but not written: all poses are those of a still and perfect ring."""


def report(
    summaries: Sequence[Summary],
    scores: Sequence[Score],
    missed: Sequence[str],
    matched: Matching | None,
    truths: Iterable[str],
) -> dict[str, Any]:
    """The report: `groups` (an empty `group` is all shots), `shots`, and the messages about exceeded limits.

    `matched` is None if the poses were computed by this run; `truths` are the SHA-256 of the truth files.
    """
    return {
        "ringpose": SCHEMA,
        "assumptions": counted_records(score.assumptions for score in scores),
        "truths": sorted(truths),
        "matching": None if matched is None else asdict(matched),
        "groups": [_group_record(line) for line in summaries],
        "shots": [
            {**asdict(each), "assumptions": assumptions_record(each.assumptions), "rig": each.rig or None}
            for each in scores
        ],
        "missed": list(missed),
    }


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


def _group_record(line: Summary) -> Mapping[str, Any]:
    wrong = line.wrong
    return {
        **asdict(line),
        "quantities": {name: counts for name, counts in wrong.counts.items() if any(counts.values())},
        "wrong": {
            "count": wrong.count(Judgement.WRONG),
            "judged": wrong.judged,
            "allowed": wrong.allowed,
            "gross": wrong.gross,
            "none_wrong": wrong.none_wrong,
        },
    }


def recorded_scores(fields: Fields) -> list[Score]:
    """The scores that the JSON report of `ringpose bench` contains.

    Reports of version 2 do not state assumptions: their poses are those of a still and perfect ring.
    """
    schema = fields.values.get("ringpose")
    if schema not in (SCHEMA, SCHEMA_2):
        found = f"is a {schema!r} file" if schema else "is not a table of ringpose bench"
        remedy = "give the output of bench --json, or pose records (.jsonl)"
        raise DataError(fields.file, f"{found}, must be {SCHEMA!r}", remedy)
    return [
        _score_of(shot, StatedAssumptions() if schema == SCHEMA_2 else _assumptions(shot))
        for shot in fields.each("shots")
    ]


def _score_of(fields: Fields, assumptions: StatedAssumptions | None) -> Score:
    def numbers(key: str) -> dict[str, float]:
        part = fields.fields(key)
        return {name: part.number(name) for name in part.values}

    judgements = fields.fields("judgements")
    return Score(
        shot=fields.text("shot"),
        method=str(fields.values.get("method") or ""),
        outcome=Outcome(fields.choice("outcome", tuple(Outcome))),
        status=cast(Literal["ok", "degraded", "none", "lost"], fields.choice("status", STATUSES)),
        has_target=fields.boolean("has_target"),
        groups=dict(fields.fields("groups").values),
        errors=numbers("errors"),
        judgements={name: Judgement(judgements.choice(name, tuple(Judgement))) for name in map(str, judgements.values)},
        distances=numbers("distances"),
        gross=fields.texts("gross"),
        assumptions=assumptions,
        latency_s=fields.optional("latency_s", lambda key: fields.number(key, least=0)),
        rig=fields.optional("rig", fields.text) or "",
    )


def _assumptions(fields: Fields) -> StatedAssumptions | None:
    if not fields.has("assumptions"):
        return None
    values, radii = fields.fields("assumptions"), None
    if values.has("radii"):
        known = values.fields("radii")
        numbers = known.given(("inner_m", "outer_m", "sd_m"), lambda key: known.number(key, least=0))
        source = cast(Literal["given", "catalogue"], known.choice("source", ("given", "catalogue")))
        radii = AssumedRadii(source=source, **numbers)
    return StatedAssumptions(
        motion=definition_of(Priors).value("motion", values),
        radii=radii,
        ring_tolerance_m=values.number("ring_tolerance_m", least=0),
        stability=definition_of(RigPriors).value("stability", values),
    )
