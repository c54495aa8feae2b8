"""The JSON Schemas that `ringpose schema` prints, by name."""

import json
from importlib.resources import files
from typing import Any

from ringpose.files.records import poses, tracks
from ringpose.files.records.codec import Record

RECORDS: dict[str, Record[Any]] = {"pose": poses.RECORD, "track": tracks.RECORD}
NAMES = ("pose", "track", "detection", "truth", "session")


def schema(name: str) -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of one kind of record."""
    if name in RECORDS:
        return RECORDS[name].schema()
    found: dict[str, Any] = json.loads(files("ringpose.files").joinpath(f"{name}.schema.json").read_text())
    return found
