"""Prior knowledge of a ring's radii: an entry of a catalogue, or given by the user."""

from dataclasses import dataclass

import numpy as np

from ringpose.types.arrays import Array, Float64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownRadii:
    """Prior of the radii of the ring's edges."""

    radius_m: Float64[Array, "edge=2"]
    """NaN for an edge without a prior."""
    sd_m: Float64[Array, "edge=2"]
    """Standard deviations."""
    tolerance_m: float | None = None
    """Of the ring's form, by a catalogue; None if it states none, or the user states another one."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ring:
    """An entry of a catalogue, with radii as intervals: real ones differ from nominal ones by millimetres."""

    name: str
    radius_inner_m: tuple[float, float]
    """Lower and upper limit."""
    radius_outer_m: tuple[float, float]
    nominal: bool
    """Whether the intervals were derived from a nominal interface diameter, not from a drawing or a measurement."""
    source: str = ""
    tolerance_m: float | None = None
    """Standard deviation of the edges from circles, and of the face from a plane."""

    @property
    def known_radii(self) -> KnownRadii:
        """Mean and standard deviation of a uniform distribution over each interval."""
        intervals = np.array([self.radius_inner_m, self.radius_outer_m])
        return KnownRadii(
            radius_m=intervals.mean(axis=1), sd_m=np.ptp(intervals, axis=1) / np.sqrt(12), tolerance_m=self.tolerance_m
        )
