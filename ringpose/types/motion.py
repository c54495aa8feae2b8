"""Motion of a scene's target in the camera frame."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol, runtime_checkable

import numpy as np

from ringpose.types.arrays import Array, Float64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TimedPoses:
    """Poses at ascending times, of the camera or of the target; between them they are interpolated."""

    time_s: Float64[Array, "pose"]
    """Time since the start of the first exposure of a run."""
    position_m: Float64[Array, "pose xyz=3"]
    orientation_xyzw: Float64[Array, "pose 4"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FreeMotion:
    """Torque-free motion of the target past a camera, from the pose of a view on.

    The inertial frame is that of the camera at the start; `camera` has the camera's later poses in it.
    """

    inertia_kg_m2: Float64[Array, "3 3"]
    """About the centre of mass, along the axes of the target frame; only ratios matter."""
    center_of_mass_m: Float64[Array, "xyz=3"]
    """In the target frame."""
    angular_velocity_rad_s: Float64[Array, "xyz=3"]
    """At the start, along the axes of the target frame."""
    velocity_m_s: Float64[Array, "xyz=3"] = field(default_factory=lambda: np.zeros(3))
    """Of the centre of mass, in the inertial frame."""
    camera: TimedPoses | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionPreset:
    """Angular velocity at the start, and where published the principal moments, along the axes of the target frame."""

    angular_velocity_rad_s: tuple[float, float, float]
    inertia_kg_m2: tuple[float, float, float] | None = None


def _rate(degrees_s: float, from_axis_deg: float) -> tuple[float, float, float]:
    """An angular velocity at an angle from the ring's axis, towards x and a third as much towards y."""
    rate_rad_s, angle_rad = np.radians(degrees_s), np.radians(from_axis_deg)
    across = rate_rad_s * np.sin(angle_rad) / np.sqrt(10.0)
    return float(3 * across), float(across), float(rate_rad_s * np.cos(angle_rad))


MOTION_PRESETS: Mapping[str, MotionPreset] = {
    # Retired satellites in GEO tumble "well below ... one degree per second": Binz et al., an optical survey by NRL,
    # AMOS 2014. The axis is assumed, so that they nutate.
    "geo-typical": MotionPreset(angular_velocity_rad_s=_rate(0.3, 30.0)),
    "geo-bound": MotionPreset(angular_velocity_rad_s=_rate(1.0, 30.0)),
    # 2.67 deg/s by laser ranging on 2013-09-25 (period 134.74 s); moments of inertia and axis as in published
    # parameter files of simulations. The ring's axis is assumed to be that of the smallest moment.
    "envisat": MotionPreset(
        angular_velocity_rad_s=(float(np.radians(1.2535)), 0.0, float(np.radians(2.3575))),
        inertia_kg_m2=(129180.25, 124801.21, 16979.74),
    ),
    "stress": MotionPreset(angular_velocity_rad_s=_rate(8.0, 30.0)),
}
"""Motions that a scene file may refer to by name."""


@runtime_checkable
class TargetPath(Protocol):
    """The motion of the target in the camera frame."""

    def camera_from_target(self, time_s: float) -> tuple[Float64[Array, "3 3"], Float64[Array, "xyz=3"]]:
        """Rotation and translation at a time since the start of the run."""

    def inertial_from_camera(self, time_s: float) -> Float64[Array, "3 3"]:
        """Rotation of the camera since the start: directions of the sky turn back by it."""
