"""Description of a simulated scene: target, lighting, camera electronics and poses.

Radiometry is in watts per square metre within the camera's pass band. Profile heights are relative to the
body's front face, towards the camera; a pose is that of the ring's *face*, its highest flat piece.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, Protocol, runtime_checkable

import numpy as np

from ringpose.types.arrays import Array, Float64
from ringpose.types.board import Board
from ringpose.types.rig import Rig

TargetKind = Literal["ring", "body", "none"]
"""The body with its ring, the body without it, or stars only."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    """Reflectance of a surface: Lambert's law plus one GGX lobe."""

    diffuse: float
    """Albedo of the Lambert part."""
    specular: float
    """Reflectance of the lobe at normal incidence."""
    roughness: float
    """GGX alpha: 0.1 for a polished surface, 0.4 for machined metal."""


MATERIALS: Mapping[str, Material] = {
    "matt": Material(diffuse=0.30, specular=0.0, roughness=1.0),
    "metal": Material(diffuse=0.12, specular=0.55, roughness=0.35),
    "foil": Material(diffuse=0.06, specular=0.75, roughness=0.22),
    "white": Material(diffuse=0.80, specular=0.0, roughness=1.0),
    "black": Material(diffuse=0.04, specular=0.0, roughness=1.0),
}
"""Materials that a scene file may refer to by name."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingShape:
    """A surface of revolution about the ring's axis, given by its profile."""

    profile_m: Float64[Array, "point radius_height=2"]
    """Corners of the profile: radius, and height over the body's front face."""
    face: Material = MATERIALS["metal"]
    wall: Material = MATERIALS["metal"]

    @property
    def face_piece(self) -> int:
        """Index of the profile's highest flat piece."""
        flat = np.flatnonzero(self.profile_m[1:, 1] == self.profile_m[:-1, 1])
        return int(flat[np.argmax(self.profile_m[flat, 1])])

    @property
    def height_m(self) -> float:
        """Height of the face over the body."""
        return float(self.profile_m[self.face_piece, 1])

    @property
    def radius_inner_m(self) -> float:
        """Radius of the face's inner edge."""
        return float(self.profile_m[self.face_piece : self.face_piece + 2, 0].min())

    @property
    def radius_outer_m(self) -> float:
        """Radius of the face's outer edge."""
        return float(self.profile_m[self.face_piece : self.face_piece + 2, 0].max())


@dataclass(frozen=True, slots=True, kw_only=True)
class Foil:
    """Crinkles of the foil on the body's front face: a height field, periodic and fixed by its seed."""

    rms_m: float = 0.0008
    crinkle_m: float = 0.03
    """Size of the largest crinkles."""
    seed: int = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Body:
    """The satellite: a box whose front face carries the ring."""

    size_m: Float64[Array, "3"]
    """Width and height of the front face, depth of the box."""
    offset_m: Float64[Array, "2"] = field(default_factory=lambda: np.zeros(2))
    """Offset of the front face's middle from the ring's axis, along the ring's x and y."""
    material: Material = MATERIALS["foil"]
    foil: Foil | None = None

    @property
    def inertia_and_center(self) -> tuple[Float64[Array, "3 3"], Float64[Array, "xyz=3"]]:
        """Inertia per kilogram of a uniform box about its centre, and the centre, in the target frame."""
        square = self.size_m**2
        return np.diag((square.sum() - square) / 12), np.array([*self.offset_m, -self.size_m[2] / 2])


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserLight:
    """The line lasers: a Gaussian sheet of light of uniform intensity over the fan angle."""

    power_w: float = 0.02
    sigma_m: float = 0.0002
    """Half thickness of the sheet (one sigma) at the projector."""
    divergence_rad: float = 0.0007
    """Growth of that half thickness with distance, added in quadrature."""
    fan_rad: float = 1.4
    """Full angle of the fan, around the direction in the plane nearest to the optical axis."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Beacon:
    """A flashing lamp."""

    ambient_w_m2: float
    """Irradiance while it is on, distributed like the ambient light."""
    on_s: float
    off_s: float
    phase_s: float = 0.0
    """A time at which it is switched on, on the clock of the frames' time stamps."""

    def share_on(self, begin_s: float, duration_s: float) -> float:
        """Share of an interval during which it is on."""
        begin_s = (begin_s - self.phase_s) % (self.on_s + self.off_s)
        return (self._on_before(begin_s + duration_s) - self._on_before(begin_s)) / duration_s

    def _on_before(self, time_s: float) -> float:
        """Duration for which it was on since the phase, at a time relative to the phase."""
        cycles, rest_s = divmod(time_s, self.on_s + self.off_s)
        return cycles * self.on_s + min(rest_s, self.on_s)


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
    beacon: Beacon | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Lens:
    """Optical parameters of the lens; its distortion is part of the rig."""

    f_number: float = 8.0
    transmission: float = 0.9
    blur_px: float = 0.7
    """Sigma of the point spread function."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sensor:
    """EMVA 1288's linear camera model."""

    bits: Literal[8, 12] = 8
    """12 bits are stored in the lower part of 16."""
    pixel_m: float = 4.5e-6
    quantum_efficiency: float = 0.5
    wavelength_m: float = 650e-9
    saturation_capacity_e: float = 12000.0
    temporal_dark_noise_e: float = 8.0
    overall_system_gain_dn_per_e: float = 0.0211
    black_level_dn: float = 2.0
    photo_response_non_uniformity: float = 0.005


