"""The motion of a camera that a robot carries, from the robot's poses (ringpose-method(7), sections 8 and 10)."""

from dataclasses import dataclass, replace
from functools import lru_cache
from math import isfinite
from typing import NamedTuple

import numpy as np

from ringpose.geometry.ring import GENERATORS, IDENTITY, CameraDisplacements, rotation_by
from ringpose.geometry.rotations import SMALL_ANGLE, rotation_vectors, skew
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.options import PoseFrame
from ringpose.types.rig import MOUNT_PARAMETERS, Mount, RobotPoses

MAX_GAP_S = 0.25
"""Longest time between two poses of the robot within which its motion is interpolated."""

MAX_AHEAD_S = 10.0
"""Longest time after its last pose for which a robot is taken to go on at its last twist."""

MAX_SPEED_M_S, MAX_RATE_RAD_S = 10.0, 20.0
"""Highest speeds of a tool that a robot can have; what is faster is an error in the poses or in their stamps."""


class CameraState(NamedTuple):
    """Where the camera is at one instant and how it moves, in the base frame."""

    rotation: Float64[Array, "3 3"]
    """Rotation from camera to base."""
    origin_m: Float64[Array, "xyz=3"]
    velocity_m_s: Float64[Array, "xyz=3"]
    rate_rad_s: Float64[Array, "xyz=3"]
    displacement_root: Float64[Array, "6 error"]
    """What independent errors of unit variance move the camera by: rotation vector (rad), translation (m).

    The first are those of `MOUNT_PARAMETERS`, zero but for the delay if the mount has a `pose_root`, whose errors
    follow; else those of the robot's poses do.
    """

    @property
    def base_from_camera(self) -> Float64[Array, "4 4"]:
        """The camera's pose in the base frame."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.origin_m
        return matrix


class ToolStates(NamedTuple):
    """Where the tool is at some instants and how it moves, in the base frame."""

    rotation: Float64[Array, "*instant 3 3"]
    position_m: Float64[Array, "*instant xyz=3"]
    velocity_m_s: Float64[Array, "*instant xyz=3"]
    rate_rad_s: Float64[Array, "*instant xyz=3"]


class _Intervals(NamedTuple):
    """The poses of the robot before and after some instants."""

    time_s: Float64[Array, "instant"]
    """The instants in the robot's time."""
    after: Int64[Array, "instant"]
    """Indices of the poses that end the intervals."""
    length_s: Float64[Array, "instant"]
    turn_rad: Float64[Array, "instant 3"]
    """Rotation vector of the tool from one pose to the other, tool frame."""
    shift_m: Float64[Array, "instant 3"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraMotion:
    """Interpolates the pose of a camera that a robot carries; one that stands beside the robot is at rest."""

    poses: RobotPoses
    mount: Mount

    @property
    def is_at_rest(self) -> bool:
        """Whether the camera stands in the robot's base: it then needs no poses of the robot."""
        return self.mount.carrier is PoseFrame.BASE

    def at(self, stamp_s: float) -> CameraState | None:
        """The camera at a stamp of its own clock; None if the robot's poses do not cover it."""
        mount = self.mount
        in_carrier = mount.carrier_from_camera
        if self.is_at_rest:
            root = np.pad(mount.root, ((0, 0), (0, len(MOUNT_PARAMETERS) - 6)))
            return CameraState(in_carrier[:3, :3], in_carrier[:3, 3], np.zeros(3), np.zeros(3), root)
        tool = self.tool_at(stamp_s)
        if tool is None:
            return None
        lever_m = tool.rotation @ in_carrier[:3, 3]
        velocity = tool.velocity_m_s + np.cross(tool.rate_rad_s, lever_m)
        turn = _block(tool.rotation)
        by_delay = mount.delay_sd_s * np.append(tool.rate_rad_s, velocity)
        by_mount, by_robot = turn @ mount.root, _seen_from(lever_m) @ turn * _robot_sds(mount)
        if mount.pose_root is not None:
            by_mount, by_robot = np.zeros((6, 6)), turn @ mount.pose_root
        root = np.column_stack([by_mount, by_delay, by_robot])
        return CameraState(
            rotation=tool.rotation @ in_carrier[:3, :3],
            origin_m=tool.position_m + lever_m,
            velocity_m_s=velocity,
            rate_rad_s=tool.rate_rad_s,
            displacement_root=root,
        )

    def in_frame(
        self, frame: PoseFrame, stamp_s: float
    ) -> tuple[Float64[Array, "4 4"], Float64[Array, "6 error"]] | None:
        """The camera's pose in the frame of tool or base, and the square root R of its covariance R R^T there.

        None if it needs a pose of the robot at this stamp and there is none.
        """
        if frame is self.mount.carrier:
            return self.mount.carrier_from_camera, self.mount.root
        if frame is PoseFrame.BASE:
            state = self.at(stamp_s)
            return None if state is None else (state.base_from_camera, state.displacement_root)
        tool = self.tool_at(stamp_s)
        if tool is None:
            return None
        back, base_from_camera = tool.rotation.T, self.mount.carrier_from_camera
        lever_m = base_from_camera[:3, 3] - tool.position_m
        matrix, turn = np.eye(4), _block(back)
        matrix[:3, :3], matrix[:3, 3] = back @ base_from_camera[:3, :3], back @ lever_m
        # a tool that is elsewhere moves a camera at rest the other way
        velocity = tool.velocity_m_s + np.cross(tool.rate_rad_s, lever_m)
        by_delay = -self.mount.delay_sd_s * (turn @ np.append(tool.rate_rad_s, velocity))
        if self.mount.pose_root is not None:
            return matrix, np.column_stack([by_delay, self.mount.pose_root])
        by_robot = -_seen_from(matrix[:3, 3]) * _robot_sds(self.mount)
        return matrix, np.column_stack([turn @ self.mount.root, by_delay, by_robot])

    def tool_at(self, stamp_s: float) -> ToolStates | None:
        """The tool at a stamp of the camera's clock; None if the robot's poses do not cover it."""
        tools, is_covered = self.tools_at(np.array([stamp_s]))
        return ToolStates(*(each[0] for each in tools)) if is_covered[0] else None

    def tools_at(self, stamp_s: Float64[Array, "instant"]) -> tuple[ToolStates, Bool[Array, "instant"]]:
        """The tool at those stamps that the robot's poses cover, and which these are.

        Between two poses the tool moves at a constant twist: T(s) = T_0 exp(s log(T_0^-1 T_1)) on SE(3).
        """
        poses, around = self.poses, self._intervals(stamp_s)
        is_covered = np.asarray(~self._failures(around).any(axis=0))
        time_s, after, interval_s, turn_rad, shift_m = (each[is_covered] for each in around)
        share = ((time_s - poses.stamp_s[after - 1]) / interval_s)[:, None]
        rotation = poses.rotation[after - 1]
        base_from_tool = rotation @ rotation_by(share * turn_rad)
        moved_m = left_jacobian(share * turn_rad) @ (share * shift_m)[..., None]
        tools = ToolStates(
            base_from_tool,
            poses.position_m[after - 1] + (rotation @ moved_m)[..., 0],
            (base_from_tool @ shift_m[..., None])[..., 0] / interval_s[:, None],
            (base_from_tool @ turn_rad[..., None])[..., 0] / interval_s[:, None],
        )
        return tools, is_covered

    def going_on_until(self, stamp_s: float) -> "CameraMotion":
        """The motion with further poses up to a stamp, as if the robot continued at its last twist.

        Unchanged where the stamp is covered, not finite, or more than `MAX_AHEAD_S` after the last pose.
        """
        poses = self.poses
        if len(poses.stamp_s) < 2:
            return self
        missing_s = stamp_s + self.mount.delay_s - float(poses.stamp_s[-1])
        if not 0.0 < missing_s <= MAX_AHEAD_S:
            return self
        turn_rad, shift_m = (each[0] for each in self._twists(np.array([len(poses.stamp_s) - 1])))
        share = (np.arange(int(missing_s / MAX_GAP_S) + 1) + 1.0)[:, None] * MAX_GAP_S / np.diff(poses.stamp_s[-2:])
        last, position_m = poses.rotation[-1], poses.position_m[-1]
        moved = (left_jacobian(share * turn_rad) @ (share * shift_m)[..., None])[..., 0]
        further = RobotPoses(
            stamp_s=np.append(poses.stamp_s, poses.stamp_s[-1] + MAX_GAP_S * np.arange(1, len(share) + 1)),
            position_m=np.concatenate([poses.position_m, position_m + moved @ last.T]),
            rotation=np.concatenate([poses.rotation, last @ rotation_by(share * turn_rad)]),
        )
        return replace(self, poses=further)

    def why_not_at(self, stamp_s: float) -> str:
        """The reason why `at` returns None for this stamp; empty if it returns a camera."""
        return "" if self.is_at_rest else self._why_no_tool_at(stamp_s)

    def _why_no_tool_at(self, stamp_s: float) -> str:
        stamps_s = self.poses.stamp_s
        if not isfinite(stamp_s):
            return "its time is unknown"
        if len(stamps_s) < 2:
            return "there are no poses of the robot yet"
        around = self._intervals(np.array([stamp_s]))
        failures = self._failures(around)[:, 0]
        if not failures.any():
            return ""
        time_s, gap_s = float(around.time_s[0]), float(around.length_s[0])
        speed_m_s, rate_rad_s = (float(np.linalg.norm(each)) / gap_s for each in (around.shift_m, around.turn_rad))
        return (
            f"the robot's poses begin {stamps_s[0] - time_s:.3g} s after it",
            f"the robot's poses end {time_s - stamps_s[-1]:.3g} s before it",
            f"the robot's poses next to it are {gap_s:.3g} s apart, and at most {MAX_GAP_S:g} s are interpolated",
            f"the robot's poses next to it jump: {speed_m_s:.3g} m/s and {rate_rad_s:.3g} rad/s",
        )[int(failures.argmax())]

    def _intervals(self, stamp_s: Float64[Array, "instant"]) -> _Intervals:
        """Those around stamps of the camera's clock; none of finite length with fewer than two poses."""
        time_s = stamp_s + self.mount.delay_s
        stamps_s = self.poses.stamp_s
        if len(stamps_s) < 2:
            missing = np.full((len(time_s), 3), np.nan)
            return _Intervals(time_s, np.zeros(len(time_s), np.int64), missing[:, 0], missing, missing)
        after = np.clip(np.searchsorted(stamps_s, time_s, side="right"), 1, len(stamps_s) - 1)
        return _Intervals(time_s, after, stamps_s[after] - stamps_s[after - 1], *self._twists(after))

    def _failures(self, around: _Intervals) -> Bool[Array, "reason=4 instant"]:
        """Whether the poses begin after an instant, end before it, are too far apart around it, or jump there.

        Instants that are not finite, and those of a robot with fewer than two poses, fail in all.
        """
        known = np.isfinite(around.time_s) & np.isfinite(around.length_s)
        stamps_s = self.poses.stamp_s
        if not known.any():
            return np.ones((4, len(known)), dtype=bool)
        jumps = np.zeros(len(known), dtype=bool)
        for steps, fastest in ((around.shift_m, MAX_SPEED_M_S), (around.turn_rad, MAX_RATE_RAD_S)):
            jumps |= (steps * steps).sum(axis=1) > (fastest * around.length_s) ** 2
        too_far = around.length_s > MAX_GAP_S
        return ~known | np.array([around.time_s < stamps_s[0], around.time_s > stamps_s[-1], too_far, jumps])

    def _twists(self, after: Int64[Array, "pose"]) -> tuple[Float64[Array, "pose 3"], Float64[Array, "pose 3"]]:
        """Rotation vector (rad) and translation (m) of the tool from the poses before to poses `after`, tool frame."""
        rotation, position_m = self.poses.rotation, self.poses.position_m
        back = rotation[after - 1].swapaxes(1, 2)
        step_m = back @ (position_m[after] - position_m[after - 1])[..., None]
        return logarithm(back @ rotation[after], step_m[..., 0])

    def displacements(self, reference_s: float, instant_s: Float64[Array, "instant"]) -> CameraDisplacements | None:
        """How the camera is displaced at instants after `reference_s`; None if the robot's poses do not cover them.

        Its errors are the mount's parameters that have a variance (`Mount.uncertain`), in their own units.
        """
        return _displacements(self, reference_s, tuple(instant_s.tolist()))


@lru_cache(maxsize=8)
def _displacements(
    camera: CameraMotion, reference_s: float, instant_s: tuple[float, ...]
) -> CameraDisplacements | None:
    displaced = _displaced(camera, reference_s, instant_s)
    if displaced is None:
        return None
    columns, mount = [np.zeros((len(instant_s), 6, 0))], camera.mount
    for number, sd in enumerate(np.sqrt(np.diag(mount.covariance)).tolist()):
        if sd == 0.0:
            continue
        # by differences of one standard deviation: between two poses of the robot its twist is constant, so that the
        # derivative with respect to the delay would be zero there
        ends = []
        for offset in (sd, -sd):
            error = offset * np.eye(len(MOUNT_PARAMETERS))[number]
            matrix = mount.carrier_from_camera.copy()
            matrix[:3, :3], matrix[:3, 3] = rotation_by(error[:3]) @ matrix[:3, :3], matrix[:3, 3] + error[3:6]
            with_error = replace(mount, carrier_from_camera=matrix, delay_s=mount.delay_s + float(error[6]))
            ends.append(_displaced(replace(camera, mount=with_error), reference_s, instant_s))
        ahead, behind = ends
        if ahead is None or behind is None:
            return None
        turned = ahead[0] @ behind[0].swapaxes(-1, -2)
        turn = rotation_vectors(turned)
        shift = ahead[1] - (turned @ behind[1][..., None])[..., 0]
        columns.append(np.concatenate([turn, shift], axis=1)[..., None] / (2.0 * sd))
    return CameraDisplacements(*displaced, np.concatenate(columns, axis=-1))


def _displaced(
    camera: CameraMotion, reference_s: float, instant_s: tuple[float, ...]
) -> tuple[Float64[Array, "instant 3 3"], Float64[Array, "instant 3"]] | None:
    """R and t of P = R P_0 + t, from the camera frame at the reference time to that at each instant."""
    stamps_s = reference_s + np.array([0.0, *instant_s])
    if camera.is_at_rest:
        return np.tile(np.eye(3), (len(instant_s), 1, 1)), np.zeros((len(instant_s), 3))
    tools, is_covered = camera.tools_at(stamps_s)
    if not is_covered.all():
        return None
    tool_from_camera = camera.mount.carrier_from_camera
    rotation = tools.rotation @ tool_from_camera[:3, :3]
    origin_m = tools.position_m + tools.rotation @ tool_from_camera[:3, 3]
    back = rotation[1:].swapaxes(1, 2)
    return back @ rotation[0], (back @ (origin_m[0] - origin_m[1:])[..., None])[..., 0]


def _block(rotation: Float64[Array, "3 3"]) -> Float64[Array, "6 6"]:
    """Turns rotation vector and translation."""
    return np.kron(np.eye(2), rotation)


def _seen_from(lever_m: Float64[Array, "xyz=3"]) -> Float64[Array, "6 6"]:
    """Rotation vector and translation of a point at the end of a lever, by those at its beginning: d + w x lever."""
    moved = np.eye(6)
    moved[3:, :3] = -skew(lever_m)
    return moved


def _robot_sds(mount: Mount) -> Float64[Array, "6"]:
    return np.repeat([mount.robot_rotation_sd_rad, mount.robot_translation_sd_m], 3)


def logarithm(
    rotation: Float64[Array, "*shape 3 3"], translation: Float64[Array, "*shape 3"]
) -> tuple[Float64[Array, "*shape 3"], Float64[Array, "*shape 3"]]:
    """The twists (rotation vector, translation) whose exponentials on SE(3) are these transforms."""
    turn = rotation_vectors(rotation)
    return turn, np.linalg.solve(left_jacobian(turn), translation[..., None])[..., 0]


def left_jacobian(turn: Float64[Array, "*shape 3"]) -> Float64[Array, "*shape 3 3"]:
    """V with exp(turn, shift) = (exp(turn), V shift): 1 + (1 - cos a) / a^2 K + (a - sin a) / a^3 K^2."""
    angle = np.sqrt((turn * turn).sum(axis=-1))[..., None, None]
    skew = (turn @ GENERATORS).reshape(*turn.shape, 3)
    small = angle < SMALL_ANGLE
    angle = np.where(small, 1.0, angle)
    first = np.where(small, 0.5, (1.0 - np.cos(angle)) / angle**2)
    second = np.where(small, 1.0 / 6.0, (angle - np.sin(angle)) / angle**3)
    jacobian: Float64[Array, "*shape 3 3"] = IDENTITY + first * skew + second * (skew @ skew)
    return jacobian
