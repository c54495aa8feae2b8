"""The light planes."""

from dataclasses import dataclass

from ringpose.types.arrays import Array, Float64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaserPlanes:
    """The light planes, each `normal @ point = distance_m`, in the camera frame."""

    names: tuple[str, ...]
    normal: Float64[Array, "laser xyz=3"]
    distance_m: Float64[Array, "laser"]
    projector_m: Float64[Array, "laser xyz=3"]
    """Where the light comes from; NaN where it is not known."""
