"""The break points in space."""

from dataclasses import dataclass

from ringpose.types.arrays import Array, Bool, Float64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingPoints:
    """Points on the two edges of the ring's face, in the camera frame; NaN where one was not seen."""

    position_m: Float64[Array, "laser edge=2 xyz=3"]

    @property
    def seen(self) -> Bool[Array, "laser edge=2"]:
        """Which of them were seen."""
        seen: Bool[Array, "laser edge=2"] = ~(self.position_m != self.position_m).any(axis=-1)
        return seen
