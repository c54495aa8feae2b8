"""The rig: camera, light planes, their joint covariance, and the robot or tool that carries the camera."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Annotated, Any

import numpy as np

from ringpose.errors import DataError
from ringpose.types import plausible
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import TYPICAL_STABILITY, RigStability
from ringpose.types.options import DistortionModel, PoseFrame
from ringpose.types.record import Form, Key, Presence

CAMERA_PARAMETERS = ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2", "k3", "k4", "k5", "k6")
"""Parameters in the order of OpenCV's Jacobian; a camera with fewer distortion coefficients has the first of them."""

PLANE_PARAMETERS = ("tilt_1", "tilt_2", "distance")
"""Parameters of each light plane."""

BOW_PARAMETERS = ("bow", "projector_1", "projector_2")
"""Parameters of the bend of a light plane: its bow, and its projector's position in the plane, across the direction
nearest to the optical axis and along it."""


def camera_parameters(coefficients: int) -> tuple[str, ...]:
    """Names of a camera's parameters, for this number of distortion coefficients."""
    return CAMERA_PARAMETERS[: 4 + coefficients]


def laser_parameters(names: Sequence[str]) -> tuple[str, ...]:
    """Names of the light planes' parameters, those of each laser in turn."""
    return tuple(f"{name}.{what}" for name in names for what in PLANE_PARAMETERS)


def bow_parameters(names: Iterable[str]) -> tuple[str, ...]:
    """Names of the parameters of the bends of lasers, those of each laser in turn."""
    return tuple(f"{name}.{what}" for name in names for what in BOW_PARAMETERS)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ParameterCovariance:
    """Joint covariance of named parameters; pixels, radians, metres.

    Names: `CAMERA_PARAMETERS`, and `<laser>.tilt_1 <laser>.tilt_2 <laser>.distance` of each light plane (tilt basis:
    `ringpose.geometry.rotations.tilt_basis`), and `BOW_PARAMETERS` of those that are bent.
    """

    parameters: Annotated[
        tuple[str, ...],
        Key(
            "Names of the parameters: `fx`, `fy`, `cx`, `cy`, `k1`, `k2`, `p1`, `p2`, `k3` (to `k6`) in pixels and "
            "without unit, and of a rig `LASER.tilt_1`, `LASER.tilt_2` in radians and `LASER.distance` in metres; of a "
            "bent plane `LASER.bow` in 1/rad and, across the axis and along it, `LASER.projector_1` and "
            "`LASER.projector_2` in metres."
        ),
    ]
    data: Annotated[Float64[Array, "parameter parameter"], Key("Their joint covariance.", form=Form.COVARIANCE)]

    def of(self, names: Sequence[str]) -> Float64[Array, "n n"]:
        """The covariance of these parameters in their order; zero rows and columns for those that it does not have."""
        known = [name for name in names if name in self.parameters]
        here = [names.index(name) for name in known]
        there = [self.parameters.index(name) for name in known]
        covariance = np.zeros((len(names), len(names)))
        covariance[np.ix_(here, here)] = self.data[np.ix_(there, there)]
        return covariance

    @property
    def standard_deviations(self) -> dict[str, float]:
        """Standard deviations by name."""
        return dict(zip(self.parameters, np.sqrt(np.diag(self.data)).tolist(), strict=True))


