"""Motion of the target in the camera frame: a torque-free rigid body past a moving camera, or given poses.

The attitude of a free body solves Euler's equations I dw/dt = -w x I w and dq/dt = q w / 2, w along the axes of the
body; its centre of mass moves at constant velocity. Velocities of the truth are central differences of the poses.
"""

from bisect import bisect_left
from collections.abc import Sequence
from dataclasses import dataclass, replace
from threading import Lock
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.geometry.ring import rotation_by
from ringpose.geometry.rotations import rotation_vector
from ringpose.types.arrays import Array, Float64
from ringpose.types.scene import RingView
from ringpose.types.target import FreeMotion, TargetPath, TimedPoses

RELATIVE_TOLERANCE = 1e-13
"""Tolerance of the integration; over ten minutes at 8 deg/s, energy and angular momentum are kept to 1e-10."""

DIFFERENCE_S = 1e-3
"""Half of the interval of the central differences; their error at 8 deg/s is 1e-9 of the velocity."""


class FreeAttitude:
    """Attitude of a torque-free rigid body until `duration_s`, relative to its attitude at time 0.

    It is integrated only as far as it is asked for: the first shot of a long run does not wait for the last one.
    """

    def __init__(
        self, inertia: Float64[Array, "3 3"], angular_velocity_rad_s: Float64[Array, "3"], duration_s: float
    ) -> None:
        from scipy.integrate import DOP853

        self._given = inertia, angular_velocity_rad_s, duration_s
        self._inverse, self._inertia, self._duration_s = np.linalg.inv(inertia), inertia, duration_s
        start = np.array([*angular_velocity_rad_s, 0.0, 0.0, 0.0, 1.0])
        atol = RELATIVE_TOLERANCE * float(np.abs(start).max())
        self._solver: Any = DOP853(self._derivative, 0.0, start, duration_s, rtol=RELATIVE_TOLERANCE, atol=atol)
        self._pieces: list[Any] = []
        """The interpolants of the steps so far, and ..."""
        self._ends_s: list[float] = []
        """... the time at which each of them ends."""
        self._lock = Lock()

    def __reduce__(self) -> tuple[Any, ...]:
        return FreeAttitude, self._given

    def at(self, time_s: float) -> tuple[Float64[Array, "3 3"], Float64[Array, "xyz=3"]]:
        """Attitude at a time, and the angular velocity then, along the body's axes.

        The attitude is the rotation that turns vectors in the body frame into the body frame of time 0.
        """
        if not -2 * DIFFERENCE_S <= time_s <= self._duration_s + 2 * DIFFERENCE_S:
            raise DataError("the scene's motion", f"was computed for {self._duration_s:.3f} s, not for {time_s:.3f} s")
        from scipy.spatial.transform import Rotation

        with self._lock:
            while self._solver.status == "running" and not (self._pieces and self._solver.t >= time_s):
                self._solver.step()
                self._pieces.append(self._solver.dense_output())
                self._ends_s.append(self._solver.t)
        state: Float64[Array, "7"] = self._pieces[min(bisect_left(self._ends_s, time_s), len(self._pieces) - 1)](time_s)
        return np.asarray(Rotation.from_quat(state[3:]).as_matrix()), state[:3]

    def _derivative(self, _time_s: float, state: Float64[Array, "7"]) -> Float64[Array, "7"]:
        rate, (x, y, z, w) = state[:3], state[3:]
        momentum = self._inertia @ rate
        p, q, r = rate
        change = self._inverse @ [
            momentum[1] * r - momentum[2] * q,
            momentum[2] * p - momentum[0] * r,
            momentum[0] * q - momentum[1] * p,
        ]
        turn = [w * p + y * r - z * q, w * q + z * p - x * r, w * r + x * q - y * p, -x * p - y * q - z * r]
        return np.array([*change, *(0.5 * each for each in turn)])


