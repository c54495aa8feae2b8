"""What happens in one run: a target that tumbles freely, and a robot that carries a camera and a gripper towards it.

The inertial frame is the robot's base at the start. The rig and the mount that measure are those of the scene; the true
ones are drawn about them. The poses that the robot reports have errors of their own, and stamps of another clock.
"""

from dataclasses import replace

import numpy as np

from ringpose.errors import DataError
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.ring import rotation_by
from ringpose.simulate.motion import FreeAttitude, FreePath, moved_view
from ringpose.simulate.placement import target_placement
from ringpose.simulate.robot import STEP_S, Pose, Robot
from ringpose.types.arrays import Array, Float64
from ringpose.types.capture import CaptureLoop, FloatingBase, GripperState, TrueRing
from ringpose.types.rig import Mount, RobotPoses
from ringpose.types.scene import RingView, Scene
from ringpose.types.target import FreeMotion

SHOT_S = 0.03
"""Time for which the robot moves on while a shot is taken: as long as no later command can have an effect."""

REPORTED_S = 2 * STEP_S
"""Time between two poses that the robot reports."""

REPORTED_BEFORE = 10
"""Number of them before the run begins, when the robot is at rest."""

CORRELATED_M = 1.0
"""Distance of two places over which the error of a robot's pose changes by one radian of its wave: an arm's length."""

READING_SHARE = 0.02
"""Share of that error that differs from one pose to the next: encoders of 20 bits resolve micrometres at a metre."""

KEPT = 200
"""Number of these poses that are used for a shot: two seconds."""

BASE_FROM_TOOL = Pose(rotation=rotation_by(np.array([0.4, -0.3, 0.8])), position_m=np.array([1.3, 0.2, 0.3]))
"""Where the tool is at the start; with a fixed base nothing depends on it."""


class World:
    """Target and robot of one run over time, from 0 on; `view` is where the camera sees the target at the start."""

    def __init__(
        self,
        scene: Scene,
        view: RingView,
        motion: FreeMotion,
        loop: CaptureLoop,
        base: FloatingBase | None,
        rng: np.random.Generator,
    ) -> None:
        mount = scene.rig.mount
        if mount is None:
            raise DataError("the scene's rig", "has no mount", "give its tool_from_camera, with a covariance")
        self.scene, self.loop, self._view, self.mount = scene, loop, view, mount
        self._tool_from_camera = drawn_mount(mount, rng)
        self._clock_s = mount.delay_s + mount.delay_sd_s * float(rng.standard_normal())
        """By how much the robot's stamps are ahead of the camera's."""
        self._errors = ReportedErrors(mount, np.random.default_rng(rng.integers(2**63)))
        self.robot = Robot(loop.arm, BASE_FROM_TOOL, np.random.default_rng(rng.integers(2**63)), base)
        placed = target_placement(scene, replace(view, path=None))
        start = BASE_FROM_TOOL @ self._tool_from_camera
        target = start @ Pose(rotation=placed.rotation, position_m=placed.translation_m)
        duration_s = loop.timeout_s + loop.closing_s + 1.0
        attitude = FreeAttitude(motion.inertia_kg_m2, motion.angular_velocity_rad_s, duration_s)
        self._target = FreePath(motion, attitude, target.rotation, target.position_m, None)
        self._start = start
        self.tool_from_gripper = Pose.of(mount.carrier_from_camera) @ Pose(position_m=loop.gripper_m)
        self._reported: list[tuple[float, Pose]] = []
        self._report()

    def advance(self, until_s: float) -> None:
        """Move the robot until a time, with the poses that it reports."""
        self.robot.advance(until_s)
        self._report()

    def _report(self) -> None:
        while (next_s := (len(self._reported) - REPORTED_BEFORE) * REPORTED_S) <= self.robot.now_s + 1e-9:
            reported = self._errors.added(self.robot.base_from_tool(max(next_s, 0.0)))
            self._reported.append((next_s + self._clock_s, reported))

    @property
    def reported(self) -> list[tuple[float, Pose]]:
        """All poses that the robot has reported, with their stamps."""
        return self._reported

    def camera_motion(self, _stamp_s: float = 0.0) -> CameraMotion:
        """The motion of the camera by the newest poses that the robot has reported."""
        newest = self._reported[-KEPT:]
        poses = RobotPoses(
            stamp_s=np.array([self.scene.start_s + stamp_s for stamp_s, _ in newest]),
            position_m=np.array([pose.position_m for _, pose in newest]),
            rotation=np.array([pose.rotation for _, pose in newest]),
        )
        return CameraMotion(poses=poses, mount=self.mount)

    def view_at(self, time_s: float, name: str) -> RingView:
        """The view of a shot that begins at a time; the robot moves on until its end."""
        self.advance(time_s + SHOT_S)
        face_m = np.array([0.0, 0.0, self.scene.ring.height_m])
        return moved_view(self._view, self, time_s, face_m, name)

    def camera_from_target(self, time_s: float) -> tuple[Float64[Array, "3 3"], Float64[Array, "xyz=3"]]:
        """See `TargetPath`."""
        camera = self.robot.inertial_from_tool(time_s) @ self._tool_from_camera
        rotation, translation_m = self._target.camera_from_target(time_s)
        seen = camera.inverse @ Pose(rotation=rotation, position_m=translation_m)
        return seen.rotation, seen.position_m

    def inertial_from_camera(self, time_s: float) -> Float64[Array, "3 3"]:
        """See `TargetPath`."""
        return self._start.rotation.T @ (self.robot.inertial_from_tool(time_s) @ self._tool_from_camera).rotation

    def closed_at(self, time_s: float) -> tuple[GripperState, TrueRing]:
        """Gripper and true ring at a time, both in the inertial frame."""
        gripper = self.robot.inertial_from_tool(time_s) @ self.tool_from_gripper
        rotation, translation_m = self._target.camera_from_target(time_s)
        ring = self.scene.ring
        return (
            GripperState(
                grasp_m=gripper.position_m,
                approach=gripper.rotation[:, 2],
                radial_m=self.loop.radial_m,
                tilt_rad=self.loop.tilt_rad,
            ),
            TrueRing(
                center_m=translation_m + ring.height_m * rotation[:, 2],
                normal=rotation[:, 2],
                radius_inner_m=ring.radius_inner_m,
                radius_outer_m=ring.radius_outer_m,
            ),
        )


