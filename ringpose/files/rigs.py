"""rig.yaml: the camera, the light planes, their covariance, the mount."""

import hashlib
from collections.abc import Iterable, Mapping
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.files import atomic
from ringpose.files.cameras.ros import (
    CAMERA_KEYS,
    camera_of,
    camera_values,
    covariance_values,
    read_covariance,
    without_hints,
)
from ringpose.files.io import provenance, read_bytes
from ringpose.files.kinds import RIG, kind_of
from ringpose.files.records import plain
from ringpose.files.records.codec import OF_FILE, definition_of
from ringpose.files.schema import ROUNDED, Fields, checked_covariance
from ringpose.files.yaml import parsed, write_yaml
from ringpose.types.assumptions import TYPICAL_STABILITY, RigStability
from ringpose.types.plausible import (
    DELAY_S,
    DELAY_SD_S,
    MOUNT_M,
    PLANE_DISTANCE_M,
)
from ringpose.types.rig import LaserPlanes, Mount, Rig, camera_parameters, laser_parameters
from ringpose.types.session import MAX_LASERS

SCHEMA = "rig/1"

MIN_DISTANCE_M = 1e-6
"""Minimum distance of a light plane from the camera's centre; a plane through the centre gives no depth."""

MAX_STRIPE_ANGLE_DEG = 30.0
"""Maximum angle to the rows of a stripe on a surface that faces the camera: stripes are measured column by column, and
the detector finds no ring on steeper ones; above 15 degrees it finds fewer."""

_KEYS = ("ringpose", "provenance", "camera", "lasers", "covariance", "mount", "stability", "quality")
_STABILITY = definition_of(RigStability)
_LASER_KEYS = ("name", "normal", "distance_m", "projector_m")


def read_rig(path: Path, *, for_rings: bool = True) -> Rig:
    """The rig in a rig.yaml, with exactly normalised normals.

    A rig with a laser that cannot measure rings (`steep_stripes`) is rejected unless `for_rings` is false: the light
    planes of such lasers can still be calibrated and checked with boards.
    """
    return rig_in(read_bytes(path), str(path), for_rings=for_rings)


def rig_in(text: bytes, location: str, *, for_rings: bool = True) -> Rig:
    """The rig in the text of a rig.yaml, checked as by `read_rig`; `location` is used in messages."""
    fields = Fields(location, parsed(text, location), _KEYS)
    rig = rig_of(fields, hashlib.sha256(text).hexdigest())
    for entry, finding in zip(fields.each("lasers"), steep_stripes(rig.lasers), strict=True):
        if finding and for_rings:
            raise entry.problem("normal", finding, "mount the camera so that the stripes run along the rows")
    return rig


def rig_of(fields: Fields, sha256: str = "") -> Rig:
    """The rig in a mapping."""
    fields.choice("ringpose", (SCHEMA,))
    camera = camera_of(fields.fields("camera", CAMERA_KEYS))
    lasers = _lasers(fields)
    known = camera_parameters(len(camera.distortion_coefficients)) + laser_parameters(lasers.names)
    return Rig(
        camera=camera,
        lasers=lasers,
        covariance=read_covariance(fields, known),
        mount=_mount(fields) if fields.has("mount") else None,
        stability=_STABILITY.read(fields.fields("stability"), OF_FILE)
        if fields.has("stability")
        else TYPICAL_STABILITY,
        provenance=fields.fields("provenance").values if fields.has("provenance") else {},
        sha256=sha256,
    )


def steep_stripes(lasers: LaserPlanes) -> list[str]:
    """For each laser, why it cannot measure rings (the angle of its stripe to the rows), as text; empty if it can."""
    angles_deg = np.degrees(np.arctan2(np.abs(lasers.normal[:, 0]), np.abs(lasers.normal[:, 1]))).tolist()
    limit = f"at most {MAX_STRIPE_ANGLE_DEG:g}"
    return [
        f"draws a stripe at {angle_deg:.1f} degrees to the image's rows, {limit}"
        if angle_deg > MAX_STRIPE_ANGLE_DEG
        else ""
        for angle_deg in angles_deg
    ]


def read_mount(path: Path) -> Mount:
    """The key `mount` of a rig.yaml, or of a file with this key alone."""
    fields = Fields(str(path), parsed(read_bytes(path), str(path)), _KEYS)
    if not fields.has("mount"):
        remedy = "give its tool_from_camera, run calibrate-mount, or give it to calibrate-planes with --mount"
        raise fields.problem("mount", "is missing", remedy)
    return _mount(fields)


def calibration_quality(path: Path) -> Mapping[str, Any]:
    """The key `quality` of a rig file: how its calibration was assessed; empty if it has none."""
    fields = Fields(str(path), parsed(read_bytes(path), str(path)), _KEYS)
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
    if rig.tool_from_camera is None:
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
    with without_hints():
        rig_of(Fields(str(path), plain(values), _KEYS))
    head = {"ringpose": values.pop("ringpose"), "provenance": provenance(inputs)}
    with atomic.replacing(path, force) as stream:
        write_yaml(stream, head | values | dict(extra))


