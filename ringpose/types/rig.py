"""The rig: camera, light planes, what is known of their errors, and how it is mounted."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ringpose.types.arrays import Array, Float64
from ringpose.types.camera import Camera
from ringpose.types.covariance import ParameterCovariance
from ringpose.types.laser_planes import LaserPlanes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rig:
    """Everything that turns pixels into metres."""

    camera: Camera
    lasers: LaserPlanes
    covariance: ParameterCovariance | None = None
    tool_from_camera: Float64[Array, "4 4"] | None = None
    provenance: Mapping[str, Any] = field(default_factory=dict)
    sha256: str = ""
    """Of the file it was read from; empty if it was not read from one."""
