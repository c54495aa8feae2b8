"""What the node does with the lines of ringpose, without ROS: which to publish, diagnostics, mount, robot poses."""

import json
from collections.abc import Mapping
from pathlib import Path

import numpy as np
import yaml

WITHHELD = {
    "pose": {
        "assignment_ambiguous",
        "center_weak",
        "inconsistent",
        "normal_weak",
        "radius_inconsistent",
        "rig_drift",
        "side_unknown",
    },
    "twist": {"assignment_ambiguous", "inconsistent", "rig_drift", "velocity_weak"},
}
"""Flags with which a message is not published: its covariance does not describe its error (ringpose-records(5))."""

OK, WARN, ERROR, STALE = range(4)
"""Levels of diagnostic_msgs/DiagnosticStatus."""


def published(line):
    """The names of the messages of a line that may be published: `pose`, `twist`."""
    is_valid = line.get("validity", "valid") == "valid"
    return [
        name for name in WITHHELD if is_valid and line[name] is not None and WITHHELD[name].isdisjoint(line["flags"])
    ]


def filled(message, fields):
    """The message with these fields, nested as in its definition."""
    for name, value in fields.items():
        if isinstance(value, Mapping):
            filled(getattr(message, name), value)
        else:
            setattr(message, name, value)
    return message


def summary(line, age_s, patience_s):
    """Level and message of the diagnostics, of the newest line (None: there was none) of this age."""
    if line is None or age_s > patience_s:
        return STALE, "no line yet" if line is None else f"no line for {age_s:.1f} s"
    if line["pose"] is None:
        return ERROR, line["reason"] or f"no pose, {line.get('validity', line['status'])}"
    found = [line["validity"]] if line.get("validity", "valid") != "valid" else []
    found += line["flags"] if line["status"] != "ok" else []
    return (WARN if found else OK), "; ".join([*found, *filter(None, [line["reason"]])]) or "ok"


def values(line):
    """Keys and values of the diagnostics: those of the line that are one number or word, and the flags."""
    plain = {key: value for key, value in (line or {}).items() if isinstance(value, (str, int, float))}
    return {**{key: str(value) for key, value in plain.items()}, "flags": " ".join((line or {}).get("flags", ()))}


def mount_of(rig):
    """What carries the camera (`tool` or `base`) and its 4 x 4 matrix, which maps points from the camera; or None."""
    mount = yaml.safe_load(Path(rig).read_text(encoding="utf-8")).get("mount")
    if mount is None:
        return None
    carrier = "tool" if "tool_from_camera" in mount else "base"
    return carrier, np.array(mount[f"{carrier}_from_camera"], dtype=float)


def transform_fields(matrix):
    """The fields of geometry_msgs/Transform of a 4 x 4 matrix."""
    (xx, xy, xz), (yx, yy, yz), (zx, zy, zz) = matrix[:3, :3]
    # the unit quaternion is the eigenvector of the largest eigenvalue (Bar-Itzhack 2000)
    symmetric = [
        [xx - yy - zz, xy + yx, xz + zx, zy - yz],
        [xy + yx, yy - xx - zz, yz + zy, xz - zx],
        [xz + zx, yz + zy, zz - xx - yy, yx - xy],
        [zy - yz, xz - zx, yx - xy, xx + yy + zz],
    ]
    quaternion = np.linalg.eigh(symmetric)[1][:, -1]
    return {
        "translation": dict(zip("xyz", matrix[:3, 3].tolist(), strict=True)),
        "rotation": dict(zip("xyzw", quaternion.tolist(), strict=True)),
    }


def robot_pose_line(base_from_tool):
    """A geometry_msgs/TransformStamped from tool to base as a line for --robot-poses."""
    stamp, transform = base_from_tool.header.stamp, base_from_tool.transform
    pose = {
        "position_m": [getattr(transform.translation, axis) for axis in "xyz"],
        "orientation_xyzw": [getattr(transform.rotation, axis) for axis in "xyzw"],
    }
    return json.dumps({"stamp_s": stamp.sec + 1e-9 * stamp.nanosec, "base_from_tool": pose}) + "\n"
