"""The pose line: one JSON record a shot (`ringpose-records(5)`), of which `PoseLine` is the definition.

Version 2 is written; versions 1 and 2 are read. Keys and flags that this version does not have are ignored.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, get_args

from ringpose.files.records.codec import RecordType, flags_by_name
from ringpose.files.schema import POSE_LINE, Fields
from ringpose.types.pose import HARMLESS_FLAGS, PoseFlag, PoseLine, Status

_HARMLESS = {"enum": [name for name, flag in flags_by_name(PoseFlag).items() if flag in HARMLESS_FLAGS]}


def status_rules(none: Mapping[str, Any]) -> dict[str, Any]:
    """In the schema: which status a line has by its pose and its flags; `none`: what else holds without a pose."""
    degraded, ok = {"contains": {"not": _HARMLESS}}, {"items": _HARMLESS}
    cases = {
        "none": {"pose": {"type": "null"}, **none},
        "degraded": {"pose": {"type": "object"}, "flags": degraded},
        "ok": {"pose": {"type": "object"}, "flags": ok},
    }
    return {"oneOf": [{"properties": {"status": {"const": status}, **keys}} for status, keys in cases.items()]}


RECORD = RecordType(
    cls=PoseLine,
    kind=POSE_LINE,
    version="ringpose/pose/2",
    earlier=("ringpose/pose/1",),
    description="The pose of the ring in one shot, or the reason why there is none. Metres, radians, seconds, pixels. "
    "Readers ignore unknown keys and flags.",
    rules=status_rules({"reason": {"type": "string"}}),
)

_FLAGS_1 = {
    "point_left_out": PoseFlag.POINT_REJECTED,
    "stripe_left_out": PoseFlag.STRIPE_REJECTED,
    "relabelled": PoseFlag.ASSIGNMENT_AMBIGUOUS,
    "radius_disagrees": PoseFlag.RADIUS_INCONSISTENT,
    "damped": PoseFlag.CENTER_WEAK | PoseFlag.RADIUS_WEAK,
}
"""Flags of version 1 that have another name now; `damped` always came with `center_weak` and `radius_weak`."""


pose_record = RECORD.write
"""The record of a line, for `ringpose.files.records.line_of`; `brief`: without `measurement` and evidence."""


def pose_line_of(record: Mapping[str, Any], location: str) -> PoseLine:
    """The pose line of a record; null becomes NaN, or None for a missing array. `location` is used in messages.

    Records of version 1 state no priors, lasers, rejections or measurement.
    """
    line = RECORD.read(record, location)
    flags = line.flags
    if record["schema"] in RECORD.earlier:
        for name in record["flags"]:
            flags |= _FLAGS_1.get(name, PoseFlag(0))
    _check_status(Fields(location, record), flags)
    return replace(line, flags=flags, pose=None if line.pose is None else replace(line.pose, flags=flags))


def _check_status(fields: Fields, flags: PoseFlag) -> None:
    """Reject a status that contradicts pose or flags; it may be due to a flag that this version does not have."""
    if not fields.has("status"):
        return
    status = fields.choice("status", get_args(Status))
    serious, unchanged = flags & ~HARMLESS_FLAGS, RECORD.context.unchanged
    if (status == "none") == fields.has("pose"):
        pose = "there is a pose" if fields.has("pose") else "pose is null"
        raise fields.problem("status", f"is {status!r}, but {pose}", unchanged)
    if status == "ok" and serious:
        name = next(name for name, flag in flags_by_name(PoseFlag).items() if flag in serious)
        raise fields.problem("status", f"is 'ok', but there is the flag {name!r}", unchanged)
    if status == "degraded" and not fields.texts("flags"):
        raise fields.problem("status", "is 'degraded', but there is no flag", unchanged)


def recorded_status(record: Mapping[str, Any], line: PoseLine) -> Status:
    """The status in a record from which `line` was read; it may be due to a flag that this version does not have."""
    status: Status = record.get("status") or line.status
    return status
