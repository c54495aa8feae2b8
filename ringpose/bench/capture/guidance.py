"""From lines about the ring to velocities of the tool, and to the decision to close the gripper.

The gripper is led along the ring's normal: towards the point of the band's middle that is nearest to it, at a distance
that shrinks while it is aligned. It follows the predicted ring at the predicted velocity, and corrects what is left in
proportion. Where no measurement comes, it goes back to the distance from which it has seen the ring first, and waits
there. It closes only by a recent, valid line with protection levels of grasp point and normal, and only if the
probability that the ring will be within the gripper's window, when the fingers meet it, is high enough. At the risk of
a level, 1e-5, the window of a gripper can be smaller than the level of a good track; the probability decides there.
"""

from dataclasses import dataclass, replace
from math import isfinite, isnan, nan

import numpy as np

from ringpose.geometry.ring import rotation_by
from ringpose.geometry.rotations import cross, rotation_vector, tilt_basis
from ringpose.simulate.robot import Pose, Twist, reacted
from ringpose.track.explanations import Gripper
from ringpose.track.lines import capture_probability
from ringpose.types.arrays import Array, Float64
from ringpose.types.capture import FloatingBase
from ringpose.types.options import Method
from ringpose.types.pose import PoseLine, RingPose
from ringpose.types.protection import Protection
from ringpose.types.track import TrackLine, Validity

MAX_AGE_S = 0.5
"""Age of the newest measurement up to which the gripper comes nearer or closes; twice as old, the target may hit it."""

GAIN_PER_S = 1.5
"""Correction of an error per time; with a delay of 0.1 s it is well damped up to three times this value."""

APPROACH_M_S, APPROACH_S, LAST_M_S = 0.1, 2.0, 0.01
"""Speed of the approach from afar, time in which the rest shrinks to a third nearby, and speed at the end."""

ALIGNED_M, ALIGNED_SHARE = 0.005, 0.2
"""Error across the approach, as a length and as a share of what remains, up to which the gripper comes nearer."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GuidedRing:
    """What a line states about the ring, in the base frame, as far as a gripper needs it."""

    stamp_s: float
    """Time at which everything holds."""
    measured_s: float
    """Time of the newest measurement in it."""
    grasp_m: Float64[Array, "xyz=3"]
    normal: Float64[Array, "xyz=3"]
    velocity_m_s: Float64[Array, "xyz=3"]
    """Velocity of the ring at the grasp point."""
    rate_rad_s: Float64[Array, "xyz=3"]
    center_m: Float64[Array, "xyz=3"]
    """NaN if it is not determined."""
    covariance: Float64[Array, "5 5"] | None
    """Of the grasp point and the tilts at `covariance_s`; None if the line states none."""
    covariance_s: float
    growth: Float64[Array, "5 5"]
    """Covariance of the velocity at the grasp point and of the rates, by which the other one grows afterwards."""
    obstacle: str
    """Why the gripper must not close by it; empty if it may."""

    def at(self, time_s: float) -> "GuidedRing":
        """The ring at another time, at its velocity and rates; its covariance stays that of `covariance_s`."""
        since_s = time_s - self.stamp_s
        turn = rotation_by(self.rate_rad_s * since_s)
        moved_m = self.grasp_m + self.velocity_m_s * since_s
        return replace(
            self,
            stamp_s=time_s,
            grasp_m=moved_m,
            normal=turn @ self.normal,
            center_m=moved_m + turn @ (self.center_m - self.grasp_m),
        )

    def earlier(self, by_s: float) -> "GuidedRing":
        """The same with times that count from a later instant."""
        return replace(
            self,
            stamp_s=self.stamp_s - by_s,
            measured_s=self.measured_s - by_s,
            covariance_s=self.covariance_s - by_s,
        )

    def nearest_m(self, point_m: Float64[Array, "xyz=3"]) -> Float64[Array, "xyz=3"]:
        """The point on the middle of the band that is nearest to a point; without a centre, the grasp point."""
        if not isfinite(self.center_m[0]):
            return self.grasp_m
        radius_m = float(np.linalg.norm(self.grasp_m - self.center_m))
        return self.center_m + radius_m * self.outward(point_m)

    def outward(self, point_m: Float64[Array, "xyz=3"]) -> Float64[Array, "xyz=3"]:
        """Unit vector in the ring's plane from the centre towards a point."""
        across = point_m - self.center_m
        across = across - (across @ self.normal) * self.normal
        return across / float(np.linalg.norm(across))

    def covariance_at(self, time_s: float, point_m: Float64[Array, "xyz=3"]) -> Float64[Array, "4 4"]:
        """Covariance of the errors of the band at a point, outward and along the normal, and of the tilts."""
        assert self.covariance is not None
        later_s = max(time_s - self.covariance_s, 0.0)
        wrt = np.zeros((4, 5))
        wrt[0, :3], wrt[1, :3] = self.outward(point_m), self.normal
        wrt[1, 3:] = -tilt_basis(self.normal) @ (point_m - self.grasp_m)  # a tilted plane is elsewhere beside the grasp
        wrt[2:, 3:] = np.eye(2)
        covariance: Float64[Array, "4 4"] = wrt @ (self.covariance + later_s**2 * self.growth) @ wrt.T
        return covariance


