"""rig.yaml: the camera, the light planes, their covariance, the mount."""

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any

import numpy as np

from ringpose.errors import DataError
from ringpose.files import atomic
from ringpose.files.cameras import ros
from ringpose.files.io import provenance, read_bytes
from ringpose.files.records import plain
from ringpose.files.records.codec import OF_FILE, RecordType, definition_of
from ringpose.files.schema import RIG, ROUNDED, Fields, kind_of
from ringpose.files.yaml import parsed, write_yaml
from ringpose.geometry.least_squares import square_root
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import TYPICAL_STABILITY, RigStability
from ringpose.types.options import PoseFrame
from ringpose.types.plausible import (
    DELAY_S,
    DELAY_SD_S,
    MOUNT_M,
    PLANE_DISTANCE_M,
    ROBOT_SD_M,
    ROBOT_SD_RAD,
)
from ringpose.types.record import Form, Key, Presence
from ringpose.types.rig import (
    LaserBow,
    LaserGhost,
    LaserPlanes,
    Mount,
    ParameterCovariance,
    Rig,
    bow_parameters,
    camera_parameters,
    laser_parameters,
)
from ringpose.types.session import MAX_LASERS

SCHEMA = "rig/1"

MIN_DISTANCE_M = 1e-6
"""Minimum distance of a light plane from the camera's centre; a plane through the centre gives no depth."""