DISTORTION_COEFFICIENTS = {DistortionModel.PLUMB_BOB.value: 5, DistortionModel.RATIONAL_POLYNOMIAL.value: 8}
"""Number of coefficients of the ROS distortion models that OpenCV supports."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Camera:
    """Intrinsic parameters; pixel (0, 0) is the centre of the top-left pixel."""

    camera_name: str
    image_width: int
    image_height: int
    camera_matrix: Float64[Array, "3 3"]
    distortion_model: str
    distortion_coefficients: Float64[Array, "coefficient"]
    """OpenCV's order: k1, k2, p1, p2, k3 (plumb_bob), and k4, k5, k6 (rational_polynomial)."""
    covariance: ParameterCovariance | None = None
    """Covariance of the intrinsic parameters alone; the joint covariance of a rig is in `Rig`."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ToolPose:
    """Pose of a robot's tool in its base frame."""

    position_m: Annotated[Float64[Array, "xyz=3"], Key("Position of the tool.", plausible=plausible.REACH_M)]
    orientation_xyzw: Annotated[
        Float64[Array, "xyzw=4"], Key("Unit quaternion of the rotation from tool to base.", form=Form.QUATERNION)
    ]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotPose:
    """The pose of a robot at one time, or for one image."""

    base_from_tool: Annotated[ToolPose, Key("Pose of the tool in the base frame.")]
    stamp_s: Annotated[
        float | None,
        Key("Time (Unix time) at which it holds; only a calibration of the mount does without.", form=Form.STAMP,
            null=None, presence=Presence.IF_KNOWN),
    ] = None  # fmt: skip
    shot: Annotated[
        str,
        Key("Name of the image to which it belongs, for a calibration of the mount.", null="",
            presence=Presence.IF_KNOWN),
    ] = ""  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobotPoses:
    """Poses of the tool in the base frame, in the order of their stamps."""

    stamp_s: Float64[Array, "pose"]
    position_m: Float64[Array, "pose xyz=3"]
    rotation: Float64[Array, "pose 3 3"]
    """Rotations from tool to base."""
    repeats: int = 0
    """Identical repeats of these poses that were left out, as republished transforms have them."""


NO_ROBOT_POSES = RobotPoses(stamp_s=np.zeros(0), position_m=np.zeros((0, 3)), rotation=np.zeros((0, 3, 3)))
"""Of a camera that stands in the robot's base, whose pose does not depend on the robot."""


