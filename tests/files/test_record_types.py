"""Records of every kind: read as they were written, and with any value spoiled read or rejected with one clear line."""

import json
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from schemas import validated
from spoiled_values import outcome, spoiled_once
from whole_records import VERSION_1, complete_line, complete_track, record_of

from ringpose.files import records
from ringpose.files.records.poses import pose_line_of, pose_record
from ringpose.files.records.tracks import RECORD as TRACK
from ringpose.files.records.tracks import track_record
from ringpose.files.schemas import RECORDS

Values = dict[str, Any]


class Example(NamedTuple):
    """A record in which everything is known, with its reader and its writer."""

    name: str
    """Name of its schema."""
    read: Callable[[Values, str], Any]
    write: Callable[[Any], Values]
    values: Values


RNG = np.random.default_rng(1)
EXAMPLES: Mapping[str, Example] = {
    "pose": Example("pose", pose_line_of, pose_record, record_of(pose_record(complete_line(RNG)))),
    "pose of version 1": Example("pose", pose_line_of, pose_record, VERSION_1),
    "track": Example("track", TRACK.read, track_record, record_of(track_record(complete_track(RNG)))),
}
PRESENT = [name for name in EXAMPLES if "version" not in name]


def rewritten(example: Example, found: Any) -> Values:
    """The record that is written of what was read; it fits its schema."""
    values: Values = json.loads(records.line_of(example.write(found)))
    validated(values | ({"rig": None} if "rig" in values else {}), example.name)  # tests call a rig by any name
    return values


def test_there_is_an_example_of_every_kind():
    assert {each.name for each in EXAMPLES.values()} == set(RECORDS)


@pytest.mark.parametrize("name", PRESENT)
def test_a_record_is_read_as_it_was_written_and_unknown_keys_are_ignored(name):
    example = EXAMPLES[name]

    found = example.read(example.values | {"more": {"a": [1]}}, "x")

    assert rewritten(example, found) == example.values


@pytest.mark.parametrize("name", EXAMPLES)
@given(data=st.data())
def test_a_spoiled_record_is_rejected_with_its_place_or_read(name, data):
    example = EXAMPLES[name]

    found = outcome(lambda values: example.read(values, "x"), data.draw(spoiled_once(example.values)), "x: ")

    if found is not None:
        once = rewritten(example, found)
        assert rewritten(example, example.read(once, "x")) == once