MAX_STRIPE_ANGLE_DEG = 30.0
"""Maximum angle to the rows, or to the columns if the stripes run along these, of a stripe on a surface that faces the
camera: stripes are measured column by column (row by row), and the detector finds no ring on steeper ones; above 15
degrees it finds fewer."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LaserEntry:
    """A laser of a rig.yaml: `normal @ point = distance_m` in the camera frame."""

    name: Annotated[str, Key("Name of the laser, without a full stop.")]
    normal: Annotated[
        Float64[Array, "xyz=3"],
        Key("Unit normal of its light plane.", form=Form.UNIT_VECTOR, remedy="divide normal and distance_m by it"),
    ]
    distance_m: Annotated[
        float, Key("Signed distance of the plane: normal . point = distance_m.", plausible=PLANE_DISTANCE_M)
    ]
    projector_m: Annotated[
        Float64[Array, "xyz=3"] | None,
        Key("Position of the projector.", plausible=PLANE_DISTANCE_M, presence=Presence.IF_KNOWN),
    ] = None
    ghost: Annotated[LaserGhost | None, Key("Ghost of its stripes.", presence=Presence.IF_KNOWN)] = None
    bow: Annotated[LaserBow | None, Key("How its light plane is bent.", presence=Presence.IF_KNOWN)] = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MountEntry:
    """How the camera is mounted on the robot's tool, or beside the robot."""

    tool_from_camera: Annotated[
        Float64[Array, "4 4"] | None,
        Key("Pose of the camera in the tool frame, if the robot carries it.", presence=Presence.IF_KNOWN),
    ] = None
    base_from_camera: Annotated[
        Float64[Array, "4 4"] | None,
        Key("Pose of a camera that does not move, in the robot's base frame.", presence=Presence.IF_KNOWN),
    ] = None
    covariance: Annotated[
        Float64[Array, "6 6"] | None,
        Key(
            "Covariance of rotation vector (rad) and translation (m), in the frame of tool or base; exact without it.",
            form=Form.COVARIANCE,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    delay_s: Annotated[
        float,
        Key(
            "The robot's stamp that belongs to the camera's stamp t is t + delay_s.",
            plausible=DELAY_S,
            presence=Presence.IF_KNOWN,
        ),
    ] = 0.0
    delay_sd_s: Annotated[
        float, Key("Standard deviation of the delay.", plausible=DELAY_SD_S, presence=Presence.IF_KNOWN)
    ] = 0.0
    robot_rotation_sd_rad: Annotated[
        float,
        Key(
            "Standard deviation of the robot's orientation about each axis, of poses in a frame that needs its poses.",
            plausible=ROBOT_SD_RAD,
            presence=Presence.IF_KNOWN,
        ),
    ] = 0.0
    robot_translation_sd_m: Annotated[
        float,
        Key("The same of its position along each axis.", plausible=ROBOT_SD_M, presence=Presence.IF_KNOWN),
    ] = 0.0
    pose_covariance: Annotated[
        Float64[Array, "6 6"] | None,
        Key(
            "Covariance of the camera's pose in the frame that needs the robot's poses, by mount and robot together, "
            "along the axes of the tool; instead of the two before.",
            form=Form.COVARIANCE,
            presence=Presence.IF_KNOWN,
        ),
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigFile:
    """rig.yaml."""

    provenance: Annotated[
        Mapping[str, Any] | None, Key("Version, command, time and inputs.", presence=Presence.IF_KNOWN)
    ] = None
    camera: Annotated[ros.CameraInfo, Key("The camera, with the keys of ROS camera_info; see camera.yaml below.")]
    lasers: Annotated[tuple[LaserEntry, ...], Key("The lasers, in the order of a mask's bits.")]
    covariance: Annotated[
        ParameterCovariance | None,
        Key("Joint covariance of camera and light planes.", presence=Presence.IF_KNOWN),
    ] = None
    stability: Annotated[
        RigStability,
        Key("Standard deviations of the rig's parameters since the calibration.", presence=Presence.IF_KNOWN),
    ] = TYPICAL_STABILITY
    mount: Annotated[MountEntry | None, Key("How the camera is mounted.", presence=Presence.IF_KNOWN)] = None
    quality: Annotated[
        Mapping[str, Any] | None, Key("How the calibration was assessed; informative.", presence=Presence.IF_KNOWN)
    ] = None


RECORD = RecordType(
    cls=RigFile,
    kind=RIG,
    version=SCHEMA,
    description="rig.yaml: a camera and the light planes of its lasers. Metres, radians, pixels, seconds. Your own "
    "keys begin with x_.",
    is_file=True,
    strict=True,
)


def read_rig(path: Path, *, for_rings: bool = True) -> Rig:
    """The rig in a rig.yaml, with exactly normalised normals.

    A rig with a laser that cannot measure rings (`steep_stripes`) is rejected unless `for_rings` is false: the light
    planes of such lasers can still be calibrated and checked with boards.
    """
    return rig_in(read_bytes(path), str(path), for_rings=for_rings)


def rig_in(text: bytes, location: str, *, for_rings: bool = True) -> Rig:
    """The rig in the text of a rig.yaml, checked as by `read_rig`; `location` is used in messages."""
    fields = Fields(location, parsed(text, location), RECORD.keys)
    rig = rig_of(fields, hashlib.sha256(text).hexdigest())
    for entry, finding in zip(fields.each("lasers"), steep_stripes(rig), strict=True):
        if finding and for_rings:
            remedy = "mount the camera so that the stripes of all lasers run along the rows, or along the columns"
            raise entry.problem("normal", finding, remedy)
    return rig


def rig_of(fields: Fields, sha256: str = "") -> Rig:
    """The rig in a mapping."""
    fields.choice("ringpose", (SCHEMA,))
    entry = definition_of(RigFile).read(fields, OF_FILE)
    camera, lasers = ros.checked_camera(fields.fields("camera"), entry.camera), _lasers(fields, entry.lasers)
    bows = {laser.name: laser.bow for laser in entry.lasers if laser.bow is not None}
    known = camera_parameters(len(camera.distortion_coefficients)) + laser_parameters(lasers.names)
    known += bow_parameters(bows)
    return Rig(
        camera=camera,
        lasers=lasers,
        covariance=ros.checked_parameters(fields, entry.covariance, known),
        mount=None if entry.mount is None else _mount(fields.fields("mount"), entry.mount),
        stability=entry.stability,
        ghosts={laser.name: laser.ghost for laser in entry.lasers if laser.ghost is not None},
        bows=bows,
        provenance=entry.provenance or {},
        sha256=sha256,
    )


def steep_stripes(rig: Rig) -> list[str]:
    """For each laser, why it cannot measure rings (the angle of its stripe to the others), as text; empty if it can."""
    along, lines = (0, "columns") if rig.stripes_along_columns else (1, "rows")
    across = np.abs(rig.lasers.normal[:, [1 - along, along]])
    limit = f"at most {MAX_STRIPE_ANGLE_DEG:g}"
    return [
        f"draws a stripe at {angle_deg:.1f} degrees to the image's {lines}, {limit}"
        if angle_deg > MAX_STRIPE_ANGLE_DEG
        else ""
        for angle_deg in np.degrees(np.arctan2(*across.T)).tolist()
    ]


def read_mount(path: Path) -> Mount:
    """The key `mount` of a rig.yaml, or of a file with this key alone."""
    fields = Fields(str(path), parsed(read_bytes(path), str(path)), RECORD.keys)
    if not fields.has("mount"):
        remedy = "run calibrate-mount, or give its tool_from_camera (ringpose-conventions(7))"
        raise fields.problem("mount", "is missing", remedy)
    mount = fields.fields("mount")
    return _mount(mount, definition_of(MountEntry).read(mount, OF_FILE))


def calibration_quality(path: Path) -> Mapping[str, Any]:
    """The key `quality` of a rig file: how its calibration was assessed; empty if it has none."""
    fields = Fields(str(path), parsed(read_bytes(path), str(path)), RECORD.keys)
    return fields.fields("quality").values if fields.has("quality") else {}


def median_board_rms_px(path: Path) -> float | None:
    """RMS reprojection error of the corners in the calibration of the rig, the median over its boards, in pixels.

    None if the file does not contain it.
    """
    boards = calibration_quality(path).get("boards")
    values = [board.get("rms_px") for board in boards or () if isinstance(board, Mapping)]
    numbers = [rms_px for rms_px in values if isinstance(rms_px, float) and np.isfinite(rms_px)]
    return float(np.median(numbers)) if numbers else None


def require_mount(rig: Rig, path: Path) -> None:
    """Reject a rig without a mount."""
    if rig.mount is None:
        raise DataError(str(path), "has no mount", "run calibrate-mount, or use --frame camera")


def write_rig(
    path: Path,
    rig: Rig,
    *,
    extra: Mapping[str, Any] = MappingProxyType({}),
    force: bool = False,
    inputs: Iterable[Path] = (),
) -> None:
    """Write rig.yaml with provenance; `extra` may have the key `quality`, which is not needed by `read_rig`.

    A rig that `rig_of` would reject is not written. A rig with steep stripes is written, as its light planes are valid.
    """
    values = rig_values(rig)
    with ros.without_hints():
        rig_of(Fields(str(path), plain(values), RECORD.keys))
    head = {"ringpose": values.pop("ringpose"), "provenance": provenance(inputs)}
    with atomic.replacing(path, force) as stream:
        write_yaml(stream, head | values | dict(extra))


def write_mount(
    path: Path,
    mount: Mount,
    camera: Path,
    quality: Mapping[str, Any],
    *,
    force: bool,
    inputs: Iterable[Path],
) -> None:
    """Write a rig with this mount, else unchanged; or the mount alone if `camera` is not the file of a rig.

    `quality` becomes the key `quality.mount`. A mount whose delay was not estimated has that of the rig.
    """
    if kind_of(Fields(str(camera), parsed(read_bytes(camera), str(camera))).values) is RIG:
        both = {"quality": {**calibration_quality(camera), "mount": quality}}
        rig = read_rig(camera, for_rings=False)
        if rig.mount is not None and not mount.delay_sd_s:
            mount = replace(mount, delay_s=rig.mount.delay_s, delay_sd_s=rig.mount.delay_sd_s)
        rig = replace(rig, mount=mount)
        write_rig(path, rig, extra=both, force=force, inputs=inputs)
        return
    alone = dict(definition_of(MountEntry).write(_mount_entry(mount)))
    head = {"ringpose": SCHEMA, "provenance": provenance(inputs)}
    with atomic.replacing(path, force) as stream:
        write_yaml(stream, head | {"mount": alone, "quality": {"mount": quality}})


def rig_values(rig: Rig) -> dict[str, Any]:
    """The mapping that `rig_of` reads, without provenance."""
    lasers, mount = rig.lasers, rig.mount
    entries = tuple(
        LaserEntry(
            name=name,
            normal=normal,
            distance_m=distance_m,
            projector_m=projector_m if np.isfinite(projector_m).all() else None,
            ghost=rig.ghosts.get(name),
            bow=rig.bows.get(name),
        )
        for name, normal, distance_m, projector_m in zip(
            lasers.names, lasers.normal, lasers.distance_m.tolist(), lasers.projector_m, strict=True
        )
    )
    return RECORD.write(
        RigFile(
            camera=ros.camera_info(rig.camera),
            lasers=entries,
            covariance=rig.covariance,
            stability=rig.stability,
            mount=None if mount is None else _mount_entry(mount),
        )
    )


def _mount_entry(mount: Mount) -> MountEntry:
    is_on_tool = mount.carrier is PoseFrame.TOOL
    return MountEntry(
        tool_from_camera=mount.carrier_from_camera if is_on_tool else None,
        base_from_camera=None if is_on_tool else mount.carrier_from_camera,
        covariance=mount.root @ mount.root.T if mount.root.any() else None,
        delay_s=mount.delay_s,
        delay_sd_s=mount.delay_sd_s,
        robot_rotation_sd_rad=mount.robot_rotation_sd_rad,
        robot_translation_sd_m=mount.robot_translation_sd_m,
        pose_covariance=None if mount.pose_root is None else mount.pose_root @ mount.pose_root.T,
    )


def _lasers(fields: Fields, entries: Sequence[LaserEntry]) -> LaserPlanes:
    if not 1 <= len(entries) <= MAX_LASERS:
        raise fields.problem("lasers", f"has {len(entries)} lasers, must have 1 to {MAX_LASERS}")
    names = [entry.name for entry in entries]
    for number, entry in enumerate(entries):
        if "." in entry.name:
            raise fields.problem(f"lasers[{number}].name", f"is {entry.name!r}, must not contain a full stop")
        if entry.name in names[:number]:
            raise fields.problem(f"lasers[{number}].name", f"{entry.name!r} occurs twice")
        if abs(entry.distance_m) < MIN_DISTANCE_M:
            finding = f"is {entry.distance_m:g}: the plane contains the camera's centre"
            raise fields.problem(f"lasers[{number}].distance_m", finding)
    unknown = np.full(3, np.nan)
    return LaserPlanes(
        names=tuple(names),
        normal=np.stack([entry.normal for entry in entries]),
        distance_m=np.array([entry.distance_m for entry in entries]),
        projector_m=np.stack([unknown if entry.projector_m is None else entry.projector_m for entry in entries]),
    )


def _mount(fields: Fields, entry: MountEntry) -> Mount:
    """The mount; one without `covariance`, `delay_s` or `delay_sd_s` counts as exact in these."""
    is_on_tool = entry.tool_from_camera is not None
    key, matrix = ("tool_from_camera" if is_on_tool else "base_from_camera"), entry.tool_from_camera
    if matrix is None:
        matrix = entry.base_from_camera
    elif entry.base_from_camera is not None:
        raise fields.problem("base_from_camera", "and tool_from_camera exclude each other", "leave one of them out")
    if matrix is None:
        raise fields.problem("", "has neither tool_from_camera nor base_from_camera", "run calibrate-mount")
    if np.any(matrix[3] != [0, 0, 0, 1]):
        raise fields.problem(key, "must end with the row [0, 0, 0, 1]")
    rotation = matrix[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > ROUNDED or np.linalg.det(rotation) < 0:
        raise fields.problem(key, "its upper left 3 x 3 matrix is not a rotation")
    fields.check(key, matrix[:3, 3], MOUNT_M)
    left, _, right = np.linalg.svd(rotation)
    if entry.pose_covariance is not None and max(entry.robot_rotation_sd_rad, entry.robot_translation_sd_m) > 0.0:
        finding = "contains the robot's error, which robot_rotation_sd_rad and robot_translation_sd_m state, too"
        raise fields.problem("pose_covariance", finding, "leave one of them out")
    return Mount(
        carrier_from_camera=np.block([[left @ right, matrix[:3, 3:]], [matrix[3:]]]),
        carrier=PoseFrame.TOOL if is_on_tool else PoseFrame.BASE,
        root=np.zeros((6, 6)) if entry.covariance is None else square_root(entry.covariance),
        delay_s=entry.delay_s,
        delay_sd_s=entry.delay_sd_s,
        robot_rotation_sd_rad=entry.robot_rotation_sd_rad,
        robot_translation_sd_m=entry.robot_translation_sd_m,
        pose_root=None if entry.pose_covariance is None else square_root(entry.pose_covariance),
    )