MOUNT_PARAMETERS = (
    "mount.rotation_x", "mount.rotation_y", "mount.rotation_z",
    "mount.translation_x", "mount.translation_y", "mount.translation_z", "mount.delay",
)  # fmt: skip
"""Uncertain parameters of a mount: rotation vector (rad), translation (m) of the camera in its carrier, delay."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mount:
    """How the camera is mounted on a robot's tool or beside the robot, and how well that is known."""

    carrier_from_camera: Float64[Array, "4 4"]
    root: Float64[Array, "6 6"]
    """R of the covariance R R^T of rotation vector (rad) and translation (m), in the carrier's frame."""
    carrier: PoseFrame = PoseFrame.TOOL
    """Frame of what carries the camera: the robot's tool, or its base if the camera stands beside it."""
    robot_rotation_sd_rad: float = 0.0
    """Standard deviation of the robot's orientations about each axis, where its poses are used ..."""
    robot_translation_sd_m: float = 0.0
    """... and of their positions along each axis, in the tool frame."""
    pose_root: Float64[Array, "6 6"] | None = None
    """R of the covariance R R^T of the camera's pose in the frame that needs the robot's poses, if it is known:
    rotation vector and translation along the axes of the tool, by errors of mount and robot, which partly cancel."""
    delay_s: float = 0.0
    """The robot's stamp that belongs to the camera's stamp t is t + delay_s ..."""
    delay_sd_s: float = 0.0
    """... with this standard deviation."""

    @property
    def covariance(self) -> Float64[Array, "parameter=7 parameter=7"]:
        """Covariance of `MOUNT_PARAMETERS`, in their order."""
        covariance = np.zeros((7, 7))
        covariance[:6, :6], covariance[6, 6] = self.root @ self.root.T, self.delay_sd_s**2
        return covariance

    @property
    def uncertain(self) -> tuple[str, ...]:
        """Names of the parameters in `MOUNT_PARAMETERS` that have a variance."""
        return tuple(name for name, sd in zip(MOUNT_PARAMETERS, np.diag(self.covariance), strict=True) if sd > 0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaserPlanes:
    """The light planes, each `normal @ point = distance_m`, in the camera frame."""

    names: tuple[str, ...]
    normal: Float64[Array, "laser xyz=3"]
    distance_m: Float64[Array, "laser"]
    projector_m: Float64[Array, "laser xyz=3"]
    """Position of the projector; NaN if not known."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserGhost:
    """A fainter copy of a laser's light, some rows beside it, by reflections inside the camera."""

    offset_px: Annotated[
        float,
        Key(
            "Row of the copy less that of the light; column where stripes run along columns.",
            plausible=plausible.GHOST_PX,
        ),
    ]
    offset_sd_px: Annotated[float, Key("Standard deviation of the offset from frame to frame.", least=0.0)]
    ratio: Annotated[float, Key("Brightness of the copy over that of the light.", least=0.0, most=1.0)]
    ratio_sd: Annotated[float, Key("Standard deviation of the ratio from frame to frame.", least=0.0)]

    def __str__(self) -> str:
        """As in messages."""
        return (
            f"a ghost at {self.offset_px:+.2f} ± {self.offset_sd_px:.2f} px, "
            f"{100 * self.ratio:.1f} ± {100 * self.ratio_sd:.1f} % as bright"
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class LaserBow:
    """How a sheet of light is bent: `normal @ point - distance_m = per_rad * range * angle**2` in the camera frame.

    Range and angle of a point are those in the plane about the projector (the camera's centre where `projector_m` is
    not known), the angle from the direction nearest to the optical axis (`ringpose.geometry.sheets`).
    """

    per_rad: Annotated[
        float,
        Key("Elevation over its plane, in radians, by the square of the angle in it.", plausible=plausible.BOW_PER_RAD),
    ]
    sd_per_rad: Annotated[
        float, Key("Its standard deviation, used where `covariance` does not have the bow.", least=0.0)
    ]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PlaneCorrection:
    """Correction of a light plane that a stream of shots has shown to have moved."""

    change: Annotated[Float64[Array, "parameter=3"], Key("Of its tilts and its distance, relative to the rig file.")]
    covariance: Annotated[
        Float64[Array, "parameter=3 parameter=3"],
        Key(
            "Of the corrected plane: it replaces that of the calibration and the stability; `nuisance_parameters` of "
            "that plane are increments about the corrected one.",
            form=Form.COVARIANCE,
        ),
    ]


@dataclass(frozen=True, kw_only=True, eq=False)
class Rig:
    """The calibrated measurement system."""

    camera: Camera
    lasers: LaserPlanes
    covariance: ParameterCovariance | None = None
    stability: RigStability = TYPICAL_STABILITY
    """How far light planes and camera may have moved since the calibration."""
    mount: Mount | None = None
    """Mount of the camera on a robot's tool, or in its base; None if it is not known."""
    moved_planes: Mapping[str, PlaneCorrection] = field(default_factory=dict)
    """Corrections by the laser's name; the light planes are the corrected ones."""
    ghosts: Mapping[str, LaserGhost] = field(default_factory=dict)
    """By the laser's name, what calibrate-planes has seen; other lasers may have a ghost that it has not seen."""
    bows: Mapping[str, LaserBow] = field(default_factory=dict)
    """By the laser's name, how its light plane is bent; other planes are flat."""
    provenance: Mapping[str, Any] = field(default_factory=dict)
    sha256: str = ""
    """Hash of the rig file; empty if the rig was not read from a file."""

    @cached_property
    def stripes_along_columns(self) -> bool:
        """Whether its stripes run along the columns of the image rather than along its rows, on surfaces facing it."""
        across = np.abs(self.lasers.normal[:, :2]).sum(axis=0) / np.diag(self.camera.camera_matrix)[:2]
        return bool(across[0] > across[1])


def reject_other_rig(of_record: str, rig: str, location: str, remedy: str) -> None:
    """Reject a record of another rig than the one given, by the SHA-256 of their files; an empty one is unknown."""
    if of_record and rig and of_record != rig:
        raise DataError(location, f"is of another rig ({of_record:.12}, not {rig:.12})", remedy)
