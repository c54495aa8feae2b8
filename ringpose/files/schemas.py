"""The kinds of records and files that are read, by the names of their JSON Schemas."""

from collections.abc import Mapping
from typing import Any

from ringpose.files import boards, rigs
from ringpose.files.cameras import ros
from ringpose.files.images import sessions
from ringpose.files.records import captures, detections, points, poses, robot_poses, tracks, truths
from ringpose.files.records.codec import RecordType
from ringpose.files.scenes import scene
from ringpose.files.studies import specification

RECORDS: Mapping[str, RecordType[Any]] = {
    "pose": poses.RECORD,
    "track": tracks.RECORD,
    "detection": detections.RECORD,
    "points": points.RECORD,
    "truth": truths.RECORD,
    "session": sessions.RECORD,
    "robot-pose": robot_poses.RECORD,
    "capture": captures.RECORD,
    "rig": rigs.RECORD,
    "camera": ros.RECORD,
    "board": boards.RECORD,
    "scene": scene.RECORD,
    "study": specification.RECORD,
}
