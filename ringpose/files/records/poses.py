"""The pose line: one JSON record a shot (`ringpose-records(5)`, `pose.schema.json`).

Version 2 is written; versions 1 and 2 are read. Keys and flags that this version does not have are ignored.
"""

import math
from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Literal, cast, get_args

import numpy as np

from ringpose.files.kinds import POSE_LINE
from ringpose.files.records.rejections import rejections_in
from ringpose.files.rigs import rig_stability
from ringpose.files.schema import Fields, checked_covariance
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import Assumptions, MotionPrior
from ringpose.types.options import PoseFrame
from ringpose.types.pose import (
    HARMLESS_FLAGS,
    MEASURED_PARAMETERS,
    LaserState,
    LinearizationPoint,
    PlaneEvidence,
    PoseFlag,
    PoseLine,
    Priors,
    RadiusPrior,
    RingMeasurement,
    RingPose,
    RingVelocity,
    Status,
)
from ringpose.types.rig import PlaneCorrection

SCHEMA = "ringpose/pose/2"

SCHEMA_1 = "ringpose/pose/1"
"""The previous version, which is read but not written."""

STILL = "still"
"""`priors.motion` of a target that is assumed not to move."""

_FLAGS_1 = {
    "point_left_out": PoseFlag.POINT_REJECTED,
    "stripe_left_out": PoseFlag.STRIPE_REJECTED,
    "relabelled": PoseFlag.ASSIGNMENT_AMBIGUOUS,
    "radius_disagrees": PoseFlag.RADIUS_INCONSISTENT,
    "damped": PoseFlag.CENTER_WEAK | PoseFlag.RADIUS_WEAK,
}
"""Flags of version 1 that have another name now; `damped` always came with `center_weak` and `radius_weak`."""

_KEYS_1 = {"rig_health": "laser_health", "shots_dropped": "dropped", "condition_number": "condition"}
"""Names in version 1 of keys that have another name now."""

_UNCHANGED = "give the output of ringpose pose unchanged"


def pose_record(line: PoseLine, brief: bool = False) -> dict[str, Any]:
    """The record of one shot, for `ringpose.files.records.line_of` or `plain`, which replace NaN and infinity by null.

    With `brief`, without `measurement` and `plane_evidence`.
    """
    return {
        "schema": SCHEMA,
        "shot": line.shot,
        "stamp_s": line.stamp_s,
        "pose_stamp_s": line.pose_stamp_s,
        "frame": line.frame,
        "status": line.status,
        "reason": line.reason,
        "flags": line.flag_names,
        "pose": None if line.pose is None else _pose_values(line.pose),
        "velocity": line.velocity,
        **({} if brief else {"measurement": _measurement_values(line), "plane_evidence": line.plane_evidence}),
        "priors": None if line.priors is None else _priors_values(line.priors),
        "lasers": line.lasers,
        "rejected": line.rejected,
        "rig_health": line.rig_health,
        "shots_dropped": line.shots_dropped,
        "latency_s": line.latency_s,
        "stage_s": line.stage_s,
        "rig": line.rig or None,
    }


def _pose_values(pose: RingPose) -> dict[str, Any]:
    full, center, grasp = pose.covariance, _finite(pose.covariance_center_m2), _finite(pose.covariance_grasp_m2)
    is_known = any(matrix is not None for matrix in (full, center, grasp))
    return {
        "center_m": _finite(pose.center_m),
        "normal": _finite(pose.normal),
        "pitch_rad": pose.pitch_rad,
        "yaw_rad": pose.yaw_rad,
        "radius_inner_m": pose.radius_inner_m,
        "radius_outer_m": pose.radius_outer_m,
        "grasp_m": _finite(pose.grasp_m),
        "covariance": {"full": full, "center": center, "grasp": grasp} if is_known else None,
        "ring_posterior": pose.ring_posterior,
        "method": pose.method,
        "residual_rms_px": pose.residual_rms_px,
        "condition_number": pose.condition_number,
    }


