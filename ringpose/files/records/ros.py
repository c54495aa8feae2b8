"""Poses and tracks as messages of ROS 2, in JSON."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import isfinite, nan, pi
from typing import Annotated, Any

import numpy as np

from ringpose.files.records.codec import definition_of
from ringpose.geometry.ring import normal_and_center
from ringpose.geometry.rotations import tilt_basis
from ringpose.types.arrays import Array, Float64
from ringpose.types.pose import PoseFlag, PoseLine, RingPose, RingVelocity, Status
from ringpose.types.record import Key, Presence
from ringpose.types.track import FusionStatus, TrackLine, Validity


@dataclass(frozen=True, slots=True, kw_only=True)
class RosTime:
    """builtin_interfaces/Time."""

    sec: Annotated[int, Key("Whole seconds.")]
    nanosec: Annotated[int, Key("Nanoseconds.", least=0)]


@dataclass(frozen=True, slots=True, kw_only=True)
class RosHeader:
    """std_msgs/Header."""

    stamp: Annotated[RosTime, Key("When pose or velocity hold.")]
    frame_id: Annotated[str, Key("`camera`, `tool` or `base`, or the name that `--frame-id` gives it.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class RosVector:
    """geometry_msgs/Point or Vector3."""

    x: Annotated[float, Key()]
    y: Annotated[float, Key()]
    z: Annotated[float, Key()]


@dataclass(frozen=True, slots=True, kw_only=True)
class RosQuaternion:
    """geometry_msgs/Quaternion."""

    x: Annotated[float, Key()]
    y: Annotated[float, Key()]
    z: Annotated[float, Key()]
    w: Annotated[float, Key()]


@dataclass(frozen=True, slots=True, kw_only=True)
class RosPose:
    """geometry_msgs/Pose."""

    position: Annotated[RosVector, Key("The ring's centre.")]
    orientation: Annotated[RosQuaternion, Key("z is the ring's normal, x points towards the grasp point.")]


@dataclass(frozen=True, slots=True, kw_only=True)
class RosTwist:
    """geometry_msgs/Twist."""

    linear: Annotated[RosVector, Key("Velocity of the ring's centre.")]
    angular: Annotated[RosVector, Key("Angular velocity across the normal.")]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RosPoseWithCovariance:
    """geometry_msgs/PoseWithCovariance."""

    pose: Annotated[RosPose, Key("The pose.")]
    covariance: Annotated[Float64[Array, "element=36"], Key("6 x 6, row by row: position, rotation about fixed axes.")]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RosTwistWithCovariance:
    """geometry_msgs/TwistWithCovariance."""

    twist: Annotated[RosTwist, Key("The velocities.")]
    covariance: Annotated[Float64[Array, "element=36"], Key("6 x 6, row by row: linear, angular.")]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RosPoseStamped:
    """geometry_msgs/PoseWithCovarianceStamped."""

    header: Annotated[RosHeader, Key("Stamp and frame.")]
    pose: Annotated[RosPoseWithCovariance, Key("The pose with its covariance.")]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RosTwistStamped:
    """geometry_msgs/TwistWithCovarianceStamped."""

    header: Annotated[RosHeader, Key("Stamp and frame.")]
    twist: Annotated[RosTwistWithCovariance, Key("The velocities with their covariance.")]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RosLine:
    """A line of `pose` or `track` with `--format ros`."""

    pose: Annotated[
        RosPoseStamped | None,
        Key("geometry_msgs/PoseWithCovarianceStamped; null if the centre or the normal is not determined."),
    ]
    twist: Annotated[
        RosTwistStamped | None,
        Key("geometry_msgs/TwistWithCovarianceStamped; null without a velocity or a normal."),
    ]
    status: Annotated[Status, Key("As in a pose line.")]
    flags: Annotated[PoseFlag, Key("As in a pose line.")]
    reason: Annotated[str | None, Key("As in a pose or track line.")]
    shot: Annotated[str | None, Key("Of a pose line: its shot.", presence=Presence.IF_KNOWN)] = None
    validity: Annotated[Validity | None, Key("As in a track line.", presence=Presence.IF_KNOWN)] = None
    fusion_status: Annotated[FusionStatus | None, Key("As in a track line.", presence=Presence.IF_KNOWN)] = None
    latency_s: Annotated[float | None, Key("As in a track line.", least=0.0, presence=Presence.IF_KNOWN)] = None
    lines_skipped: Annotated[
        int | None, Key("As in a pose line; with `--newest`.", least=0, presence=Presence.IF_KNOWN)
    ] = None


TURN_VARIANCE_RAD2 = pi**2 / 3.0
"""Variance of the rotation about the ring's axis in messages of ROS: that of an angle of which nothing is known."""

SPIN_VARIANCE_RAD2_S2 = pi**2
"""Variance of the angular velocity about the ring's axis, which is not observable."""