class PosePath:
    """Smooth motion through timed poses: cubic splines of position and of rotation; for two poses constant rates."""

    def __init__(self, poses: TimedPoses, name: str = "motion") -> None:
        from scipy.interpolate import CubicSpline
        from scipy.spatial.transform import Rotation, RotationSpline

        self._span_s = (float(poses.time_s[0]), float(poses.time_s[-1]))
        self._name = name
        self._position = CubicSpline(poses.time_s, poses.position_m, bc_type="natural")
        self._rotation = RotationSpline(poses.time_s, Rotation.from_quat(poses.orientation_xyzw))

    def camera_from_target(self, time_s: float) -> tuple[Float64[Array, "3 3"], Float64[Array, "xyz=3"]]:
        """See `TargetPath`; a time before the first or after the last pose is a `DataError`."""
        first_s, last_s = self._span_s
        if not first_s - 2 * DIFFERENCE_S <= time_s <= last_s + 2 * DIFFERENCE_S:
            covered = f"covers {first_s:g} to {last_s:g} s, but the shots need {time_s:.3f} s"
            raise DataError(self._name, covered, "give more poses, or render fewer shots")
        return np.asarray(self._rotation(time_s).as_matrix()), np.asarray(self._position(time_s))

    def inertial_from_camera(self, time_s: float) -> Float64[Array, "3 3"]:
        """See `TargetPath`; a camera whose motion is not known is taken as still."""
        return np.eye(3)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SteadyPath:
    """A target whose face's centre moves at a constant velocity, and which turns about it at a constant rate."""

    rotation: Float64[Array, "3 3"]
    """Rotation from target to camera at time 0."""
    center_m: Float64[Array, "xyz=3"]
    """Centre of the face at time 0."""
    velocity_m_s: Float64[Array, "xyz=3"]
    angular_velocity_rad_s: Float64[Array, "xyz=3"]
    face_m: Float64[Array, "xyz=3"]
    """Centre of the face in the target frame."""

    def camera_from_target(self, time_s: float) -> tuple[Float64[Array, "3 3"], Float64[Array, "xyz=3"]]:
        """See `TargetPath`."""
        rotation = rotation_by(self.angular_velocity_rad_s * time_s) @ self.rotation
        return rotation, self.center_m + self.velocity_m_s * time_s - rotation @ self.face_m

    def inertial_from_camera(self, time_s: float) -> Float64[Array, "3 3"]:
        """See `TargetPath`; the camera is taken as still."""
        return np.eye(3)


@dataclass(frozen=True, slots=True, eq=False)
class FreePath:
    """A free body that starts in the pose of a view, seen by a camera that may move."""

    motion: FreeMotion
    attitude: FreeAttitude
    rotation: Float64[Array, "3 3"]
    """camera_from_target at time 0."""
    translation_m: Float64[Array, "xyz=3"]
    camera: PosePath | None

    def camera_from_target(self, time_s: float) -> tuple[Float64[Array, "3 3"], Float64[Array, "xyz=3"]]:
        """See `TargetPath`."""
        turned, moved_m = (None, None) if self.camera is None else self.camera.camera_from_target(time_s)
        center_m = self.motion.center_of_mass_m
        rotation = self.rotation @ self.attitude.at(time_s)[0]
        mass_m = self.rotation @ center_m + self.translation_m + self.motion.velocity_m_s * time_s
        translation_m = mass_m - rotation @ center_m
        if turned is None:  # inertial frame from camera
            return rotation, translation_m
        return turned.T @ rotation, turned.T @ (translation_m - moved_m)

    def inertial_from_camera(self, time_s: float) -> Float64[Array, "3 3"]:
        """See `TargetPath`."""
        return np.eye(3) if self.camera is None else self.camera.camera_from_target(time_s)[0]


def velocities(
    path: TargetPath, time_s: float, point_m: Float64[Array, "xyz=3"]
) -> tuple[Float64[Array, "xyz=3"], Float64[Array, "xyz=3"]]:
    """Velocity of a point of the target, and angular velocity of the target, both in the camera frame."""
    (before, before_m), (after, after_m) = (
        path.camera_from_target(time_s + side * DIFFERENCE_S) for side in (-1.0, 1.0)
    )
    moved_m = (after @ point_m + after_m) - (before @ point_m + before_m)
    return moved_m / (2 * DIFFERENCE_S), rotation_vector(after @ before.T) / (2 * DIFFERENCE_S)


def target_paths(
    placements: Sequence[tuple[Float64[Array, "3 3"], Float64[Array, "xyz=3"]]],
    motion: FreeMotion | TimedPoses,
    duration_s: float,
) -> list[TargetPath]:
    """The path of the target for each of its placements (camera_from_target) at the begin, until `duration_s`."""
    if isinstance(motion, TimedPoses):
        return [PosePath(motion, "the scene's motion.file")] * len(placements)
    attitude = FreeAttitude(motion.inertia_kg_m2, motion.angular_velocity_rad_s, duration_s)
    camera = None if motion.camera is None else PosePath(motion.camera, "the scene's motion.camera")
    return [FreePath(motion, attitude, *placement, camera) for placement in placements]


def moved_view(view: RingView, path: TargetPath, time_s: float, face_m: Float64[Array, "xyz=3"], name: str) -> RingView:
    """The view of a target that has moved along a path until a time; `face_m` is its face's centre in its frame."""
    rotation, translation_m = path.camera_from_target(time_s)
    center_m = rotation @ face_m + translation_m
    return replace(view, name=name, center_m=center_m, normal=rotation[:, 2], path=path, begin_s=time_s)