def write_mount(
    path: Path, mount: Mount, camera: Path, quality: Mapping[str, Any], *, force: bool, inputs: Iterable[Path]
) -> None:
    """Write a rig with this mount, else unchanged; or the mount alone if `camera` is not the file of a rig.

    `quality` becomes the key `quality.mount`.
    """
    fields = Fields(str(camera), parsed(read_bytes(camera), str(camera)))
    if kind_of(fields.values) is RIG:
        both = {"quality": {**calibration_quality(camera), "mount": quality}}
        rig = replace(read_rig(camera, for_rings=False), mount=mount)
        write_rig(path, rig, extra=both, force=force, inputs=inputs)
        return
    head = {"ringpose": SCHEMA, "provenance": provenance(inputs)}
    with atomic.replacing(path, force) as stream:
        write_yaml(stream, head | {"mount": _mount_values(mount), "quality": {"mount": quality}})


def rig_values(rig: Rig) -> dict[str, Any]:
    """The mapping that `rig_of` reads, without provenance."""
    lasers = rig.lasers
    values: dict[str, Any] = {
        "ringpose": SCHEMA,
        "camera": camera_values(rig.camera),
        "lasers": [
            {"name": name, "normal": normal, "distance_m": distance_m}
            | ({"projector_m": projector_m} if np.isfinite(projector_m).all() else {})
            for name, normal, distance_m, projector_m in zip(
                lasers.names, lasers.normal, lasers.distance_m, lasers.projector_m, strict=True
            )
        ],
    }
    if rig.covariance is not None:
        values["covariance"] = covariance_values(rig.covariance)
    if rig.stability != TYPICAL_STABILITY:
        values["stability"] = _STABILITY.write(rig.stability)
    if rig.mount is not None:
        values["mount"] = _mount_values(rig.mount)
    return values


def _mount_values(mount: Mount) -> dict[str, Any]:
    errors = {"covariance": mount.root @ mount.root.T} if mount.root.any() else {}
    delay = {name: getattr(mount, name) for name in ("delay_s", "delay_sd_s") if getattr(mount, name)}
    return {"tool_from_camera": mount.tool_from_camera, **errors, **delay}


def _lasers(fields: Fields) -> LaserPlanes:
    entries = list(fields.each("lasers", _LASER_KEYS))
    if not 1 <= len(entries) <= MAX_LASERS:
        raise fields.problem("lasers", f"has {len(entries)} lasers, must have 1 to {MAX_LASERS}")
    names: list[str] = []
    normals, distances_m = [], []
    for entry in entries:
        name = entry.text("name")
        if "." in name:
            raise entry.problem("name", f"is {name!r}, must not contain a full stop")
        if name in names:
            raise entry.problem("name", f"{name!r} occurs twice")
        names.append(name)
        normals.append(entry.unit_vector("normal", "divide normal and distance_m by it"))
        distances_m.append(entry.quantity("distance_m", PLANE_DISTANCE_M))
        if abs(distances_m[-1]) < MIN_DISTANCE_M:
            raise entry.problem("distance_m", f"is {distances_m[-1]:g}: the plane contains the camera's centre")
    unknown = np.full(3, np.nan)
    return LaserPlanes(
        names=tuple(names),
        normal=np.stack(normals),
        distance_m=np.array(distances_m),
        projector_m=np.stack(
            [
                entry.quantities("projector_m", 3, PLANE_DISTANCE_M) if entry.has("projector_m") else unknown
                for entry in entries
            ]
        ),
    )


def _mount(fields: Fields) -> Mount:
    """The mount; one without `covariance`, `delay_s` or `delay_sd_s` counts as exact in these."""
    mount = fields.fields("mount", ("tool_from_camera", "covariance", "delay_s", "delay_sd_s"))
    matrix = mount.array("tool_from_camera", (4, 4))
    if np.any(matrix[3] != [0, 0, 0, 1]):
        raise mount.problem("tool_from_camera", "must end with the row [0, 0, 0, 1]")
    rotation = matrix[:3, :3]
    if np.abs(rotation @ rotation.T - np.eye(3)).max() > ROUNDED or np.linalg.det(rotation) < 0:
        raise mount.problem("tool_from_camera", "its upper left 3 x 3 matrix is not a rotation")
    mount.check("tool_from_camera", matrix[:3, 3], MOUNT_M)
    left, _, right = np.linalg.svd(rotation)
    covariance = np.zeros((6, 6))
    if mount.has("covariance"):
        covariance = checked_covariance(mount, "covariance", mount.array("covariance", (6, 6)))
    variance, axes = np.linalg.eigh(covariance)
    return Mount(
        tool_from_camera=np.block([[left @ right, matrix[:3, 3:]], [matrix[3:]]]),
        root=axes * np.sqrt(np.maximum(variance, 0.0)),
        delay_s=mount.quantity("delay_s", DELAY_S) if mount.has("delay_s") else 0.0,
        delay_sd_s=mount.quantity("delay_sd_s", DELAY_SD_S) if mount.has("delay_sd_s") else 0.0,
    )
