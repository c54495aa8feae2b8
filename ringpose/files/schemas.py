"""The JSON Schemas that `ringpose schema` prints, by name."""

from collections.abc import Mapping
from typing import Any

from ringpose.files.images import sessions
from ringpose.files.records import detections, poses, robot_poses, tracks, truths
from ringpose.files.records.codec import RecordType

RECORDS: Mapping[str, RecordType[Any]] = {
    "pose": poses.RECORD,
    "track": tracks.RECORD,
    "detection": detections.RECORD,
    "truth": truths.RECORD,
    "session": sessions.RECORD,
    "robot-pose": robot_poses.RECORD,
}

NAMES = tuple(RECORDS)


def schema(name: str) -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of one kind of record."""
    return RECORDS[name].schema()