@dataclass(frozen=True, slots=True, kw_only=True)
class Speckle:
    """Speckle of laser light on a rough surface, before the blur by the lens."""

    contrast: float = 0.3
    grain_px: float = 1.0
    """Correlation length; up to 1, pixels are independent."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TimedPoses:
    """Poses at ascending times, of the camera or of the target; between them they are interpolated."""

    time_s: Float64[Array, "pose"]
    """Time since the start of the first exposure of a run."""
    position_m: Float64[Array, "pose xyz=3"]
    orientation_xyzw: Float64[Array, "pose 4"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FreeMotion:
    """Torque-free motion of the target past a camera, from the pose of a view on.

    The inertial frame is that of the camera at the start; `camera` has the camera's later poses in it.
    """

    inertia_kg_m2: Float64[Array, "3 3"]
    """About the centre of mass, along the axes of the target frame; only ratios matter."""
    center_of_mass_m: Float64[Array, "xyz=3"]
    """In the target frame."""
    angular_velocity_rad_s: Float64[Array, "xyz=3"]
    """At the start, along the axes of the target frame."""
    velocity_m_s: Float64[Array, "xyz=3"] = field(default_factory=lambda: np.zeros(3))
    """Of the centre of mass, in the inertial frame."""
    camera: TimedPoses | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionPreset:
    """Angular velocity at the start, and where published the principal moments, along the axes of the target frame."""

    angular_velocity_rad_s: tuple[float, float, float]
    inertia_kg_m2: tuple[float, float, float] | None = None


def _rate(degrees_s: float, from_axis_deg: float) -> tuple[float, float, float]:
    """An angular velocity at an angle from the ring's axis, towards x and a third as much towards y."""
    rate_rad_s, angle_rad = np.radians(degrees_s), np.radians(from_axis_deg)
    across = rate_rad_s * np.sin(angle_rad) / np.sqrt(10.0)
    return float(3 * across), float(across), float(rate_rad_s * np.cos(angle_rad))


MOTION_PRESETS: Mapping[str, MotionPreset] = {
    # Retired satellites in GEO tumble "well below ... one degree per second": Binz et al., an optical survey by NRL,
    # AMOS 2014. The axis is assumed, so that they nutate.
    "geo-typical": MotionPreset(angular_velocity_rad_s=_rate(0.3, 30.0)),
    "geo-bound": MotionPreset(angular_velocity_rad_s=_rate(1.0, 30.0)),
    # 2.67 deg/s by laser ranging on 2013-09-25 (period 134.74 s); moments of inertia and axis as in published
    # parameter files of simulations. The ring's axis is assumed to be that of the smallest moment.
    "envisat": MotionPreset(
        angular_velocity_rad_s=(float(np.radians(1.2535)), 0.0, float(np.radians(2.3575))),
        inertia_kg_m2=(129180.25, 124801.21, 16979.74),
    ),
    "stress": MotionPreset(angular_velocity_rad_s=_rate(8.0, 30.0)),
}
"""Motions that a scene file may refer to by name."""


@runtime_checkable
class TargetPath(Protocol):
    """The motion of the target in the camera frame."""

    def camera_from_target(self, time_s: float) -> tuple[Float64[Array, "3 3"], Float64[Array, "xyz=3"]]:
        """Rotation and translation at a time since the start of the run."""


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


@dataclass(frozen=True, slots=True, kw_only=True)
class Approach:
    """Random views of a section of the ring near the optical axis, at each of several distances."""

    count: int = 1
    """Number of poses at each distance; each is combined with every light."""
    distances_m: tuple[float, ...] = (0.5,)
    lights: tuple[str, ...] = ("dim",)
    tilt_rad: float = 0.15
    """Maximum tilt of the normal from the optical axis, about x and about y."""
    clock_rad: float = 0.2
    """Maximum angle of the middle of the visible arc from the horizontal through the centre."""
    offset: float = 0.1
    """Maximum offset of that point from the image centre, as a share of the image's width and height."""
    name: str = "z"
    seed: int = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NamedBoardPose:
    """Pose of a board in one view: `point_camera = rotation @ point_board + translation_m`."""

    name: str
    rotation: Float64[Array, "3 3"]
    translation_m: Float64[Array, "xyz=3"]


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardApproach:
    """Random views of a board."""

    count: int = 8
    distances_m: tuple[float, float] = (0.4, 0.6)
    """Nearest and farthest distance of the board's middle."""
    tilt_rad: float = 0.5
    """Maximum tilt of the board, about x and about y."""
    turn_rad: float = 0.3
    """Maximum rotation in its own plane."""
    offset: float = 0.2
    """Maximum offset of its middle from the image centre, as a share of the image's width and height."""
    seed: int = 1


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
    body: Body
    lights: Mapping[str, Light]
    lasers: LaserLight = LaserLight()
    lens: Lens = Lens()
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