def _measurement_values(line: PoseLine) -> dict[str, Any] | None:
    measurement = line.measurement
    if measurement is None:
        return None
    return {
        "linearized_at": measurement.linearized_at,
        "parameters": MEASURED_PARAMETERS,
        "nuisance_parameters": measurement.nuisance_parameters,
        "square_root": measurement.square_root,
        "degrees_of_freedom": measurement.degrees_of_freedom,
        "chi2": measurement.chi2,
        "camera_motion": measurement.camera_motion,
    }


def _priors_values(priors: Priors) -> dict[str, Any]:
    assumptions, radius = priors.assumptions, priors.radius
    return {
        "motion": STILL if assumptions.motion is None else assumptions.motion,
        "radius": None if radius is None else {**asdict(radius), "sd_m": radius.sd_m},
        "ring_tolerance_m": assumptions.ring_tolerance_m,
        "rig": {
            "covariance": "rig.yaml" if priors.rig_covariance else "none",
            "stability": assumptions.stability,
            **({"moved": priors.moved_planes} if priors.moved_planes else {}),
        },
        "regularization": priors.regularization,
    }


def _finite(values: Float64[Array, "..."] | None) -> Float64[Array, "..."] | None:
    """The array, or None if any element of it is not finite."""
    return values if values is not None and np.isfinite(values).all() else None


def pose_line_of(record: Mapping[str, Any], location: str) -> PoseLine:
    """The pose line of a record; null becomes NaN, or None for a missing array. `location` is used in messages.

    Records of version 1 state no priors, lasers, rejections or measurement.
    """
    fields = Fields(location, record)
    names = _KEYS_1 if fields.schema((SCHEMA, SCHEMA_1), POSE_LINE) == SCHEMA_1 else {key: key for key in _KEYS_1}
    flags = _checked_flags(fields)
    return PoseLine(
        shot=fields.text("shot"),
        stamp_s=fields.number("stamp_s", missing=math.nan),
        pose=_pose(fields.fields("pose"), flags, names["condition_number"]) if fields.has("pose") else None,
        pose_stamp_s=fields.number("pose_stamp_s", missing=math.nan),
        flags=flags,
        reason=fields.optional("reason", fields.text),
        frame=PoseFrame(fields.choice("frame", tuple(PoseFrame))),
        velocity=_velocity(fields.fields("velocity")) if fields.has("velocity") else None,
        measurement=_measurement(fields.fields("measurement")) if fields.has("measurement") else None,
        priors=_priors(fields.fields("priors")) if fields.has("priors") else None,
        lasers=_lasers(fields.fields("lasers")) if fields.has("lasers") else {},
        rejected=rejections_in(fields),
        plane_evidence=_plane_evidence(fields.fields("plane_evidence")) if fields.has("plane_evidence") else None,
        rig_health=_numbers(fields, names["rig_health"]),
        shots_dropped=fields.integer(names["shots_dropped"], least=0) if fields.has(names["shots_dropped"]) else 0,
        latency_s=fields.number("latency_s", least=0.0, missing=math.nan),
        stage_s=_numbers(fields, "stage_s", least=0.0),
        rig=fields.optional("rig", fields.text) or "",
    )


def _checked_flags(fields: Fields) -> PoseFlag:
    """The known flags of a record, which must not contradict its status."""
    names = fields.texts("flags")
    by_name = {str(flag.name).lower(): flag for flag in PoseFlag}
    if fields.text("schema") == SCHEMA_1:
        by_name |= _FLAGS_1
    flags = PoseFlag(0)
    for name in names:
        flags |= by_name.get(name, PoseFlag(0))
    if not fields.has("status"):
        return flags
    status = fields.choice("status", get_args(Status))
    if (status == "none") == fields.has("pose"):
        pose = "there is a pose" if fields.has("pose") else "pose is null"
        raise fields.problem("status", f"is {status!r}, but {pose}", _UNCHANGED)
    serious = flags & ~HARMLESS_FLAGS
    if status == "ok" and serious:
        raise fields.problem("status", f"is 'ok', but there is the flag {_name(serious)!r}", _UNCHANGED)
    if status == "degraded" and not names:
        raise fields.problem("status", "is 'degraded', but there is no flag", _UNCHANGED)
    return flags


