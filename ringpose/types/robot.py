"""Poses of a robot's tool, as a file or a stream gives them."""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

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

    def repeats(self, other: "ReportedPose") -> bool:
        """Whether this is the other pose once more."""
        return (
            (self.name, self.stamp_s) == (other.name, other.stamp_s)
            and np.array_equal(self.position_m, other.position_m)
            and np.array_equal(self.rotation, other.rotation)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class ReportedPoses:
    """The poses of one file, without identical repeats."""

    poses: tuple[ReportedPose, ...]
    repeats: int = 0
    """Identical repeats that were left out."""
