"""The track line: one JSON record (`ringpose-records(5)`, `track.schema.json`)."""

from collections.abc import Mapping
from dataclasses import asdict, replace
from math import nan
from typing import Any

from ringpose.files.kinds import TRACK_LINE
from ringpose.files.records.poses import SCHEMA as POSE_SCHEMA
from ringpose.files.records.poses import pose_line_of, pose_record
from ringpose.files.schema import Fields
from ringpose.types.pose import PoseFlag, PoseLine
from ringpose.types.track import MotionModel, TrackLine

SCHEMA = "ringpose/track/1"


def track_record(line: TrackLine, brief: bool = False) -> dict[str, Any]:
    """The record; with `brief` without `attempts` and `log_evidence`."""
    of_pose = pose_record(PoseLine(shot="", stamp_s=nan, pose=line.pose, velocity=line.velocity), brief=True)
    noise = line.process_noise
    record = {
        "schema": SCHEMA,
        "stamp_s": line.stamp_s,
        "measurement_stamp_s": line.measurement_stamp_s,
        "age_s": line.age_s,
        "validity": line.validity,
        "status": line.status,
        "flags": [str(flag.name).lower() for flag in PoseFlag if flag in line.flags],
        "fusion_status": line.attempt.fusion_status,
        "test_ratio": line.attempt.test_ratio,
        "frame": line.frame,
        "pose": of_pose["pose"],
        "velocity": of_pose["velocity"],
        "grasp": line.grasp,
        "next": line.next_tick,
        "hypotheses": line.hypotheses,
        "model": line.model,
        "process_noise": None if noise is None else {"velocity_m2_s3": noise[0], "rate_rad2_s3": noise[1]},
        "log_evidence": {model.value: line.log_evidence.get(model) for model in MotionModel},
        "camera": line.camera,
        "capture_probability": line.capture_probability,
        "resets": line.resets,
        "attempts": [{**asdict(each), "reason": each.reason or None} for each in line.attempts],
        "shot": line.attempt.shot or None,
        "reason": line.attempt.reason or None,
        "rig": line.rig or None,
    }
    if brief:
        del record["attempts"], record["log_evidence"]
    return record


def pose_line_of_track(record: Mapping[str, Any], location: str) -> PoseLine:
    """A track record as a pose line, with the keys that both have; its reason states validity and fusion status.

    The shot is the newest that was measured, empty for an instant between measurements. A track in the frame of the
    robot's base has no pose here.
    """
    fields = Fields(location, record)
    fields.schema((SCHEMA,), TRACK_LINE)
    in_camera = fields.text("frame") == "camera"
    line = pose_line_of(
        {
            "schema": POSE_SCHEMA,
            "shot": "the track",
            "stamp_s": fields.number("stamp_s"),
            "pose_stamp_s": fields.number("stamp_s"),
            "frame": "camera",
            "flags": record.get("flags", []),
            "reason": f"{fields.text('validity')}, {fields.text('fusion_status')}",
            "pose": record.get("pose") if in_camera else None,
            "velocity": record.get("velocity") if in_camera else None,
            "rig": record.get("rig"),
        },
        location,
    )
    return replace(line, shot=fields.text("shot") if fields.has("shot") else "")
