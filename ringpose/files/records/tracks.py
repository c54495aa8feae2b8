"""The track line: one JSON record (`ringpose-records(5)`), of which `TrackLine` is the definition."""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

from ringpose.files.records.codec import RecordType
from ringpose.files.records.poses import pose_record, status_rules
from ringpose.files.schema import TRACK_LINE
from ringpose.types.options import PoseFrame
from ringpose.types.pose import PoseLine
from ringpose.types.track import TrackLine

RECORD = RecordType(
    cls=TrackLine,
    kind=TRACK_LINE,
    version="ringpose/track/1",
    description="Where the ring is and how it moves at one instant, from a stream of pose records. Metres, radians, "
    "seconds. Readers ignore unknown keys and flags.",
    rules=status_rules({"validity": {"const": "lost"}}),
)


def track_record(line: TrackLine, brief: bool = False) -> dict[str, Any]:
    """The record; with `brief` without `attempts` and `log_evidence`."""
    return RECORD.write(line, brief)


def line_record(line: PoseLine | TrackLine, brief: bool = False) -> dict[str, Any]:
    """The record of a pose line or of a line of a track."""
    return pose_record(line, brief) if isinstance(line, PoseLine) else track_record(line, brief)


def pose_line_of_track(record: Mapping[str, Any], location: str) -> PoseLine:
    """A track record as a pose line, with the keys that both have; its reason states validity and fusion status.

    The shot is the newest that was measured, empty for an instant between measurements.
    """
    line = RECORD.read(record, location)
    return PoseLine(
        shot=line.shot,
        stamp_s=line.stamp_s,
        pose_stamp_s=line.stamp_s,
        flags=line.flags,
        reason=f"{line.validity}, {line.fusion_status}",
        frame=PoseFrame(line.frame),
        pose=None if line.pose is None else replace(line.pose, flags=line.flags),
        velocity=line.velocity,
        rig=line.rig,
    )