def ring_of_track(line: TrackLine) -> GuidedRing | None:
    """The ring of a track in the base frame; None if it has none that could be followed."""
    pose, velocity, grasp, ahead = line.pose, line.velocity, line.grasp, line.next_tick
    if line.validity not in (Validity.VALID, Validity.PREDICTED) or line.frame != "base":
        return None
    if pose is None or velocity is None or grasp is None or ahead is None or not isfinite(pose.normal[0]):
        return None
    growth = np.zeros((5, 5))
    growth[:3, :3], growth[3:, 3:] = grasp.covariance[3:, 3:], velocity.covariance[3:, 3:]
    obstacle = "" if line.validity is Validity.VALID else f"the track is {line.validity}"
    return GuidedRing(
        stamp_s=line.stamp_s,
        measured_s=line.measurement_stamp_s,
        grasp_m=grasp.point_m,
        normal=pose.normal,
        velocity_m_s=grasp.velocity_m_s,
        rate_rad_s=velocity.rate_rad_s,
        center_m=pose.center_m,
        covariance=ahead.covariance,
        covariance_s=ahead.stamp_s,
        growth=growth,
        obstacle=obstacle or _unprotected(line.protection),
    )


def ring_of_pose(line: PoseLine) -> GuidedRing | None:
    """The ring of one shot in the base frame, taken as it is until the next one; None if it has no pose.

    Other methods than `ml` state no levels, and some no covariance: what they report is believed.
    """
    pose = line.pose
    if pose is None or line.frame != "base" or not np.isfinite([*pose.normal, *pose.grasp_m]).all():
        return None
    covariance = _grasp_and_tilts(pose)
    return GuidedRing(
        stamp_s=line.pose_stamp_s,
        measured_s=line.pose_stamp_s,
        grasp_m=pose.grasp_m,
        normal=pose.normal,
        velocity_m_s=np.zeros(3),
        rate_rad_s=np.zeros(3),
        center_m=pose.center_m,
        covariance=covariance,
        covariance_s=line.pose_stamp_s,
        growth=np.zeros((5, 5)),
        obstacle=_unprotected(line.protection) if pose.method == Method.ML else "",
    )


def _grasp_and_tilts(pose: RingPose) -> Float64[Array, "5 5"] | None:
    """Covariance of grasp point and tilts of one shot, without their correlation, which a record does not state."""
    if pose.covariance is None or pose.covariance_grasp_m2 is None:
        return None
    both = np.zeros((5, 5))
    both[:3, :3], both[3:, 3:] = pose.covariance_grasp_m2, pose.covariance[:2, :2]
    return both if np.isfinite(both).all() else None


