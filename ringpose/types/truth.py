"""Ground truth of simulated and rendered shots."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from ringpose.types.arrays import Array, Float64


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TruthFrame:
    """The ring at one frame of a shot, in the camera frame."""

    stamp_s: float
    center_m: Float64[Array, "xyz=3"]
    normal: Float64[Array, "xyz=3"]
    break_points_px: Float64[Array, "laser edge=2 xy=2"] | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """One line of `truth.jsonl`; the attributes of the ring are None for a shot without a target."""

    shot: str
    expect: Literal["pose", "partial", "no_target"]
    center_m: Float64[Array, "xyz=3"] | None = None
    normal: Float64[Array, "xyz=3"] | None = None
    radius_inner_m: float | None = None
    radius_outer_m: float | None = None
    break_points_px: Float64[Array, "laser edge=2 xy=2"] | None = None
    stamp_s: float | None = None
    """Time at which centre and normal of a moving target are given."""
    velocity_m_s: Float64[Array, "xyz=3"] | None = None
    """Velocity of the ring's centre, in the camera frame."""
    angular_velocity_rad_s: Float64[Array, "xyz=3"] | None = None
    """In the camera frame."""
    frames: tuple[TruthFrame, ...] = ()
    """A moving target at each frame of the shot, in chronological order."""
    groups: Mapping[str, str | float | int | bool] = field(default_factory=dict)
