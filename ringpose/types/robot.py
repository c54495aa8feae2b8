"""The robot that carries the camera: its poses, and how the camera is mounted."""

from dataclasses import dataclass

import numpy as np

from ringpose.types.arrays import Array, Float64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotPoses:
    """Poses of the tool in the base frame, in the order of their stamps."""

    stamp_s: Float64[Array, "pose"]
    position_m: Float64[Array, "pose xyz=3"]
    rotation: Float64[Array, "pose 3 3"]
    """From tool to base."""


MOUNT_PARAMETERS = (
    "mount.rotation_x", "mount.rotation_y", "mount.rotation_z",
    "mount.translation_x", "mount.translation_y", "mount.translation_z", "mount.delay",
)  # fmt: skip
"""Uncertain parameters of a mount: rotation vector (rad) and translation (m) of the camera in the tool frame, delay."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mount:
    """How the camera is mounted on the tool, and how well that is known."""

    tool_from_camera: Float64[Array, "4 4"]
    root: Float64[Array, "6 6"]
    """R of the covariance R R^T of rotation vector (rad) and translation (m), in the tool frame."""
    delay_s: float = 0.0
    """The robot's stamp that belongs to the camera's stamp t is t + delay_s ..."""
    delay_sd_s: float = 0.0
    """... with this standard deviation."""

    @property
    def covariance(self) -> Float64[Array, "parameter=7 parameter=7"]:
        """Of `MOUNT_PARAMETERS`."""
        covariance = np.zeros((7, 7))
        covariance[:6, :6], covariance[6, 6] = self.root @ self.root.T, self.delay_sd_s**2
        return covariance

    @property
    def uncertain(self) -> tuple[str, ...]:
        """Those of `MOUNT_PARAMETERS` that have a variance."""
        return tuple(name for name, sd in zip(MOUNT_PARAMETERS, np.diag(self.covariance), strict=True) if sd > 0)
