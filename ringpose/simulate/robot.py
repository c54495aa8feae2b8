"""A robot arm that carries the camera and a gripper, on a base that is fixed or floats freely.

The tool is velocity-controlled: a twist in the base frame takes effect after the delay, within the limits of speed and
acceleration. The base of a free-floating robot reacts to the arm by momentum conservation: with all momenta zero at the
start, and the arm's mass as a point at r in the base frame (Umetani and Yoshida, "Resolved motion rate control of space
manipulators with generalized Jacobian matrix", IEEE Trans. Robotics and Automation 5(3), 1989, for one point mass),

    w = -(I + mu (|r|^2 1 - r r^T))^-1 mu r x r',    mu = M m / (M + m),    R r m / (M + m) + p = const,

w the base's angular velocity in its own frame, R and p its attitude and place in the inertial frame.
"""

from bisect import bisect_right
from dataclasses import dataclass, field

import numpy as np

from ringpose.geometry.ring import rotation_by
from ringpose.geometry.rotations import cross, rotation_vector
from ringpose.types.arrays import Array, Float64
from ringpose.types.capture import Arm, FloatingBase

STEP_S = 0.005
"""Step of the integration: a tenth of the time in which the arm reaches its highest speed at most."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Pose:
    """A rigid transform: `point_outside = rotation @ point_inside + position_m`."""

    rotation: Float64[Array, "3 3"] = field(default_factory=lambda: np.eye(3))
    position_m: Float64[Array, "xyz=3"] = field(default_factory=lambda: np.zeros(3))

    def __matmul__(self, inner: "Pose") -> "Pose":
        return Pose(rotation=self.rotation @ inner.rotation, position_m=self.at(inner.position_m))

    def at(self, point_m: Float64[Array, "xyz=3"]) -> Float64[Array, "xyz=3"]:
        """The point outside."""
        return self.rotation @ point_m + self.position_m

    @property
    def inverse(self) -> "Pose":
        """The transform back."""
        return Pose(rotation=self.rotation.T, position_m=-self.rotation.T @ self.position_m)

    @property
    def matrix(self) -> Float64[Array, "4 4"]:
        """The same as a matrix."""
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = self.rotation, self.position_m
        return matrix

    @classmethod
    def of(cls, matrix: Float64[Array, "4 4"]) -> "Pose":
        """The transform of a matrix."""
        return cls(rotation=matrix[:3, :3].copy(), position_m=matrix[:3, 3].copy())

    def towards(self, later: "Pose", share: float) -> "Pose":
        """A pose on the way to another one that is near, both parts interpolated linearly."""
        turn = rotation_vector(self.rotation.T @ later.rotation)
        return Pose(
            rotation=self.rotation @ rotation_by(share * turn),
            position_m=self.position_m + share * (later.position_m - self.position_m),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Twist:
    """Velocity of the tool's origin and angular velocity of the tool, in the base frame."""

    velocity_m_s: Float64[Array, "xyz=3"] = field(default_factory=lambda: np.zeros(3))
    rate_rad_s: Float64[Array, "xyz=3"] = field(default_factory=lambda: np.zeros(3))


