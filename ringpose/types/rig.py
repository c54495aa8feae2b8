"""The rig: camera, light planes, what is known of their errors, and how it is mounted.

The light planes.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from ringpose.types.arrays import Array, Float64
from ringpose.types.camera import Camera
from ringpose.types.covariance import ParameterCovariance


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaserPlanes:
    """The light planes, each `normal @ point = distance_m`, in the camera frame."""

    names: tuple[str, ...]
    normal: Float64[Array, "laser xyz=3"]
    distance_m: Float64[Array, "laser"]
    projector_m: Float64[Array, "laser xyz=3"]
    """Where the light comes from; NaN where it is not known."""


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
