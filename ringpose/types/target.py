"""The target of a scene: parts of simple shape, each of one or more materials, the interface ring, and the motion.

Target frame: origin on the ring's axis in the plane of the front face that carries the ring, z along the normal of that
face, towards the camera.
"""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import Annotated, Protocol, runtime_checkable

import numpy as np

from ringpose.types.arrays import Array, Float64
from ringpose.types.plausible import ANGLE_RAD, DETAIL_M, PART_M
from ringpose.types.record import Key, Presence


@dataclass(frozen=True, slots=True, kw_only=True)
class Grid:
    """Lines between rectangular cells, as on solar panels."""

    cell_m: Annotated[
        tuple[float, float],
        Key("Period of the lines along the first and the second axis of a face.", plausible=PART_M, positive=True),
    ]
    line_m: Annotated[float, Key("Width of the lines.", plausible=DETAIL_M, positive=True)]
    diffuse: Annotated[float, Key("Albedo of the lines.", least=0, most=1)]
    specular: Annotated[float, Key("Reflectance of their lobe.", least=0, most=1)]
    roughness: Annotated[float, Key("Roughness of the lines.", least=0, most=1)]

    @property
    def contradiction(self) -> tuple[str, str] | None:
        """The key and the finding of values that contradict each other; None if they do not."""
        wide = self.line_m >= min(self.cell_m)
        return ("line_m", f"is {self.line_m:g}, must be less than a cell") if wide else None


@dataclass(frozen=True, slots=True, kw_only=True)
class Material:
    """Reflectance of a surface: Lambert's law plus one GGX lobe."""

    diffuse: Annotated[float, Key("Albedo of the Lambert part.", least=0, most=1)]
    specular: Annotated[float, Key("Reflectance of the GGX lobe at normal incidence.", least=0, most=1)]
    roughness: Annotated[float, Key("GGX alpha: 0.1 for a polished surface, 0.4 for machined metal.", least=0, most=1)]
    grid: Annotated[
        Grid | None, Key("Lines between cells on the faces of boxes and panels.", presence=Presence.IF_KNOWN)
    ] = None


MATERIALS: Mapping[str, Material] = {
    "matt": Material(diffuse=0.30, specular=0.0, roughness=1.0),
    "metal": Material(diffuse=0.12, specular=0.55, roughness=0.35),
    "foil": Material(diffuse=0.06, specular=0.75, roughness=0.22),
    "mirror": Material(diffuse=0.02, specular=0.80, roughness=0.08),
    "white": Material(diffuse=0.80, specular=0.0, roughness=1.0),
    "black": Material(diffuse=0.04, specular=0.0, roughness=1.0),
    "radiator": Material(diffuse=0.70, specular=0.08, roughness=0.15),
    "solar-cells": Material(
        diffuse=0.02,
        specular=0.05,
        roughness=0.08,
        grid=Grid(cell_m=(0.08, 0.04), line_m=0.002, diffuse=0.25, specular=0.4, roughness=0.4),
    ),
}
"""Materials that a scene file may refer to by name; their numbers are assumed, but for the order of magnitude."""

MATERIAL_NAMES: Mapping[Material, str] = {material: name for name, material in MATERIALS.items()}


