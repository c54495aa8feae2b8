"""truth.jsonl: the ground truth, one record per shot, of which `Truth` is the definition."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ringpose.files import records
from ringpose.files.inputs import file_lines
from ringpose.files.records.codec import RecordType
from ringpose.files.schema import TRUTH, Fields
from ringpose.types.truth import Truth

_KNOWN = {"center_m": {"type": "array"}, "normal": {"type": "array"}}

RECORD = RecordType(
    cls=Truth,
    kind=TRUTH,
    description="The ground truth of one shot, one line of truth.jsonl. Camera frame, metres, radians, seconds, "
    "pixels. Your own keys begin with x_.",
    rules={
        "if": {"required": ["expect"], "properties": {"expect": {"const": "no_target"}}},
        "else": {"required": list(_KNOWN), "properties": _KNOWN},
    },
    strict=True,
)


def read_truths(path: Path) -> Iterator[Truth]:
    """Yield the truths in a file in order; a shot that occurs twice is rejected."""
    shots: set[str] = set()
    for location, record in records.read(file_lines(path), str(path)):
        truth = RECORD.read(record, location)
        if truth.shot in shots:
            raise Fields(location, record).problem("shot", f"{truth.shot!r} occurs twice")
        shots.add(truth.shot)
        yield truth


def truth_record(truth: Truth) -> dict[str, Any]:
    """The record of a truth; a break point that is not visible is null."""
    return RECORD.write(truth)
