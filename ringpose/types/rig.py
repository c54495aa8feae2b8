"""The rig: camera, light planes, what is known of their errors, and how it is mounted."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from jaxtyping import Float64

from ringpose.types.arrays import Array
from ringpose.types.camera import Camera
from ringpose.types.laser_planes import LaserPlanes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterCovariance:
    """Joint covariance of named parameters.

    Names: `fx fy cx cy k1 k2 p1 p2 k3 ...` of the camera, `<laser>.tilt_1 <laser>.tilt_2 <laser>.distance`
    of each light plane (tilt basis: `ringpose.geometry.rotations.tilt_basis`); pixels, radians, metres.
    """

    parameters: tuple[str, ...]
    data: Float64[Array, "parameter parameter"]


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