def recorded_status(record: Mapping[str, Any], line: PoseLine) -> Status:
    """The status in a record from which `line` was read; it may be due to a flag that this version does not have."""
    status: Status = record.get("status") or line.status
    return status


def _name(flags: PoseFlag) -> str:
    return next(str(flag.name).lower() for flag in PoseFlag if flag in flags)


def _pose(fields: Fields, flags: PoseFlag, condition_key: str) -> RingPose:
    covariance = fields.fields("covariance") if fields.has("covariance") else None
    return RingPose(
        center_m=_vector(fields, "center_m"),
        normal=fields.unit_vector("normal") if fields.has("normal") else np.full(3, np.nan),
        radius_inner_m=fields.number("radius_inner_m", missing=math.nan),
        radius_outer_m=fields.number("radius_outer_m", missing=math.nan),
        grasp_m=_vector(fields, "grasp_m"),
        method=fields.text("method"),
        condition_number=fields.number(condition_key, missing=math.inf, least=0.0),
        residual_rms_px=fields.number("residual_rms_px", least=0.0, missing=math.nan),
        covariance=_covariance(covariance, "full", 7),
        covariance_center_m2=_covariance(covariance, "center", 3),
        covariance_grasp_m2=_covariance(covariance, "grasp", 3),
        flags=flags,
        ring_posterior=_numbers(fields, "ring_posterior", 0.0, 1.0) if fields.has("ring_posterior") else None,
    )


def _covariance(fields: Fields | None, key: str, size: int) -> Float64[Array, "n n"] | None:
    """A covariance; null is allowed only in `full`, in complete rows and columns of undetermined parameters."""
    if fields is None or not fields.has(key):
        return None
    matrix = fields.array(key, (size, size), allow_nan=True)
    undetermined = np.isnan(np.diagonal(matrix))
    if (np.isnan(matrix) != (undetermined[:, None] | undetermined)).any() or (key != "full" and undetermined.any()):
        raise fields.problem(key, "has a null among numbers", _UNCHANGED)
    determined = np.ix_(~undetermined, ~undetermined)
    matrix[determined] = checked_covariance(fields, key, matrix[determined])
    return matrix


def _velocity(fields: Fields) -> RingVelocity:
    return RingVelocity(
        center_m_s=fields.vector("center_m_s", 3),
        rate_rad_s=fields.vector("rate_rad_s", 3),
        covariance=checked_covariance(fields, "covariance", fields.array("covariance", (5, 5))),
    )


def _measurement(fields: Fields) -> RingMeasurement:
    if fields.texts("parameters") != MEASURED_PARAMETERS:
        raise fields.problem("parameters", f"must be {', '.join(MEASURED_PARAMETERS)}", _UNCHANGED)
    point, nuisance = fields.fields("linearized_at"), fields.texts("nuisance_parameters")
    if "" in nuisance or len(set(nuisance)) < len(nuisance):
        raise fields.problem("nuisance_parameters", "has an empty name, or one that occurs twice", _UNCHANGED)
    square_root = fields.array("square_root", (None, len(MEASURED_PARAMETERS) + len(nuisance) + 1))
    if np.tril(square_root, -1).any():
        raise fields.problem("square_root", "has a number below its diagonal, must be upper-trapezoidal", _UNCHANGED)
    return RingMeasurement(
        linearized_at=LinearizationPoint(
            center_m=point.vector("center_m", 3),
            normal=point.unit_vector("normal"),
            radius_inner_m=point.number("radius_inner_m", missing=math.nan),
            radius_outer_m=point.number("radius_outer_m", missing=math.nan),
            velocity_m_s=point.vector("velocity_m_s", 3),
            rate_rad_s=point.vector("rate_rad_s", 3),
        ),
        nuisance_parameters=nuisance,
        square_root=square_root,
        degrees_of_freedom=fields.integer("degrees_of_freedom"),
        chi2=fields.number("chi2", least=0),
        camera_motion=cast(Literal["none", "robot_poses"], fields.choice("camera_motion", ("none", "robot_poses"))),
    )