class ReportedErrors:
    """Errors of the poses that a robot reports: of its joints and links, which change as it moves, and of reading them.

    The first have the standard deviations of the mount's `robot_rotation_sd_rad` and `robot_translation_sd_m`; each is
    a wave over the space in which the tool moves. The others are independent.
    """

    def __init__(self, mount: Mount, rng: np.random.Generator) -> None:
        self._sd = np.repeat([mount.robot_rotation_sd_rad, mount.robot_translation_sd_m], 3)
        direction = rng.standard_normal((6, 3))
        self._wave_per_m = direction / np.linalg.norm(direction, axis=1, keepdims=True) / CORRELATED_M
        self._phase, self._rng = rng.uniform(0.0, 2.0 * np.pi, 6), rng

    def added(self, true: Pose) -> Pose:
        """The pose that is reported for a true one."""
        wave = np.sqrt(2.0) * self._sd * np.cos(self._wave_per_m @ true.position_m + self._phase)
        error = wave + READING_SHARE * self._sd * self._rng.standard_normal(6)
        return Pose(
            rotation=true.rotation @ rotation_by(error[:3]),
            position_m=true.position_m + true.rotation @ error[3:],
        )


def drawn_mount(mount: Mount, rng: np.random.Generator) -> Pose:
    """A true mount, drawn about the calibrated one from its covariance."""
    error = mount.root @ rng.standard_normal(6)
    nominal = Pose.of(mount.carrier_from_camera)
    return Pose(rotation=rotation_by(error[:3]) @ nominal.rotation, position_m=nominal.position_m + error[3:])


def tumbling(
    free: FreeMotion, rate_rad_s: float, nutation_rad: float, drift_m_s: float, rng: np.random.Generator
) -> FreeMotion:
    """A torque-free motion of this rate, drawn, whose momentum is inclined to the ring's axis by the nutation angle.

    The centre of mass drifts in any direction of the inertial frame. The angle is that at the start; with two equal
    moments of inertia across the axis it is constant, the half-cone of the nutation.
    """
    azimuth, spin = rng.uniform(0.0, 2.0 * np.pi), rng.choice([-1.0, 1.0])
    across = np.sin(nutation_rad) * np.array([np.cos(azimuth), np.sin(azimuth)])
    rate = np.linalg.solve(free.inertia_kg_m2, spin * np.array([*across, np.cos(nutation_rad)]))
    drift = rng.standard_normal(3)
    return replace(
        free,
        angular_velocity_rad_s=rate * (rate_rad_s / float(np.linalg.norm(rate))),
        velocity_m_s=drift * (drift_m_s / float(np.linalg.norm(drift))),
        camera=None,
    )
