"""Summaries and scores as plain values, for JSON and CSV; metres and radians."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict
from typing import Any

from ringpose.bench.score import QUANTITIES, Score
from ringpose.bench.summary import Summary

SCHEMA = "bench/1"


def report(summaries: Sequence[Summary], scores: Sequence[Score], missed: Sequence[str]) -> dict[str, Any]:
    """All of it: `groups` (an empty `group` is all shots), `shots`, and the sentences about missed limits."""
    return {
        "ringpose": SCHEMA,
        "groups": [_group_record(line) for line in summaries],
        "shots": [_shot_record(score) for score in scores],
        "missed": list(missed),
    }


def csv_rows(scores: Sequence[Score]) -> Iterator[Sequence[str | float | int | bool]]:
    """A heading, then one row a shot and method; what cannot be compared is empty."""
    names = list(dict.fromkeys(name for score in scores for name in score.groups))
    yield ["shot", "method", "outcome", *names, *QUANTITIES]
    for score in scores:
        groups = [score.groups.get(name, "") for name in names]
        yield [score.shot, score.method, score.outcome, *groups, *(score.errors.get(name, "") for name in QUANTITIES)]


def _group_record(line: Summary) -> Mapping[str, Any]:
    return {
        "method": line.method,
        "group": dict(line.group),
        "shots": line.shots,
        "outcomes": {str(outcome): count for outcome, count in line.outcomes.items()},
        "errors": {name: asdict(spread) for name, spread in line.errors.items()},
        "nees": dict(line.nees),
    }


def _shot_record(score: Score) -> Mapping[str, Any]:
    return {
        "shot": score.shot,
        "method": score.method,
        "outcome": str(score.outcome),
        "groups": dict(score.groups),
        "errors": dict(score.errors),
    }