def ros_messages(line: PoseLine | TrackLine, frame_id: str | None = None) -> dict[str, Any]:
    """A line as geometry_msgs/PoseWithCovarianceStamped and geometry_msgs/TwistWithCovarianceStamped.

    Null where the centre or the normal is not determined, the twist also without a velocity. How far the line may be
    trusted stands beside the messages: `status`, `flags`, `reason`, of a track also `validity`, `fusion_status` and
    `latency_s`. `frame_id` names the line's frame.
    """
    frame_id = frame_id or line.frame
    beside: dict[str, Any]
    if isinstance(line, TrackLine):
        stamp_s = line.stamp_s
        beside = {"validity": line.validity, "fusion_status": line.fusion_status}
        if isfinite(line.latency_s):
            beside["latency_s"] = line.latency_s
        grasp_m = np.full(3, nan) if line.grasp is None else line.grasp.point_m
    else:
        stamp_s = line.pose_stamp_s if isfinite(line.pose_stamp_s) else line.stamp_s
        beside = {"shot": line.shot}
        grasp_m = np.full(3, nan) if line.pose is None else line.pose.grasp_m
    messages = RosLine(
        pose=ros_pose(stamp_s, frame_id, line.pose, grasp_m),
        twist=ros_twist(stamp_s, frame_id, line.pose, line.velocity),
        status=line.status,
        flags=line.flags,
        reason=line.reason or None,
        **beside,
    )
    return definition_of(RosLine).write(messages)


def ros_pose(
    stamp_s: float, frame: str, pose: RingPose | None, grasp_m: Float64[Array, "xyz=3"]
) -> RosPoseStamped | None:
    """PoseWithCovarianceStamped of the ring's frame; None if its centre or normal is not determined.

    Origin: the ring's centre; z: the normal; x: towards the grasp point. The rotation about z is a convention, not a
    measurement: its variance is `TURN_VARIANCE_RAD2`.
    """
    if pose is None or pose.covariance is None or not np.isfinite(pose.covariance[:5, :5]).all():
        return None
    normal, center_m = pose.normal, pose.center_m
    outward = (grasp_m - center_m) if np.isfinite(grasp_m).all() else tilt_basis(normal)[0]
    outward = outward - (outward @ normal) * normal
    x = outward / np.linalg.norm(outward)
    orientation = quaternion_xyzw(np.stack([x, np.cross(normal, x), normal], axis=1))
    # a tilt dn is the rotation n x dn about fixed axes
    normal_wrt, center_wrt = normal_and_center(normal, center_m)
    rows = np.concatenate([center_wrt, np.cross(normal, normal_wrt, axisb=0, axisc=0)])
    covariance = rows @ pose.covariance[:5, :5] @ rows.T
    covariance[3:, 3:] += TURN_VARIANCE_RAD2 * np.outer(normal, normal)
    pose_in_frame = RosPose(
        position=RosVector(**_named("xyz", center_m)), orientation=RosQuaternion(**_named("xyzw", orientation))
    )
    return RosPoseStamped(
        header=ros_header(stamp_s, frame),
        pose=RosPoseWithCovariance(pose=pose_in_frame, covariance=covariance.ravel()),
    )


def ros_twist(
    stamp_s: float, frame: str, pose: RingPose | None, velocity: RingVelocity | None
) -> RosTwistStamped | None:
    """TwistWithCovarianceStamped: velocity of the ring's centre, and the angular velocity across its normal.

    The angular velocity about the normal is not observable: it is 0 with the variance `SPIN_VARIANCE_RAD2_S2`.
    """
    if pose is None or velocity is None or not np.isfinite(pose.normal).all():
        return None
    rows = np.zeros((6, 5))
    rows[:3, :3], rows[3:, 3:] = np.eye(3), tilt_basis(pose.normal).T
    covariance = rows @ velocity.covariance @ rows.T
    covariance[3:, 3:] += SPIN_VARIANCE_RAD2_S2 * np.outer(pose.normal, pose.normal)
    twist = RosTwist(
        linear=RosVector(**_named("xyz", velocity.center_m_s)), angular=RosVector(**_named("xyz", velocity.rate_rad_s))
    )
    return RosTwistStamped(
        header=ros_header(stamp_s, frame), twist=RosTwistWithCovariance(twist=twist, covariance=covariance.ravel())
    )


def ros_header(stamp_s: float, frame: str) -> RosHeader:
    """std_msgs/Header; the stamp in whole seconds and nanoseconds."""
    seconds = int(stamp_s // 1.0) if isfinite(stamp_s) else 0
    nanoseconds = min(round((stamp_s - seconds) * 1e9), 999_999_999) if isfinite(stamp_s) else 0
    return RosHeader(stamp=RosTime(sec=seconds, nanosec=nanoseconds), frame_id=str(frame))


def quaternion_xyzw(rotation: Float64[Array, "3 3"]) -> Float64[Array, "xyzw=4"]:
    """Unit quaternion of a rotation matrix, w not negative; by the largest component (Shepperd 1978)."""
    r = rotation
    squares = np.array(
        [r[0, 0] - r[1, 1] - r[2, 2], r[1, 1] - r[0, 0] - r[2, 2], r[2, 2] - r[0, 0] - r[1, 1], r.trace()]
    )
    columns = np.array(
        [
            [1 + squares[0], r[0, 1] + r[1, 0], r[0, 2] + r[2, 0], r[2, 1] - r[1, 2]],
            [r[0, 1] + r[1, 0], 1 + squares[1], r[1, 2] + r[2, 1], r[0, 2] - r[2, 0]],
            [r[0, 2] + r[2, 0], r[1, 2] + r[2, 1], 1 + squares[2], r[1, 0] - r[0, 1]],
            [r[2, 1] - r[1, 2], r[0, 2] - r[2, 0], r[1, 0] - r[0, 1], 1 + squares[3]],
        ]
    )
    chosen = columns[int(np.argmax(squares))]
    unit: Float64[Array, "xyzw=4"] = chosen / np.linalg.norm(chosen)
    return -unit if unit[3] < 0 else unit


def _named(names: str, values: Float64[Array, "n"]) -> Mapping[str, float]:
    return dict(zip(names, values.tolist(), strict=True))
