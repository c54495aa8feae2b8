"""A robot that guides a gripper to the ring, and the record of one such run (ringpose-study(5))."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from math import nan, radians
from typing import Annotated

import numpy as np

from ringpose.types import plausible
from ringpose.types.arrays import Array, Float64
from ringpose.types.record import Form, Key, Presence

WINDOW_M, WINDOW_RAD = 0.002, radians(1.0)
"""Default window of a gripper: its distance from the middle of the band, and its angle to the ring's normal."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FloatingBase:
    """A base that floats freely and carries an arm, whose mass is taken as one point between shoulder and tool."""

    mass_kg: Annotated[
        float, Key("Mass of the base without the arm.", least=1.0, most=1e6, presence=Presence.IF_KNOWN)
    ] = 500.0
    inertia_kg_m2: Annotated[
        Float64[Array, "xyz=3"],
        Key("Its principal moments, along the axes of the base frame.", positive=True, presence=Presence.IF_KNOWN),
    ] = field(default_factory=lambda: np.array([80.0, 80.0, 80.0]))
    arm_mass_kg: Annotated[
        float, Key("Mass of the arm with the tool.", least=0.0, most=1e5, presence=Presence.IF_KNOWN)
    ] = 30.0
    arm_share: Annotated[
        float,
        Key(
            "Where the arm's centre of mass is on the way from the shoulder to the tool.",
            plausible=plausible.SHARE,
            presence=Presence.IF_KNOWN,
        ),
    ] = 0.5
    shoulder_m: Annotated[
        Float64[Array, "xyz=3"],
        Key(
            "The shoulder in the base frame, whose origin is the base's centre of mass.",
            plausible=plausible.PART_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = field(default_factory=lambda: np.array([0.5, 0.0, 0.0]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Arm:
    """A robot whose tool is commanded by velocities in the base frame."""

    speed_m_s: Annotated[
        float, Key("Highest speed of the tool.", least=1e-3, most=10.0, presence=Presence.IF_KNOWN)
    ] = 0.2
    rate_rad_s: Annotated[float, Key("Its highest rate.", least=1e-3, most=10.0, presence=Presence.IF_KNOWN)] = 0.3
    acceleration_m_s2: Annotated[
        float, Key("Highest acceleration.", least=1e-3, most=100.0, presence=Presence.IF_KNOWN)
    ] = 0.2
    angular_acceleration_rad_s2: Annotated[
        float, Key("Highest angular acceleration.", least=1e-3, most=100.0, presence=Presence.IF_KNOWN)
    ] = 0.5
    delay_s: Annotated[
        float, Key("Time from a command to its effect.", least=0.04, most=1.0, presence=Presence.IF_KNOWN)
    ] = 0.05
    jitter_s: Annotated[
        float,
        Key("By how much a command is late beyond that, at most; evenly distributed.", least=0.0, most=1.0,
            presence=Presence.IF_KNOWN),
    ] = 0.01  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CaptureLoop:
    """The loop of a capture: shots, their lines, the guidance, the robot and its gripper."""

    gripper_m: Annotated[
        Float64[Array, "xyz=3"],
        Key(
            "The middle between the gripper's fingers in the camera frame, along whose z axis it approaches.",
            plausible=plausible.PART_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = field(default_factory=lambda: np.array([0.0, 0.0, 0.25]))
    period_s: Annotated[float, Key("Time between shots.", least=0.02, most=10.0, presence=Presence.IF_KNOWN)] = 0.125
    latency_s: Annotated[
        float,
        Key("Time from a shot to its line, unless it is a factor.", least=0.0, most=10.0, presence=Presence.IF_KNOWN),
    ] = 0.06
    timeout_s: Annotated[
        float, Key("Time after which a run ends without closing.", least=1.0, most=3600.0, presence=Presence.IF_KNOWN)
    ] = 60.0
    closing_s: Annotated[
        float,
        Key("Time from the command to close until the fingers meet the ring.", least=0.0, most=10.0,
            presence=Presence.IF_KNOWN),
    ] = 0.1  # fmt: skip
    min_probability: Annotated[
        float,
        Key("Capture probability from which the gripper closes.", plausible=plausible.SHARE,
            presence=Presence.IF_KNOWN),
    ] = 0.95  # fmt: skip
    radial_m: Annotated[
        float,
        Key("Window of the gripper: its distance from the middle of the band.", positive=True,
            presence=Presence.IF_KNOWN),
    ] = WINDOW_M  # fmt: skip
    tilt_rad: Annotated[
        float, Key("The same of its angle to the ring's normal.", positive=True, presence=Presence.IF_KNOWN)
    ] = WINDOW_RAD
    arm: Annotated[Arm, Key("The robot.", presence=Presence.IF_KNOWN)] = Arm()
    base: Annotated[
        FloatingBase, Key("Its base, where the factor `floating_base` is true.", presence=Presence.IF_KNOWN)
    ] = field(default_factory=FloatingBase)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GripperState:
    """The gripper when it closed, in the frame of the true ring."""

    grasp_m: Annotated[Float64[Array, "xyz=3"], Key("The middle between its fingers.")]
    approach: Annotated[
        Float64[Array, "xyz=3"], Key("Its direction, opposite to the ring's normal if it fits.", form=Form.UNIT_VECTOR)
    ]
    radial_m: Annotated[
        float, Key("Largest distance from the middle of the band with which it captures.", positive=True)
    ] = WINDOW_M
    tilt_rad: Annotated[float, Key("Largest angle to the ring's normal likewise.", positive=True)] = WINDOW_RAD


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrueRing:
    """The true ring when the gripper closed."""

    center_m: Annotated[Float64[Array, "xyz=3"], Key("Centre of its face.")]
    normal: Annotated[Float64[Array, "xyz=3"], Key("Normal of its face.", form=Form.UNIT_VECTOR)]
    radius_inner_m: Annotated[float, Key("Radius of the inner edge.", plausible=plausible.RING_RADIUS_M)]
    radius_outer_m: Annotated[float, Key("Radius of the outer edge.", plausible=plausible.RING_RADIUS_M)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CaptureLine:
    """Record of one run: a gripper is guided to the ring, and closes or gives up."""

    software: Annotated[str, Key("Program and version that wrote the line.", null="", added=True)] = ""
    run: Annotated[str, Key("Name of the run.")]
    method: Annotated[str, Key("Method by which the gripper was guided.")]
    groups: Annotated[
        Mapping[str, str | float | int | bool],
        Key("Names and values by which `ringpose bench capture` makes its table.", presence=Presence.IF_KNOWN),
    ] = field(default_factory=dict)
    closed_s: Annotated[
        float, Key("Time from the start to the closing; null if it did not close.", null=nan, least=0.0)
    ]
    reason: Annotated[str, Key("Why it did not close; null if it did.", null="")] = ""
    gripper: Annotated[GripperState | None, Key("The gripper at the closing; null if it did not close.")] = None
    ring: Annotated[TrueRing | None, Key("The true ring at the closing; null if it did not close.")] = None
    capture_probability: Annotated[
        float | None,
        Key(
            "Probability, computed before the closing from the pose's own covariance, that the ring is within the "
            "gripper's window; null for a method that states no covariance.",
            least=0.0,
            most=1.0,
        ),
    ] = None

    @property
    def is_closed(self) -> bool:
        """Whether the gripper closed."""
        return self.gripper is not None and self.ring is not None
