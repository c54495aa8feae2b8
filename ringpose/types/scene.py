"""Description of a simulated scene: target, lighting, camera electronics and poses.

Radiometry is in watts per square metre within the camera's pass band. Profile heights are relative to the
body's front face, towards the camera; a pose is that of the ring's *face*, its highest flat piece.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated, Literal

import numpy as np

from ringpose.types import plausible
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import Board
from ringpose.types.obstacles import Obstacle
from ringpose.types.record import Form, Key, Presence
from ringpose.types.rig import Rig
from ringpose.types.target import Body, FreeMotion, Part, RingShape, TargetPath, TimedPoses

TargetKind = Literal["ring", "body", "none"]
"""The body with its ring, the body without it, or stars only."""

_MIN_DIVISOR = 1e-6
"""Minimum of numbers by which others are divided."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Ghost:
    """A fainter copy of the laser lines, as reflections between the surfaces of lenses and windows cause."""

    rows_px: Annotated[
        float, Key("Its offset along the image's columns; negative is upwards.", plausible=plausible.GHOST_PX)
    ]
    ratio: Annotated[float, Key("Its brightness as a share of the line's.", plausible=plausible.SHARE)]


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserLight:
    """The line lasers: a Gaussian sheet of light of uniform intensity over the fan angle."""

    power_w: Annotated[
        float, Key("Power of each laser.", plausible=plausible.LASER_POWER_W, presence=Presence.IF_KNOWN)
    ] = 0.02
    sigma_m: Annotated[
        float,
        Key(
            "Half thickness of the sheet (one sigma) at the projector.",
            plausible=plausible.SHEET_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = 0.0002
    divergence_rad: Annotated[
        float,
        Key(
            "Growth of that half thickness with distance, added in quadrature.",
            plausible=plausible.DIVERGENCE_RAD,
            presence=Presence.IF_KNOWN,
        ),
    ] = 0.0007
    fan_rad: Annotated[
        float,
        Key(
            "Full angle of the fan, around the direction in the plane nearest to the optical axis.",
            plausible=plausible.FAN_RAD,
            presence=Presence.IF_KNOWN,
        ),
    ] = 1.4
    bow_per_rad: Annotated[
        float,
        Key(
            "How the sheets are bent: elevation of a ray over its plane, in radians, by the square of its angle from "
            "the middle of the fan.",
            plausible=plausible.BOW_PER_RAD,
            presence=Presence.IF_KNOWN,
        ),
    ] = 0.0
    ghost: Annotated[Ghost | None, Key("A copy of each line.", presence=Presence.IF_KNOWN)] = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Beacon:
    """A flashing lamp."""

    ambient_w_m2: Annotated[
        float,
        Key(
            "Irradiance while it is on, distributed like the ambient light.",
            plausible=plausible.IRRADIANCE_W_M2,
        ),
    ]
    on_s: Annotated[float, Key("Time for which it is on.", least=_MIN_DIVISOR)]
    off_s: Annotated[float, Key("Time for which it is off.", least=_MIN_DIVISOR)]
    phase_s: Annotated[
        float,
        Key(
            "A time at which it is switched on, on the clock of the frames' stamps.",
            least=0,
            presence=Presence.IF_KNOWN,
        ),
    ] = 0.0

    def share_on(self, begin_s: float, duration_s: float) -> float:
        """Share of an interval during which the lamp is on."""
        begin_s = (begin_s - self.phase_s) % (self.on_s + self.off_s)
        return (self._on_before(begin_s + duration_s) - self._on_before(begin_s)) / duration_s

    def _on_before(self, time_s: float) -> float:
        """Time for which the lamp was on between `phase_s` and a time that is counted from `phase_s`."""
        cycles, rest_s = divmod(time_s, self.on_s + self.off_s)
        return cycles * self.on_s + min(rest_s, self.on_s)


EARTH_RADIUS_M = 6.378e6

GEO_RADIUS_M = 4.2164e7
"""Radius of the geostationary orbit."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Earth:
    """The Earth, lit by the sun, as a sphere of uniform albedo."""

    direction: Annotated[
        Float64[Array, "xyz=3"],
        Key("Direction towards the Earth's centre, camera frame.", form=Form.DIRECTION),
    ]
    orbit_radius_m: Annotated[
        float,
        Key(
            "Distance from the Earth's centre; that of the geostationary orbit without it.",
            least=1.02 * EARTH_RADIUS_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = GEO_RADIUS_M
    albedo: Annotated[float, Key("Albedo of the Earth.", least=0, most=1, presence=Presence.IF_KNOWN)] = 0.3

    @property
    def angular_radius_rad(self) -> float:
        """Half of its angular diameter, which is 17.4 degrees in geostationary orbit."""
        return float(np.arcsin(EARTH_RADIUS_M / self.orbit_radius_m))


SUN_DIAMETER_RAD = 0.00925
"""Angular diameter of the sun, 0.53 degrees."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Light:
    """Illumination other than the lasers."""

    name: str
    ambient_w_m2: float = 0.0
    """Irradiance by the lamps and walls of a laboratory."""
    sun_w_m2: float = 0.0
    """Irradiance on a plane perpendicular to the sun's rays."""
    sun_direction: Float64[Array, "xyz=3"] = field(default_factory=lambda: np.array([-0.66, -0.33, -0.67]))
    """Direction towards the sun, camera frame."""
    sun_diameter_rad: float = SUN_DIAMETER_RAD
    earth: Earth | None = None
    beacon: Beacon | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Optics:
    """Optical parameters of the lens; its distortion is part of the rig."""

    f_number: Annotated[
        float,
        Key(
            "Focal length by the diameter of the pupil.",
            plausible=plausible.F_NUMBER,
            presence=Presence.IF_KNOWN,
        ),
    ] = 8.0
    transmission: Annotated[
        float,
        Key("Share of the light that passes.", least=0, most=1, presence=Presence.IF_KNOWN),
    ] = 0.9
    blur_px: Annotated[
        float,
        Key("Sigma of the point spread function.", plausible=plausible.BLUR_PX, presence=Presence.IF_KNOWN),
    ] = 0.7


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """EMVA 1288's linear camera model."""

    bits: Annotated[
        Literal[8, 12],
        Key("Bits of a pixel; 12 are stored in the lower part of 16.", presence=Presence.IF_KNOWN),
    ] = 8
    pixel_m: Annotated[float, Key("Pitch of the pixels.", plausible=plausible.PIXEL_M, presence=Presence.IF_KNOWN)] = (
        4.5e-6
    )
    quantum_efficiency: Annotated[
        float,
        Key("Electrons by photons.", least=_MIN_DIVISOR, most=1, presence=Presence.IF_KNOWN),
    ] = 0.5
    wavelength_m: Annotated[
        float, Key("Wavelength of the light.", plausible=plausible.WAVELENGTH_M, presence=Presence.IF_KNOWN)
    ] = 650e-9
    saturation_capacity_e: Annotated[
        float,
        Key("Electrons of a saturated pixel.", least=_MIN_DIVISOR, presence=Presence.IF_KNOWN),
    ] = 12000.0
    temporal_dark_noise_e: Annotated[
        float,
        Key("Standard deviation of a dark pixel, in electrons.", least=0, presence=Presence.IF_KNOWN),
    ] = 8.0
    overall_system_gain_dn_per_e: Annotated[
        float,
        Key("Grey values by electrons.", least=_MIN_DIVISOR, presence=Presence.IF_KNOWN),
    ] = 0.0211
    black_level_dn: Annotated[float, Key("Grey value of a dark pixel.", least=0, presence=Presence.IF_KNOWN)] = 2.0
    photo_response_non_uniformity: Annotated[
        float,
        Key("Standard deviation of the pixels' sensitivities, as a share.", least=0, presence=Presence.IF_KNOWN),
    ] = 0.005


@dataclass(frozen=True, slots=True, kw_only=True)
class Speckle:
    """Speckle of laser light on a rough surface, before the blur by the lens."""

    contrast: Annotated[
        float, Key("Standard deviation by mean of the irradiance.", least=0, presence=Presence.IF_KNOWN)
    ] = 0.3
    grain_px: Annotated[
        float,
        Key("Correlation length; up to 1, pixels are independent.", least=0, presence=Presence.IF_KNOWN),
    ] = 1.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingView:
    """Target and light of one shot."""

    name: str
    center_m: Float64[Array, "xyz=3"]
    """Centre of the ring's face; of a moving target, at the beginning of the shot."""
    normal: Float64[Array, "xyz=3"]
    """Normal of the face, towards the camera."""
    roll_rad: float = 0.0
    """Rotation of the body about the normal; at 0 its x axis is nearest to the camera's."""
    light: str = "dim"
    target: TargetKind = "ring"
    groups: Mapping[str, str | float | int | bool] = field(default_factory=dict)
    path: TargetPath | None = None
    """The motion of the target; None if it is still."""
    begin_s: float = 0.0
    """Time on the path at which the shot begins."""


MAX_COUNT = 10_000
"""Maximum number of random poses of a set."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Approach:
    """Random views of a section of the ring near the optical axis, at each of several distances."""

    count: Annotated[
        int,
        Key(
            "Number of poses at each distance; each is combined with every light.",
            least=1,
            most=MAX_COUNT,
            presence=Presence.IF_KNOWN,
        ),
    ] = 1
    distances_m: Annotated[
        tuple[float, ...],
        Key(
            "Depths of the middle of the visible arc.",
            plausible=plausible.DISTANCE_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = (0.5,)
    lights: Annotated[tuple[str, ...], Key("Names of lights.", presence=Presence.IF_KNOWN)] = ("dim",)
    tilt_rad: Annotated[
        float,
        Key(
            "Maximum tilt of the normal from the optical axis, about x and about y.",
            plausible=plausible.TILT_RAD,
            presence=Presence.IF_KNOWN,
        ),
    ] = 0.15
    clock_rad: Annotated[
        float,
        Key(
            "Maximum angle of the middle of the visible arc from the horizontal through the centre.",
            plausible=plausible.TILT_RAD,
            presence=Presence.IF_KNOWN,
        ),
    ] = 0.2
    offset: Annotated[
        float,
        Key(
            "Maximum offset of that point from the image centre, as a share of the image's width and height.",
            plausible=plausible.OFFSET_SHARE,
            presence=Presence.IF_KNOWN,
        ),
    ] = 0.1
    whole: Annotated[
        bool,
        Key(
            "Whether that point is the centre of the ring, so that the whole ring is in view if it is small or far "
            "enough; else it is on the face.",
            presence=Presence.IF_KNOWN,
        ),
    ] = False
    name: Annotated[
        str,
        Key("Beginning of the shots' names.", form=Form.FILE_NAME, presence=Presence.IF_KNOWN),
    ] = "z"
    seed: Annotated[int, Key("Seed of the poses.", least=0, presence=Presence.IF_KNOWN)] = 1
    target: TargetKind = "ring"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NamedBoardPose:
    """Pose of a board in one view: `point_camera = rotation @ point_board + translation_m`."""

    name: str
    rotation: Float64[Array, "3 3"]
    translation_m: Float64[Array, "xyz=3"]


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardApproach:
    """Random views of a board."""

    count: Annotated[
        int,
        Key("Number of views.", least=1, most=MAX_COUNT, presence=Presence.IF_KNOWN),
    ] = 8
    distances_m: Annotated[
        tuple[float, ...],
        Key(
            "Nearest and farthest distance of the board's middle.",
            plausible=plausible.DISTANCE_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = (0.4, 0.6)
    tilt_rad: Annotated[
        float,
        Key(
            "Maximum tilt of the board, about x and about y.",
            plausible=plausible.TILT_RAD,
            presence=Presence.IF_KNOWN,
        ),
    ] = 0.5
    turn_rad: Annotated[
        float,
        Key("Maximum rotation in its own plane.", plausible=plausible.TILT_RAD, presence=Presence.IF_KNOWN),
    ] = 0.3
    offset: Annotated[
        float,
        Key(
            "Maximum offset of its middle from the image centre, as a share of the image's width and height.",
            plausible=plausible.OFFSET_SHARE,
            presence=Presence.IF_KNOWN,
        ),
    ] = 0.2
    seed: Annotated[int, Key("Seed of the poses.", least=0, presence=Presence.IF_KNOWN)] = 1

    @property
    def contradiction(self) -> tuple[str, str] | None:
        """The key and the finding of distances that are not two; None if they are."""
        problem = "distances_m", "must be the nearest and the farthest distance"
        return None if len(self.distances_m) == 2 else problem


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardSet:
    """Views of one calibration board."""

    board: Board
    poses: tuple[NamedBoardPose, ...] = ()
    approach: BoardApproach | None = None
    ambient_w_m2: float = 6.0
    exposure_s: float = 0.004
    sequence: tuple[int, ...] = (0,)
    """Laser mask of each frame."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Scene:
    """Everything that `ringpose simulate` needs."""

    rig: Rig
    ring: RingShape
    lights: Mapping[str, Light]
    body: Body | None = None
    parts: tuple[Part, ...] = ()
    """Parts of the target other than its ring and `body`."""
    obstacles: tuple[Obstacle, ...] = ()
    """What stands on the ring's face or lies over it."""
    gripper: tuple[Part, ...] = ()
    """What is fixed to the camera and seen by it, such as the fingers of a gripper: parts in the camera frame."""
    lasers: LaserLight = LaserLight()
    lens: Optics = Optics()
    sensor: Sensor = Sensor()
    speckle: Speckle = Speckle()
    exposure_s: float = 0.005
    stripe_dn: float | None = None
    """If given, each view's exposure is set so that the stripes on the ring's face have this grey value."""
    period_s: float = 0.1
    """Time between shots."""
    start_s: float = 1767225600.0
    """Time stamp of the first shot: 2026-01-01, 00:00 UTC."""
    sequence: tuple[int, ...] = (0, 7)
    """Laser mask of each frame of a shot."""
    views: tuple[RingView, ...] = ()
    approaches: tuple[Approach, ...] = ()
    motion: FreeMotion | TimedPoses | None = None
    """Motion of the target within and between shots: from the pose of each view on, or through poses in the camera
    frame, those of the target frame; None if it is still."""
    shots: int = 1
    """Shots of each view of a moving target, one every `period_s`."""
    camera_boards: BoardSet | None = None
    plane_boards: BoardSet | None = None
    seed: int = 1
