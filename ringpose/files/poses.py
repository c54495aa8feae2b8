"""The pose line: one JSON record a shot (`ringpose-records(5)`, `pose.schema.json`)."""

import math
from collections.abc import Mapping
from typing import Any

import numpy as np

from ringpose.files.cameras.covariances import checked_covariance
from ringpose.files.schema import Fields
from ringpose.types.arrays import Array, Float64
from ringpose.types.options import PoseFrame
from ringpose.types.pose import PoseFlag, PoseLine, RingPose

SCHEMA = "ringpose/pose/1"

_KEYS = (
    "schema",
    "shot",
    "stamp_s",
    "frame",
    "status",
    "reason",
    "flags",
    "pose",
    "laser_health",
    "dropped",
    "latency_s",
    "rig",
)
_POSE_KEYS = (
    "center_m",
    "normal",
    "pitch_rad",
    "yaw_rad",
    "radius_inner_m",
    "radius_outer_m",
    "grasp_m",
    "covariance",
    "ring_posterior",
    "method",
    "residual_rms_px",
    "condition",
)
_COVARIANCE_KEYS = ("full", "center", "grasp")


def pose_record(line: PoseLine) -> dict[str, Any]:
    """The record of one shot; the writer replaces NaN and infinity by null."""
    return {
        "schema": SCHEMA,
        "shot": line.shot,
        "stamp_s": line.stamp_s,
        "frame": line.frame.value,
        "status": line.status,
        "reason": line.reason,
        "flags": list(line.flags),
        "pose": None if line.pose is None else _pose_dict(line.pose),
        "laser_health": dict(line.laser_health),
        "dropped": line.dropped,
        "latency_s": line.latency_s,
        "rig": line.rig or None,
    }


def pose_line_of(record: Mapping[str, Any], location: str) -> PoseLine:
    """The pose line of a record; null becomes NaN, or None for a missing array. `location` is used in messages."""
    fields = Fields(location, record)
    schema = fields.text("schema")
    if schema != SCHEMA:
        raise fields.problem("schema", f"is {schema!r}, must be {SCHEMA!r}", "give the output of ringpose pose")
    fields.reject_unknown(_KEYS)
    flags = _flags(fields)
    return PoseLine(
        shot=fields.text("shot"),
        stamp_s=_number(fields, "stamp_s"),
        pose=_read_pose(fields.fields("pose", _POSE_KEYS), flags) if fields.has("pose") else None,
        reason=fields.text("reason") if fields.has("reason") else None,
        frame=PoseFrame(fields.choice("frame", tuple(PoseFrame))),
        laser_health=_laser_health(fields) if fields.has("laser_health") else {},
        dropped=fields.integer("dropped", least=0) if fields.has("dropped") else 0,
        latency_s=_number(fields, "latency_s"),
        rig=fields.text("rig") if fields.has("rig") else "",
    )


def _pose_dict(pose: RingPose) -> dict[str, Any]:
    return {
        "center_m": _finite(pose.center_m),
        "normal": _finite(pose.normal),
        "pitch_rad": pose.pitch_rad,
        "yaw_rad": pose.yaw_rad,
        "radius_inner_m": pose.radius_inner_m,
        "radius_outer_m": pose.radius_outer_m,
        "grasp_m": _finite(pose.grasp_m),
        "covariance": _covariance_dict(pose),
        "ring_posterior": None if pose.ring_posterior is None else dict(pose.ring_posterior),
        "method": pose.method,
        "residual_rms_px": pose.residual_rms_px,
        "condition": pose.condition,
    }


def _covariance_dict(pose: RingPose) -> dict[str, Any] | None:
    matrices = (pose.covariance, pose.covariance_center_m2, pose.covariance_grasp_m2)
    if all(matrix is None for matrix in matrices):
        return None
    full, center, grasp = matrices
    return {"full": full, "center": _finite(center), "grasp": _finite(grasp)}


def _finite(values: Float64[Array, "..."] | None) -> Float64[Array, "..."] | None:
    """The array, or None if an element of it is not finite."""
    return values if values is not None and np.isfinite(values).all() else None


def _read_pose(fields: Fields, flags: PoseFlag) -> RingPose:
    covariance = fields.fields("covariance", _COVARIANCE_KEYS) if fields.has("covariance") else None
    return RingPose(
        center_m=_vector(fields, "center_m"),
        normal=fields.unit_vector("normal") if fields.has("normal") else np.full(3, np.nan),
        radius_inner_m=_number(fields, "radius_inner_m"),
        radius_outer_m=_number(fields, "radius_outer_m"),
        grasp_m=_vector(fields, "grasp_m"),
        method=fields.text("method"),
        condition=_number(fields, "condition", missing=math.inf),
        residual_rms_px=_number(fields, "residual_rms_px"),
        covariance=_covariance(covariance, "full", 7),
        covariance_center_m2=_covariance(covariance, "center", 3),
        covariance_grasp_m2=_covariance(covariance, "grasp", 3),
        flags=flags,
        ring_posterior=_ring_posterior(fields) if fields.has("ring_posterior") else None,
    )


def _flags(fields: Fields) -> PoseFlag:
    flags = PoseFlag(0)
    by_name = {str(flag.name).lower(): flag for flag in PoseFlag}
    for name in fields.texts("flags"):
        if name not in by_name:
            raise fields.problem("flags", f"unknown flag {name!r}", "give the output of this version of ringpose pose")
        flags |= by_name[name]
    return flags


def _ring_posterior(fields: Fields) -> dict[str, float]:
    shares = fields.fields("ring_posterior")
    return {name: shares.number(name, least=0, most=1) for name in shares.values}


def _laser_health(fields: Fields) -> dict[str, float]:
    health = fields.fields("laser_health")
    return {name: _number(health, name) for name in health.values}


def _number(fields: Fields, key: str, missing: float = math.nan) -> float:
    return fields.number(key) if fields.has(key) else missing


def _vector(fields: Fields, key: str) -> Float64[Array, "xyz=3"]:
    return fields.vector(key, 3) if fields.has(key) else np.full(3, np.nan)


def _covariance(fields: Fields | None, key: str, size: int) -> Float64[Array, "n n"] | None:
    """A covariance; null is allowed only in `full`, in complete rows and columns of undetermined parameters."""
    if fields is None or not fields.has(key):
        return None
    matrix = fields.array(key, (size, size), allow_nan=True)
    undetermined = np.isnan(np.diagonal(matrix))
    if (np.isnan(matrix) != (undetermined[:, None] | undetermined)).any() or (key != "full" and undetermined.any()):
        raise fields.problem(key, "has a null among numbers", "give the output of ringpose pose unchanged")
    determined = np.ix_(~undetermined, ~undetermined)
    matrix[determined] = checked_covariance(fields, key, matrix[determined])
    return matrix