def _unprotected(levels: Protection | None) -> str:
    """Which of grasp point and normal has no protection level, as an obstacle; empty if both have one."""
    if levels is None:
        return "the line has no protection levels"
    grasp = isfinite(levels.grasp_normal_m) and isfinite(levels.grasp_radial_m)
    without = ([] if grasp else ["grasp point"]) + ([] if isfinite(levels.normal_rad) else ["normal"])
    return f"no protection level of the {' and '.join(without)}" if without else ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Decision:
    """What the robot is to do."""

    twist: Twist = Twist()
    closes: bool = False
    probability: float = nan
    """That the ring will be within the gripper's window when the fingers meet it; NaN if it is not known."""
    why: str = ""
    """Why the gripper does not close."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Guided:
    """What is known of the robot that is guided."""

    gripper: Gripper
    tool_from_gripper: Pose
    """Frame of the gripper: origin in the middle between the fingers, z along its approach, x across the band."""
    delay_s: float
    """Time from a command to its effect."""
    closing_s: float
    """Time from the command to close until the fingers meet the ring."""
    min_probability: float
    base: FloatingBase | None = None
    """The base if it floats freely: lines are in its frame, which turns and moves as the arm does."""
    position_sd_m: float = 0.0
    """Standard deviation of the reported position of the tool along each axis ..."""
    rotation_sd_rad: float = 0.0
    """... and of its orientation about each axis."""


class Guidance:
    """Guides one run; `step` is called at each tick of the controller."""

    def __init__(self, guided: Guided) -> None:
        self._guided = guided
        self._distance_m = nan
        """Wanted distance of the gripper from the band along the normal; NaN until the ring was seen."""
        self._farthest_m = nan
        """The first one, from which the ring was seen."""
        self._last = Twist()
        self._ticks_s: list[float] = []
        self._places_m: list[Float64[Array, "xyz=3"]] = []
        """Where the tool was reported to be at each tick."""

    def step(self, now_s: float, period_s: float, base_from_tool: Pose, ring: GuidedRing | None) -> Decision:
        """The decision at a tick, by the reported pose of the tool and the newest ring."""
        self._ticks_s.append(now_s)
        self._places_m.append(base_from_tool.position_m)
        if ring is None:
            self._last = Twist()
            return Decision(why="no ring is seen")
        guided, effect_s = self._guided, now_s + self._guided.delay_s
        gripper = _moved(base_from_tool, self._last, guided.delay_s) @ guided.tool_from_gripper
        then = ring.at(effect_s)
        band_m = then.nearest_m(gripper.position_m)
        if isnan(self._distance_m):
            self._distance_m = max(float((gripper.position_m - band_m) @ then.normal), 0.0)
            self._farthest_m = self._distance_m
        wanted = _wanted(then, gripper, band_m + self._distance_m * then.normal)
        error_m, turn = wanted.position_m - gripper.position_m, rotation_vector(wanted.rotation @ gripper.rotation.T)
        across_m = float(np.linalg.norm(error_m - (error_m @ then.normal) * then.normal))
        why, age_s = ring.obstacle, now_s - ring.measured_s
        if age_s > MAX_AGE_S:
            why = f"the newest measurement is {age_s:.2f} s old"
        nearer_m_s = 0.0
        if age_s > 2.0 * MAX_AGE_S:
            if self._distance_m >= self._farthest_m:
                self._last = Twist()
                return Decision(why=f"{why}: the gripper has gone back and waits")
            nearer_m_s = -APPROACH_M_S
        elif not why and across_m < ALIGNED_M + ALIGNED_SHARE * self._distance_m:
            nearer_m_s = min(APPROACH_M_S, LAST_M_S + self._distance_m / APPROACH_S, self._distance_m / period_s)
        self._distance_m -= nearer_m_s * period_s
        rate_rad_s = then.rate_rad_s + GAIN_PER_S * turn
        velocity_m_s = then.velocity_m_s + cross(then.rate_rad_s, wanted.position_m - then.grasp_m)
        velocity_m_s = velocity_m_s + GAIN_PER_S * error_m - nearer_m_s * then.normal
        lever_m = base_from_tool.position_m - base_from_tool.at(guided.tool_from_gripper.position_m)
        self._last = Twist(velocity_m_s=velocity_m_s + cross(rate_rad_s, lever_m), rate_rad_s=rate_rad_s)
        if self._distance_m > 0.0:
            return Decision(twist=self._last, why=why or "the gripper is not there yet")
        return self._closing(now_s, base_from_tool, ring, why)

    def _closing(self, now_s: float, base_from_tool: Pose, ring: GuidedRing, why: str) -> Decision:
        """Whether to close, by where gripper and ring will be when the fingers meet it."""
        guided, meets_s = self._guided, now_s + self._guided.closing_s
        tool = _moved(base_from_tool, self._last, guided.closing_s)
        gripper, then = tool @ guided.tool_from_gripper, ring.at(meets_s)
        if not isfinite(then.center_m[0]):
            return Decision(twist=self._last, why=why or "the ring's centre is not determined")
        off = _offsets(then, gripper)
        if then.covariance is None:
            inside = float(np.hypot(*off[:2])) < 0.5 * guided.gripper.radial_m
            inside = inside and float(np.hypot(*off[2:])) < 0.5 * guided.gripper.tilt_rad
            why = why or ("" if inside else "the gripper is off the band")
            return Decision(twist=self._last, closes=not why, why=why)
        covariance = then.covariance_at(meets_s, gripper.position_m)
        covariance = covariance + np.diag([guided.position_sd_m**2] * 2 + [guided.rotation_sd_rad**2] * 2)
        if guided.base is not None:
            reaction = self._reaction(guided.base, then, gripper, tool.position_m, meets_s)
            covariance = covariance + np.outer(reaction, reaction)
        probability = capture_probability(covariance, guided.gripper.radial_m, guided.gripper.tilt_rad, off)
        if probability < guided.min_probability:
            why = why or f"the probability of a capture is {probability:.3f}"
        return Decision(twist=self._last, closes=not why, probability=probability, why=why)

    def _reaction(
        self, base: FloatingBase, then: GuidedRing, gripper: Pose, there_m: Float64[Array, "xyz=3"], meets_s: float
    ) -> Float64[Array, "4"]:
        """What a floating base adds to the errors of the predicted ring: outward, along the normal, tilts.

        The track's velocities contain the motion of the base when the newest measurement was made, and are believed
        until the fingers meet the ring. Meanwhile the arm slows down or turns aside, and by momentum conservation the
        rate of the base changes with the tool's velocity. What is neglected is its reaction to the way from where the
        tool would be at its earlier velocity to where it will be, `there_m`.
        """
        measured_s = min(max(then.measured_s, self._ticks_s[0]), self._ticks_s[-1])
        after = min(max(int(np.searchsorted(self._ticks_s, measured_s)), 1), len(self._ticks_s) - 1)
        if after < 1:  # the first tick: the robot is at rest
            return np.zeros(4)
        before_s, before_m = self._ticks_s[after - 1], self._places_m[after - 1]
        velocity_m_s = (self._places_m[after] - before_m) / (self._ticks_s[after] - before_s)
        expected_m = before_m + velocity_m_s * (meets_s - before_s)
        from_base = reacted(base, Pose(), expected_m, there_m).inverse
        band_m = then.nearest_m(gripper.position_m)
        moved_m, turned = from_base.at(band_m) - band_m, from_base.rotation @ then.normal - then.normal
        outward = then.outward(gripper.position_m)
        return np.array([moved_m @ outward, moved_m @ then.normal, *(tilt_basis(then.normal) @ turned)])


def _moved(pose: Pose, twist: Twist, for_s: float) -> Pose:
    """The pose after some time at a constant twist."""
    return Pose(
        rotation=rotation_by(twist.rate_rad_s * for_s) @ pose.rotation,
        position_m=pose.position_m + twist.velocity_m_s * for_s,
    )


def _wanted(ring: GuidedRing, gripper: Pose, position_m: Float64[Array, "xyz=3"]) -> Pose:
    """The gripper at a place, opposite to the ring's normal.

    Its x axis is across the band, to the side to which it is turned already.
    """
    z = -ring.normal
    across = gripper.rotation[:, 0]
    if isfinite(ring.center_m[0]):
        outward = ring.outward(gripper.position_m)
        across = outward if outward @ across > 0.0 else -outward
    x = across - (across @ z) * z
    x = x / float(np.linalg.norm(x))
    return Pose(rotation=np.stack([x, cross(z, x), z], axis=1), position_m=position_m)


def _offsets(ring: GuidedRing, gripper: Pose) -> Float64[Array, "4"]:
    """Offset of the gripper from the band, outward and along the normal, and tilts of its direction."""
    off_m = gripper.position_m - ring.nearest_m(gripper.position_m)
    tilts = tilt_basis(ring.normal) @ -gripper.rotation[:, 2]
    return np.array([off_m @ ring.outward(gripper.position_m), off_m @ ring.normal, *tilts])
