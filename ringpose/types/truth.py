"""The ground truth of a shot: the ring, its motion and its break points, of a render or of a rig that measured it."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Annotated, Literal

from ringpose.types import plausible
from ringpose.types.arrays import Array, Float64
from ringpose.types.record import Form, Key, Presence


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TruthFrame:
    """The ring at one frame of a shot, in the camera frame."""

    stamp_s: Annotated[float, Key("Its mid exposure.", form=Form.STAMP)]
    center_m: Annotated[
        Float64[Array, "xyz=3"],
        Key("Centre of the ring.", form=Form.BOUNDED_LENGTH, plausible=plausible.TARGET_DISTANCE_M),
    ]
    normal: Annotated[Float64[Array, "xyz=3"], Key("Normal of the ring.", form=Form.UNIT_VECTOR)]
    break_points_px: Annotated[
        Float64[Array, "laser edge=2 xy=2"] | None,
        Key("Null, or missing, if they are not known.", null_points=True),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """One line of `truth.jsonl`; the attributes of the ring are None for a shot without a target."""

    shot: Annotated[str, Key("Name of the shot: its file name without suffix.")]
    center_m: Annotated[
        Float64[Array, "xyz=3"] | None,
        Key(
            "Centre of the ring, camera frame; null without a target.",
            form=Form.BOUNDED_LENGTH,
            plausible=plausible.TARGET_DISTANCE_M,
        ),
    ] = None
    normal: Annotated[
        Float64[Array, "xyz=3"] | None,
        Key("Unit normal of the ring's plane, towards the camera; null without a target.", form=Form.UNIT_VECTOR),
    ] = None
    radius_inner_m: Annotated[
        float | None, Key("Radius of the inner edge; null if it is not known.", plausible=plausible.RING_RADIUS_M)
    ] = None
    radius_outer_m: Annotated[
        float | None, Key("Radius of the outer edge; null if it is not known.", plausible=plausible.RING_RADIUS_M)
    ] = None
    break_points_px: Annotated[
        Float64[Array, "laser edge=2 xy=2"] | None,
        Key("Break points; null where one is not visible.", null_points=True),
    ] = None
    expect: Annotated[
        Literal["pose", "partial", "no_target"],
        Key(
            "What a method should find: a `pose`, in `partial` shots what they determine, or `no_target`.",
        ),
    ]
    groups: Annotated[
        Mapping[str, str | float | int | bool],
        Key("Names and values by which `ringpose bench` makes its tables."),
    ] = field(default_factory=dict)
    stamp_s: Annotated[
        float | None,
        Key(
            "Time at which centre and normal of a target that moves hold; the shot's stamp if it is missing.",
            form=Form.STAMP,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    velocity_m_s: Annotated[
        Float64[Array, "xyz=3"] | None,
        Key("Velocity of the ring's centre, camera frame.", presence=Presence.IF_KNOWN),
    ] = None
    angular_velocity_rad_s: Annotated[
        Float64[Array, "xyz=3"] | None,
        Key("Angular velocity of the target, camera frame.", presence=Presence.IF_KNOWN),
    ] = None
    frames: Annotated[
        tuple[TruthFrame, ...],
        Key(
            "The ring at each frame of the shot, in chronological order, between which the truth is interpolated.",
            presence=Presence.IF_KNOWN,
        ),
    ] = ()

    @property
    def contradiction(self) -> tuple[str, str] | None:
        """The key and the finding of values that contradict each other; None if they do not."""
        for name, value in (("center_m", self.center_m), ("normal", self.normal)):
            if value is None and self.expect != "no_target":
                return name, f"is null or missing, must have a value where expect is {self.expect}"
        if all(earlier.stamp_s < later.stamp_s for earlier, later in pairwise(self.frames)):
            return None
        return "frames", "are not in chronological order: stamp_s must increase"
