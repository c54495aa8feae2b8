"""A robot that moves while the board is seen: its pose at the stamp of a view, and the offset of the two clocks.

The robot's stamp that belongs to the camera's stamp t is t + delay (ringpose-method(7), section 13).
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from ringpose.calibrate.mount.closed_form import MIN_TURN_RAD, Transform, moving_from_fixed
from ringpose.errors import DataError
from ringpose.geometry.camera_motion import CameraMotion, ToolStates, left_jacobian, logarithm
from ringpose.geometry.ring import rotation_by
from ringpose.geometry.rotations import rotation_sine
from ringpose.types.arrays import Array, Bool, Float64
from ringpose.types.rig import Mount, RobotPoses

MAX_DELAY_S = 0.5
"""Largest offset of the clocks that is expected: that of computers without a common time, and of slow interfaces."""

DELAY_PRIOR_S = MAX_DELAY_S / np.sqrt(3.0)
"""Standard deviation of an offset of which only these bounds are known."""

MIN_SPAN_S = 0.1
"""Half of the time over which a velocity is taken: with less the noise of the poses counts, with more the velocity has
changed, which makes the delay less accurate."""

_STEP_S = 0.02
"""Distance of the delays that are tried. A robot that turns at 1 rad/s turns by 0.6 degrees in half of it, which the
adjustment corrects."""

_FAR_S, _FAR_STEP_S = 10.0, 0.1
"""Delays beyond the expected ones that are tried, to name them."""

_MAX_TURN_RAD = np.radians(170.0)
"""Rotation between two views up to which its axis is known."""

_MAX_VIEWS = 40
"""Views by which delays are tried."""

_AS_GOOD = 1.2
"""Factor of the misfit up to which a delay nearer to zero is preferred: a robot that hardly moves has no best one."""

_CLEARLY_BETTER = 2.0
"""Factor by which a delay beyond the expected ones fits better, so that it is the right one."""


class ToolInstant(NamedTuple):
    """The tool at one instant."""

    base_from_tool: Transform
    twist: Float64[Array, "6"]
    """Rate (rad/s) and velocity (m/s) in the tool frame."""
    interpolation_sd: Float64[Array, "6"]
    """What the interpolation between the robot's poses may be wrong by: rotation vector, translation, tool frame."""


@dataclass(frozen=True, kw_only=True, eq=False)
class ToolMotion:
    """The tool by its poses at their stamps."""

    poses: RobotPoses
    locations: tuple[str, ...] = ()
    """File and line of each pose, for messages."""

    @cached_property
    def _camera(self) -> CameraMotion:
        """The motion of a camera in the tool's origin, whose clock is the robot's."""
        return CameraMotion(poses=self.poses, mount=Mount(carrier_from_camera=np.eye(4), root=np.zeros((6, 6))))

    @cached_property
    def span_s(self) -> float:
        """Time over which velocities are taken: a whole number of intervals, at the ends of which errors are alike."""
        interval_s = float(np.median(np.diff(self.poses.stamp_s)))
        return interval_s * float(np.ceil(MIN_SPAN_S / max(interval_s, 1e-9)))

    def tools_at(self, stamp_s: Float64[Array, "instant"]) -> tuple[ToolStates, Bool[Array, "instant"]]:
        """The tool at those stamps of the robot that its poses cover, and which these are."""
        return self._camera.tools_at(stamp_s)

    def at(self, stamp_s: float) -> ToolInstant | None:
        """The tool at a stamp of the robot; None if its poses do not cover it.

        A constant twist between two poses that are h apart misses an acceleration a by s (1 - s) h^2 a / 2 at the share
        s of the interval, which is corrected, and a change b of the acceleration by 2 s - 1 thirds of h b more (the
        remainder of a linear interpolation), which is the uncertainty of the result.
        """
        span_s = self.span_s
        tools, is_covered = self.tools_at(stamp_s + span_s * np.arange(-2, 3))
        if not is_covered.all():
            return None
        poses = [*map(Transform, tools.rotation, tools.position_m)]
        twists = twists_between(poses[:-1], poses[1:]) / span_s
        acceleration = (twists[2] - twists[1]) / span_s
        change = (twists[3] - twists[2] - twists[1] + twists[0]) / (2.0 * span_s**2)
        stamps_s = self.poses.stamp_s
        after = min(max(int(np.searchsorted(stamps_s, stamp_s, side="right")), 1), len(stamps_s) - 1)
        interval_s = float(stamps_s[after] - stamps_s[after - 1])
        share = float(np.clip((stamp_s - stamps_s[after - 1]) / interval_s, 0.0, 1.0))
        missed = 0.5 * share * (1.0 - share) * interval_s**2
        return ToolInstant(
            moved(poses[2], -missed * acceleration),
            (twists[1] + twists[2]) / 2.0,
            np.abs(missed * (2.0 * share - 1.0) / 3.0 * interval_s * change),
        )

    def turned(self, rotations: Sequence[Float64[Array, "3 3"]]) -> "ToolMotion":
        """With other rotations of the same poses."""
        return ToolMotion(poses=replace(self.poses, rotation=np.array(rotations)), locations=self.locations)

    def why_not_at(self, stamp_s: float) -> str:
        """The reason why `at` returns None for this stamp of the robot."""
        span_s = self.span_s
        reasons = (self._camera.why_not_at(stamp_s + number * span_s) for number in (0, -2, -1, 1, 2))
        return next(filter(None, reasons), "")

    def location_at(self, stamp_s: float) -> str:
        """File and line of the pose nearest to a stamp of the robot."""
        return self.locations[int(np.argmin(np.abs(self.poses.stamp_s - stamp_s)))] if self.locations else ""


