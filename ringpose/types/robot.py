"""Poses of a robot's tool, as they are given for a calibration of the mount."""

from dataclasses import dataclass
from typing import NamedTuple

from ringpose.types.arrays import Array, Float64


class ReportedPose(NamedTuple):
    """A pose of the tool in the base frame, and to which shot it belongs."""

    location: str
    """File and line, for messages."""
    name: str
    """Name of the shot or image; empty if not given."""
    stamp_s: float | None
    position_m: Float64[Array, "xyz=3"]
    rotation: Float64[Array, "3 3"]
    """Rotation from tool to base."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportedPoses:
    """The poses of one file, without identical repeats."""

    poses: tuple[ReportedPose, ...]
    repeats: int = 0
    """Identical repeats that were left out."""