def _plane_evidence(fields: Fields) -> PlaneEvidence:
    parameters = fields.texts("parameters")
    if "" in parameters or len(set(parameters)) < len(parameters):
        raise fields.problem("parameters", "has an empty name, or one that occurs twice", _UNCHANGED)
    return PlaneEvidence(
        parameters=parameters,
        rows=fields.array("rows", (None, len(parameters) + 1)),
        normal=fields.unit_vector("normal"),
        place_m=fields.vector("place_m", 3),
    )


def _priors(fields: Fields) -> Priors:
    rig = fields.fields("rig")
    return Priors(
        assumptions=Assumptions(
            motion=motion_prior(fields),
            ring_tolerance_m=fields.number("ring_tolerance_m", least=0),
            stability=rig_stability(rig.fields("stability")),
        ),
        radius=_radius_prior(fields.fields("radius")) if fields.has("radius") else None,
        rig_covariance=rig.choice("covariance", ("rig.yaml", "none")) == "rig.yaml",
        moved_planes=_moved_planes(rig.fields("moved")) if rig.has("moved") else {},
        regularization=fields.array("regularization", (None, len(MEASURED_PARAMETERS) + 1))
        if fields.has("regularization")
        else None,
    )


def _moved_planes(fields: Fields) -> dict[str, PlaneCorrection]:
    corrections = {}
    for name in fields.values:
        each = fields.fields(name)
        covariance = checked_covariance(each, "covariance", each.array("covariance", (3, 3)))
        corrections[name] = PlaneCorrection(change=each.vector("change", 3), covariance=covariance)
    return corrections


def motion_prior(fields: Fields) -> MotionPrior | None:
    """The prior in the key `motion`; None if the target is assumed to be still."""
    if isinstance(fields.raw("motion"), str):
        fields.choice("motion", (STILL,))
        return None
    motion = fields.fields("motion")
    return MotionPrior(
        speed_sd_m_s=motion.number("speed_sd_m_s", least=0), rate_sd_rad_s=motion.number("rate_sd_rad_s", least=0)
    )


def _radius_prior(fields: Fields) -> RadiusPrior:
    inner_m, outer_m = fields.number("inner_m", missing=math.nan), fields.number("outer_m", missing=math.nan)
    sd_m = fields.number("sd_m", least=0)
    return RadiusPrior(
        inner_m=inner_m,
        outer_m=outer_m,
        inner_sd_m=fields.number("inner_sd_m", missing=sd_m if inner_m == inner_m else math.nan),
        outer_sd_m=fields.number("outer_sd_m", missing=sd_m if outer_m == outer_m else math.nan),
        source=fields.text("source"),
    )


def _lasers(fields: Fields) -> dict[str, LaserState]:
    """States by laser; an unknown state is ignored."""
    states = {name: fields.text(name) for name in fields.values}
    return {name: LaserState(state) for name, state in states.items() if state in tuple(LaserState)}


def _numbers(fields: Fields, key: str, least: float = -math.inf, most: float = math.inf) -> dict[str, float]:
    """Numbers by name, NaN for null; empty if the key is missing or null."""
    if not fields.has(key):
        return {}
    values = fields.fields(key)
    return {name: values.number(name, least, most) if values.has(name) else math.nan for name in values.values}


def _vector(fields: Fields, key: str) -> Float64[Array, "xyz=3"]:
    return fields.vector(key, 3) if fields.has(key) else np.full(3, np.nan)