def moved(pose: Transform, twist: Float64[Array, "6"]) -> Transform:
    """The pose times the exponential of a twist (rotation vector, translation) in its own frame."""
    turn_rad = twist[:3]
    return pose.after(Transform(rotation_by(turn_rad), left_jacobian(turn_rad) @ twist[3:]))


def twists_between(first: Sequence[Transform], second: Sequence[Transform]) -> Float64[Array, "pair 6"]:
    """The twists from poses to the next ones, in the tool frame."""
    back = np.array([pose.rotation.T for pose in first])
    step_m = np.array([to.translation_m - at.translation_m for at, to in zip(first, second, strict=True)])
    turned = back @ np.array([pose.rotation for pose in second])
    return np.concatenate(logarithm(turned, (back @ step_m[..., None])[..., 0]), axis=1)


class CoarseDelay(NamedTuple):
    """The delay of those tried by which robot and camera have the same motions between views."""

    delay_s: float
    misfit_rad: float
    """Median difference of the motions; infinite if the robot's poses cover too few views at all delays."""


def coarse_delay(
    stamps_s: Sequence[float], boards: Sequence[Transform], motion: ToolMotion, eye_to_hand: bool
) -> CoarseDelay:
    """The delay within the expected ones with the least misfit; one nearer to zero if it is nearly as good.

    Whatever the mount, a motion of the robot and that of the board in the camera have one angle and one shift along
    their axis (screw congruence, Chen 1991). The result is accurate to the motion within a hundredth of a second.
    """
    expected = np.arange(-MAX_DELAY_S, MAX_DELAY_S + _STEP_S / 2, _STEP_S)
    misfit = _misfits(expected, stamps_s, boards, motion, eye_to_hand)
    as_good = expected[misfit <= _AS_GOOD * misfit.min()]
    return CoarseDelay(float(as_good[int(np.argmin(np.abs(as_good)))]), float(misfit.min()))


def check_clocks(
    coarse: CoarseDelay, stamps_s: Sequence[float], boards: Sequence[Transform], motion: ToolMotion, eye_to_hand: bool
) -> None:
    """Raise DataError if the delay is not an expected one."""
    if not _are_clear(_screws(*(np.array([board[part] for board in boards]) for part in (0, 1)))[0]).any():
        return  # too little is turned for a mount, and for a delay
    far = np.arange(MAX_DELAY_S + _STEP_S, _FAR_S, _FAR_STEP_S)
    beyond = np.concatenate([-far, far])
    misfit = _misfits(beyond, stamps_s, boards, motion, eye_to_hand)
    usual = np.median(misfit[np.isfinite(misfit)]) if np.isfinite(misfit).any() else np.inf
    if misfit.min() < min(coarse.misfit_rad, usual) / _CLEARLY_BETTER:
        finding = (
            "the robot's poses fit the views when the robot's stamps are those of the camera "
            f"{beyond[int(np.argmin(misfit))]:+.1f} s, and offsets up to {MAX_DELAY_S:g} s are estimated"
        )
        remedy = "likely the clocks are not synchronised: use NTP, or correct the robot's stamps by this"
        raise DataError("", finding, remedy)
    if not np.isfinite(coarse.misfit_rad):
        raise DataError("", *_why_apart(stamps_s, motion))


