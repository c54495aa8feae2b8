"""What stands on a ring's face or lies over it: bolt heads, a cable, a blanket. They interrupt the stripes."""

from dataclasses import dataclass, field
from math import cos, floor, pi, sin
from typing import Annotated, Literal

import numpy as np

from ringpose.types.arrays import Array, Float64
from ringpose.types.plausible import ANGLE_RAD, DETAIL_M, PART_M
from ringpose.types.record import Key, Presence
from ringpose.types.target import MATERIAL_NAMES, MATERIALS, Box, Foil, Material, Part, Revolution, RingShape

_ABOVE_M = 1e-5
"""Distance of the underside of an obstacle from the face: a ray from the face towards the camera enters it there."""

_ANGLE = "Angle of its middle, or of the first head, from the target frame's x axis towards y."

BLANKET_M = 0.002
"""Thickness of a blanket."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Heads:
    """Bolt heads, or springs, along the middle of the ring's face."""

    kind: Annotated[Literal["heads"], Key()]
    height_m: Annotated[float, Key("Height above the face.", plausible=PART_M, positive=True)] = 0.005
    width_m: Annotated[float, Key("Diameter.", plausible=PART_M, positive=True, presence=Presence.IF_KNOWN)] = 0.009
    spacing_m: Annotated[
        float,
        Key("Distance along the middle of the face.", plausible=PART_M, positive=True, presence=Presence.IF_KNOWN),
    ] = 0.06
    angle_rad: Annotated[
        float,
        Key(
            _ANGLE,
            plausible=ANGLE_RAD,
            presence=Presence.IF_KNOWN,
        ),
    ] = 0.0
    count: Annotated[
        int | None, Key("Number of them; all around the ring without it.", least=1, presence=Presence.IF_KNOWN)
    ] = None
    material: Annotated[Material, Key("Its material.", words=MATERIAL_NAMES, presence=Presence.IF_KNOWN)] = MATERIALS[
        "metal"
    ]

    def parts(self, ring: RingShape) -> tuple[Part, ...]:
        """The heads as parts of the target."""
        top_m = self.height_m
        profile_m = np.array([[0.0, 0.0], [self.width_m / 2, 0.0], [self.width_m / 2, top_m], [0.0, top_m]])
        step_rad = self.spacing_m / _middle_m(ring)
        count = floor(2 * pi / step_rad) if self.count is None else self.count
        return tuple(
            Part(
                name=f"head {number + 1}",
                shape=Revolution(profile_m=profile_m),
                materials=(self.material,) * 3,
                translation_m=_on_face_m(ring, self.angle_rad + number * step_rad, _middle_m(ring), 0.0),
            )
            for number in range(count)
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Cable:
    """A straight cable that lies on the middle of the ring's face."""

    kind: Annotated[Literal["cable"], Key()]
    angle_rad: Annotated[float, Key(_ANGLE, plausible=ANGLE_RAD)]
    direction_rad: Annotated[
        float,
        Key(
            "Its direction, from the radius there towards the direction along the ring.",
            plausible=ANGLE_RAD,
            presence=Presence.IF_KNOWN,
        ),
    ] = pi / 2
    width_m: Annotated[float, Key("Diameter.", plausible=PART_M, positive=True, presence=Presence.IF_KNOWN)] = 0.006
    length_m: Annotated[float, Key("Length.", plausible=PART_M, positive=True, presence=Presence.IF_KNOWN)] = 0.1
    material: Annotated[Material, Key("Its material.", words=MATERIAL_NAMES, presence=Presence.IF_KNOWN)] = MATERIALS[
        "matt"
    ]

    def parts(self, ring: RingShape) -> tuple[Part, ...]:
        """The cable as a part of the target."""
        turned_rad, radius_m = self.angle_rad + self.direction_rad, self.width_m / 2
        along = np.array([cos(turned_rad), sin(turned_rad), 0.0])
        aside = np.array([-along[1], along[0], 0.0])
        profile_m = np.array([[0.0, 0.0], [radius_m, 0.0], [radius_m, self.length_m], [0.0, self.length_m]])
        middle_m = _on_face_m(ring, self.angle_rad, _middle_m(ring), radius_m)
        return (
            Part(
                name="cable",
                shape=Revolution(profile_m=profile_m),
                materials=(self.material,) * 3,
                rotation=np.stack([aside, np.array([0.0, 0.0, 1.0]), along], axis=1),
                translation_m=middle_m - self.length_m / 2 * along,
            ),
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Blanket:
    """Foil that covers the outer edge of the ring's face on a part of the ring."""

    kind: Annotated[Literal["blanket"], Key()]
    angle_rad: Annotated[float, Key(_ANGLE, plausible=ANGLE_RAD)]
    length_m: Annotated[float, Key("Length along the ring.", plausible=PART_M, positive=True)]
    overlap_m: Annotated[
        float,
        Key("Width of the face that it covers.", plausible=DETAIL_M, positive=True, presence=Presence.IF_KNOWN),
    ] = 0.008
    beyond_m: Annotated[
        float,
        Key("Width beyond the outer edge.", plausible=DETAIL_M, positive=True, presence=Presence.IF_KNOWN),
    ] = 0.05
    material: Annotated[Material, Key("Its material.", words=MATERIAL_NAMES, presence=Presence.IF_KNOWN)] = MATERIALS[
        "foil"
    ]
    foil: Annotated[Foil, Key("Its crinkles.", presence=Presence.IF_KNOWN)] = field(default_factory=Foil)

    def parts(self, ring: RingShape) -> tuple[Part, ...]:
        """The blanket as a part of the target."""
        outward = np.array([cos(self.angle_rad), sin(self.angle_rad), 0.0])
        half_m = np.array([(self.overlap_m + self.beyond_m) / 2, self.length_m / 2, BLANKET_M / 2])
        radius_m = ring.radius_outer_m - self.overlap_m + float(half_m[0])
        return (
            Part(
                name="blanket",
                shape=Box(low_m=-half_m, high_m=half_m),
                materials=(self.material,) * 6,
                rotation=np.stack([outward, [-outward[1], outward[0], 0.0], [0.0, 0.0, 1.0]], axis=1),
                translation_m=_on_face_m(ring, self.angle_rad, radius_m, BLANKET_M / 2),
                foil=self.foil,
            ),
        )


Obstacle = Heads | Cable | Blanket


def _middle_m(ring: RingShape) -> float:
    """Radius of the middle of the face."""
    return (ring.radius_inner_m + ring.radius_outer_m) / 2


def _on_face_m(ring: RingShape, angle_rad: float, radius_m: float, height_m: float) -> Float64[Array, "xyz=3"]:
    """A place in the target frame, at this angle and radius and this height above an obstacle's underside."""
    top_m = float(ring.edge_heights_m.max())
    return np.array([radius_m * cos(angle_rad), radius_m * sin(angle_rad), top_m + _ABOVE_M + height_m])
