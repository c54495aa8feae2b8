"""The rig: camera, light planes, their joint covariance, and the mounting."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import TYPICAL_STABILITY, RigStability
from ringpose.types.camera import Camera
from ringpose.types.covariance import ParameterCovariance
from ringpose.types.robot import Mount


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaserPlanes:
    """The light planes, each `normal @ point = distance_m`, in the camera frame."""

    names: tuple[str, ...]
    normal: Float64[Array, "laser xyz=3"]
    distance_m: Float64[Array, "laser"]
    projector_m: Float64[Array, "laser xyz=3"]
    """Position of the projector; NaN if not known."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaneCorrection:
    """Correction of a light plane that a stream of shots has shown to have moved."""

    change: Float64[Array, "parameter=3"]
    """Tilts in radians and distance in metres, relative to the rig's file."""
    covariance: Float64[Array, "parameter=3 parameter=3"]
    """Of the corrected plane: replaces that of the calibration and the stability."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rig:
    """The calibrated measurement system."""

    camera: Camera
    lasers: LaserPlanes
    covariance: ParameterCovariance | None = None
    stability: RigStability = TYPICAL_STABILITY
    """How far light planes and camera may have moved since the calibration."""
    mount: Mount | None = None
    """Of the camera on a robot's tool; None if it is not known."""
    moved_planes: Mapping[str, PlaneCorrection] = field(default_factory=dict)
    """By the laser's name; the light planes are the corrected ones."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    sha256: str = ""
    """Hash of the rig file; empty if the rig was not read from a file."""

    @property
    def tool_from_camera(self) -> Float64[Array, "4 4"] | None:
        """The camera's pose in the tool frame; None without a mount."""
        return None if self.mount is None else self.mount.tool_from_camera