def _misfits(
    delays_s: Float64[Array, "delay"], stamps_s: Sequence[float], boards: Sequence[Transform], motion: ToolMotion,
    eye_to_hand: bool,
) -> Float64[Array, "delay"]:  # fmt: skip
    """Median differences (rad, shifts by the board's distance) of motions; infinite if under half are covered."""
    chosen = np.unique(np.linspace(0, len(stamps_s) - 1, min(len(stamps_s), _MAX_VIEWS)).astype(int)).tolist()
    stamps_s, boards = [stamps_s[index] for index in chosen], [boards[index] for index in chosen]
    tools, is_covered = motion.tools_at((delays_s[:, None] + stamps_s).ravel())
    reached = moving_from_fixed(Transform(tools.rotation, tools.position_m), eye_to_hand)
    index = (np.cumsum(is_covered) - 1).reshape(len(delays_s), -1)
    is_covered = is_covered.reshape(index.shape)
    turned, place_m = (np.array([board[part] for board in boards]) for part in (0, 1))
    misfit = np.full(len(delays_s), np.inf)
    for views in np.unique(is_covered, axis=0):
        if views.sum() < max(3, (len(stamps_s) + 1) // 2):
            continue
        seen, seen_m = _screws(turned[views], place_m[views])
        clear = _are_clear(seen)
        if not clear.any():
            continue
        alike = (is_covered == views).all(axis=1)
        angle, shift_m = _screws(*(each[index[np.ix_(alike, views)]] for each in reached))
        distance_m = float(np.median(np.linalg.norm(place_m[views], axis=1)))
        differences = np.hypot(angle - seen, (shift_m - seen_m) / distance_m)
        misfit[alike] = np.median(differences[:, clear], axis=1)
    return misfit


def _are_clear(angle_rad: Float64[Array, "pair"]) -> Bool[Array, "pair"]:
    """The motions that have an axis."""
    return (angle_rad > MIN_TURN_RAD) & (angle_rad < _MAX_TURN_RAD)


def _screws(
    rotation: Float64[Array, "*delay view 3 3"], place_m: Float64[Array, "*delay view xyz=3"]
) -> tuple[Float64[Array, "*delay pair"], Float64[Array, "*delay pair"]]:
    """Angle, and shift along the axis, of the motion between the poses of each pair."""
    first, second = np.triu_indices(rotation.shape[-3], 1)
    turn = rotation[..., second, :, :] @ rotation[..., first, :, :].swapaxes(-1, -2)
    step_m = place_m[..., second, :] - (turn @ place_m[..., first, :, None])[..., 0]
    across = 2.0 * rotation_sine(turn)
    length = np.linalg.norm(across, axis=-1)  # twice the sine of the angle
    angle = np.arctan2(length, np.trace(turn, axis1=-2, axis2=-1) - 1.0)
    return angle, (across * step_m).sum(axis=-1) / np.maximum(length, 1e-12)


def _why_apart(stamps_s: Sequence[float], motion: ToolMotion) -> tuple[str, str]:
    """Finding and remedy where no expected delay brings poses of the robot to most of the views."""
    poses_s = motion.poses.stamp_s
    first_s, last_s = min(stamps_s), max(stamps_s)
    interval_s = float(np.median(np.diff(poses_s)))
    if poses_s[-1] >= first_s - MAX_DELAY_S and poses_s[0] <= last_s + MAX_DELAY_S:
        reasons = [motion.why_not_at(stamp_s) for stamp_s in stamps_s]
        return f"most views have no pose of the robot: {next(filter(None, reasons), '')}", (
            "give the poses of the whole session, at least ten times a second"
        )
    finding = (
        f"the views are stamped {first_s:.3f} to {last_s:.3f} s, the robot's poses {poses_s[0]:.3f} to "
        f"{poses_s[-1]:.3f} s"
    )
    if interval_s >= 1.0:
        return finding, f"likely the robot's stamps are in milliseconds: its poses are {interval_s:.3g} s apart"
    return finding, "likely the clocks are not synchronised: use NTP, or correct the robot's stamps by their offset"