@dataclass(frozen=True, slots=True, kw_only=True)
class Foil:
    """Crinkles of foil on the faces of a box: a height field, periodic and fixed by its seed."""

    rms_m: Annotated[
        float,
        Key("Root mean square of the heights.", plausible=DETAIL_M, positive=True, presence=Presence.IF_KNOWN),
    ] = 0.0008
    crinkle_m: Annotated[
        float, Key("Size of the largest crinkles.", plausible=DETAIL_M, positive=True, presence=Presence.IF_KNOWN)
    ] = 0.03
    seed: Annotated[int, Key("Which crinkles.", least=0, presence=Presence.IF_KNOWN)] = 1


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Box:
    """A box with axes parallel to those of the part frame; its faces are z+, x-, x+, y-, y+, z-."""

    low_m: Float64[Array, "xyz=3"]
    high_m: Float64[Array, "xyz=3"]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Revolution:
    """A surface of revolution about the z axis of the part frame; its faces are the pieces of its profile."""

    profile_m: Float64[Array, "point radius_height=2"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Gap:
    """A slot with parallel walls across a ring: a pusher's seat, or the room for a bracket."""

    angle_rad: Annotated[
        float, Key("Angle of the gap's middle, from the target frame's x axis towards y.", plausible=ANGLE_RAD)
    ]
    width_m: Annotated[float, Key("Distance of its walls.", plausible=PART_M, positive=True)]
    depth_m: Annotated[float, Key("Depth below the ring's face.", plausible=PART_M, positive=True)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingForm:
    """Deviations of a ring from circles and a plane: Fourier coefficients by order (2, 3, 4) and (cosine, sine)."""

    radial_m: Float64[Array, "edge=2 order=3 wave=2"]
    axial_m: Float64[Array, "order=3 wave=2"]

    def any(self) -> bool:
        """Whether any deviation is not zero."""
        return bool(self.radial_m.any() or self.axial_m.any())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Part:
    """A part of the target: `point_target = rotation @ point_part + translation_m`."""

    name: str
    shape: Box | Revolution
    materials: tuple[Material, ...]
    """Material of each face; of a ring with gaps, also the material of the gaps' walls."""
    rotation: Float64[Array, "3 3"] = field(default_factory=lambda: np.eye(3))
    translation_m: Float64[Array, "xyz=3"] = field(default_factory=lambda: np.zeros(3))
    foil: Foil | None = None
    """Crinkles of all faces of a box."""
    gaps: tuple[Gap, ...] = ()
    form: RingForm | None = None
    mass_kg: float = 0.0


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingShape:
    """A surface of revolution about the ring's axis, given by its profile."""

    profile_m: Float64[Array, "point radius_height=2"]
    """Corners of the profile: radius, and height over the body's front face."""
    face: Material = MATERIALS["metal"]
    wall: Material = MATERIALS["metal"]
    face_edges: tuple[int, int] | None = None
    """Neighbouring points of the profile between which the face lies; by default its highest flat piece."""
    gaps: tuple[Gap, ...] = ()
    form: RingForm | None = None
    mass_kg: float = 0.0

    @property
    def face_piece(self) -> int:
        """Index of the face among the pieces of the profile."""
        if self.face_edges is not None:
            return min(self.face_edges)
        flat = np.flatnonzero(self.profile_m[1:, 1] == self.profile_m[:-1, 1])
        return int(flat[np.argmax(self.profile_m[flat, 1])])

    @property
    def height_m(self) -> float:
        """Height of the face over the body; of a face that slopes, midway between its edges."""
        return float(self.edge_heights_m.mean())

    @property
    def edge_heights_m(self) -> Float64[Array, "edge=2"]:
        """Heights of the face's inner and outer edge over the body."""
        ends = self.profile_m[self.face_piece : self.face_piece + 2]
        return ends[np.argsort(ends[:, 0]), 1]

    @property
    def radius_inner_m(self) -> float:
        """Radius of the face's inner edge."""
        return float(self.profile_m[self.face_piece : self.face_piece + 2, 0].min())

    @property
    def radius_outer_m(self) -> float:
        """Radius of the face's outer edge."""
        return float(self.profile_m[self.face_piece : self.face_piece + 2, 0].max())


def sloping(ring: RingShape, slope_rad: float) -> RingShape:
    """The ring with a conical face, which rises outwards by this angle and is as high as before in its middle."""
    if slope_rad == 0.0:
        return ring
    piece, profile_m = ring.face_piece, ring.profile_m.copy()
    middle_m = (ring.radius_inner_m + ring.radius_outer_m) / 2
    profile_m[piece : piece + 2, 1] += np.tan(slope_rad) * (profile_m[piece : piece + 2, 0] - middle_m)
    return replace(ring, profile_m=profile_m, face_edges=(piece, piece + 1))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Body:
    """The simplest satellite: a box whose front face, at z = 0, carries the ring."""

    size_m: Annotated[
        Float64[Array, "3"],
        Key("Width and height of the front face, depth of the box.", plausible=DETAIL_M, positive=True),
    ]
    offset_m: Annotated[
        Float64[Array, "2"],
        Key(
            "Offset of the front face's middle from the ring's axis, along the ring's x and y.",
            plausible=DETAIL_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = field(default_factory=lambda: np.zeros(2))
    material: Annotated[Material, Key("Material of its faces.", words=MATERIAL_NAMES, presence=Presence.IF_KNOWN)] = (
        MATERIALS["foil"]
    )
    foil: Annotated[Foil | None, Key("Crinkles of its faces; flat without it.", presence=Presence.IF_KNOWN)] = None

    @property
    def inertia_and_center(self) -> tuple[Float64[Array, "3 3"], Float64[Array, "xyz=3"]]:
        """Inertia per kilogram of a uniform box about its centre, and the centre, in the target frame."""
        square = self.size_m**2
        return np.diag((square.sum() - square) / 12), np.array([*self.offset_m, -self.size_m[2] / 2])


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
    """Inertia about the centre of mass, along the axes of the target frame; only ratios matter."""
    center_of_mass_m: Float64[Array, "xyz=3"]
    """Centre of mass in the target frame."""
    angular_velocity_rad_s: Float64[Array, "xyz=3"]
    """Angular velocity at the start, along the axes of the target frame."""
    velocity_m_s: Float64[Array, "xyz=3"] = field(default_factory=lambda: np.zeros(3))
    """Velocity of the centre of mass, in the inertial frame."""
    camera: TimedPoses | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionPreset:
    """A motion: the angular velocity at the start and, if published, the principal moments, in target-frame axes."""

    angular_velocity_rad_s: tuple[float, float, float]
    inertia_kg_m2: tuple[float, float, float] | None = None


def _rate(degrees_s: float, from_axis_deg: float) -> tuple[float, float, float]:
    """An angular velocity whose axis is tilted from the ring's axis towards x, and a third as much towards y."""
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

    def inertial_from_camera(self, time_s: float) -> Float64[Array, "3 3"]:
        """Rotation from the camera frame at a time to the inertial frame, that of the camera at the start."""
