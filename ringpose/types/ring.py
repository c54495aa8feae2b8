"""What is known of a ring's size beforehand: an entry of a catalogue, or the user's word."""

from dataclasses import dataclass

import numpy as np

from ringpose.types.arrays import Array, Float64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class KnownRadii:
    """Radii of the ring's edges as they are known before the shot."""

    radius_m: Float64[Array, "edge=2"]
    """NaN for an edge of which nothing is known."""
    sd_m: Float64[Array, "edge=2"]
    """Standard deviations."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Ring:
    """An entry of a catalogue. Real edges differ from nominal sizes by millimetres: each radius is an interval."""

    name: str
    radius_inner_m: tuple[float, float]
    """From, to."""
    radius_outer_m: tuple[float, float]
    nominal: bool
    """Whether the intervals were made from a nominal interface diameter, not from a drawing or by measuring."""
    source: str = ""

    @property
    def known_radii(self) -> KnownRadii:
        """The intervals' middles, and the standard deviations of a radius that may be anywhere in them."""
        intervals = np.array([self.radius_inner_m, self.radius_outer_m])
        return KnownRadii(radius_m=intervals.mean(axis=1), sd_m=np.ptp(intervals, axis=1) / np.sqrt(12))