class Robot:
    """The state of a robot over time, from 0 on, and its past; the inertial frame is the base at the start."""

    def __init__(
        self, arm: Arm, base_from_tool: Pose, rng: np.random.Generator, base: FloatingBase | None = None
    ) -> None:
        self.arm, self.base, self._rng = arm, base, rng
        self._commands: list[tuple[float, Twist]] = []
        """Those that have not taken effect yet, with the time at which they do, in the order of these times."""
        self._wanted = self._moving = Twist()
        self._time_s = [0.0]
        self._tool, self._base = [base_from_tool], [Pose()]

    @property
    def now_s(self) -> float:
        """The time up to which the robot has moved."""
        return self._time_s[-1]

    def command(self, now_s: float, twist: Twist) -> None:
        """A twist that takes effect after the delay, but not before a command that was given earlier."""
        due_s = now_s + self.arm.delay_s + self.arm.jitter_s * float(self._rng.uniform())
        self._commands.append((max([due_s, *(earlier_s for earlier_s, _ in self._commands)]), twist))

    def advance(self, until_s: float) -> None:
        """Move until a time; commands that are given later do not change it."""
        while self.now_s < until_s - 1e-9:
            while self._commands and self._commands[0][0] <= self.now_s + 1e-9:
                self._wanted = self._commands.pop(0)[1]
            self._step(min(STEP_S, until_s - self.now_s))

    def base_from_tool(self, time_s: float) -> Pose:
        """The true pose of the tool at a time that has passed."""
        return self._at(self._tool, time_s)

    def inertial_from_tool(self, time_s: float) -> Pose:
        """The same in the inertial frame."""
        return self._at(self._base, time_s) @ self._at(self._tool, time_s)

    def inertial_from_base(self, time_s: float) -> Pose:
        """The pose of the base."""
        return self._at(self._base, time_s)

    def _at(self, poses: list[Pose], time_s: float) -> Pose:
        after = min(max(bisect_right(self._time_s, time_s), 1), len(self._time_s) - 1)
        if len(self._time_s) == 1:
            return poses[0]
        first_s = self._time_s[after - 1]
        return poses[after - 1].towards(poses[after], (time_s - first_s) / (self._time_s[after] - first_s))

    def _step(self, step_s: float) -> None:
        """Move the tool by its twist, which approaches the wanted one, and the base by its reaction."""
        arm, tool = self.arm, self._tool[-1]
        self._moving = Twist(
            velocity_m_s=_slewed(
                self._moving.velocity_m_s,
                _limited(self._wanted.velocity_m_s, arm.speed_m_s),
                arm.acceleration_m_s2 * step_s,
            ),
            rate_rad_s=_slewed(
                self._moving.rate_rad_s,
                _limited(self._wanted.rate_rad_s, arm.rate_rad_s),
                arm.angular_acceleration_rad_s2 * step_s,
            ),
        )
        moved = Pose(
            rotation=rotation_by(self._moving.rate_rad_s * step_s) @ tool.rotation,
            position_m=tool.position_m + self._moving.velocity_m_s * step_s,
        )
        base = self._base[-1]
        if self.base is not None:
            base = reacted(self.base, base, tool.position_m, moved.position_m)
        self._time_s.append(self.now_s + step_s)
        self._tool.append(moved)
        self._base.append(base)


def reacted(
    base: FloatingBase, inertial_from_base: Pose, before_m: Float64[Array, "xyz=3"], after_m: Float64[Array, "xyz=3"]
) -> Pose:
    """The pose of a base after a small movement of the tool in the base frame, from its pose before."""
    before_m, after_m = arm_center_m(base, before_m), arm_center_m(base, after_m)
    middle_m, moved_m = 0.5 * (before_m + after_m), after_m - before_m
    total_kg = base.mass_kg + base.arm_mass_kg
    reduced_kg = base.mass_kg * base.arm_mass_kg / total_kg
    inertia = np.diag(base.inertia_kg_m2) + reduced_kg * (
        middle_m @ middle_m * np.eye(3) - np.outer(middle_m, middle_m)
    )
    turn_rad = -np.linalg.solve(inertia, reduced_kg * cross(middle_m, moved_m))
    share = base.arm_mass_kg / total_kg
    center_m = inertial_from_base.at(share * before_m)  # of mass of both, which stays where it is
    rotation = inertial_from_base.rotation @ rotation_by(turn_rad)
    return Pose(rotation=rotation, position_m=center_m - rotation @ (share * after_m))


def arm_center_m(base: FloatingBase, tool_m: Float64[Array, "xyz=3"]) -> Float64[Array, "xyz=3"]:
    """Centre of mass of the arm in the base frame."""
    return base.shoulder_m + base.arm_share * (tool_m - base.shoulder_m)


def _limited(vector: Float64[Array, "xyz=3"], most: float) -> Float64[Array, "xyz=3"]:
    """The vector, shortened to a length."""
    length = float(np.linalg.norm(vector))
    return vector if length <= most else vector * (most / length)


def _slewed(now: Float64[Array, "xyz=3"], wanted: Float64[Array, "xyz=3"], most: float) -> Float64[Array, "xyz=3"]:
    """The value after a step of at most this length towards the wanted one."""
    return now + _limited(wanted - now, most)
