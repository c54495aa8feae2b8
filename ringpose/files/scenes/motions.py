"""The motion of a scene's target: the key `motion` of scene.yaml, trajectory files, mass and inertia of the parts."""

import csv
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import numpy as np

from ringpose.errors import DataError
from ringpose.files import records
from ringpose.files.inputs import file_lines
from ringpose.files.records.codec import OF_FILE, definition_of
from ringpose.files.schema import Fields
from ringpose.types import plausible, target
from ringpose.types.arrays import Array, Float64
from ringpose.types.record import Form, Key, Presence

CSV_COLUMNS = ("time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")

_GAUSS = np.polynomial.legendre.leggauss(3)
"""Nodes and weights, exact for the moments of a straight piece of a profile."""

MAX_SHOTS = 1_000_000
"""Maximum number of shots of a view: a day of shots, one every 0.1 s."""

SYMMETRIC = 1e-9
"""Relative tolerance of the symmetry of an inertia tensor and of the triangle inequality."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TimedPose:
    """A pose at one time, of the camera or of the target."""

    time_s: Annotated[float, Key("Time since the start of the first exposure of a run.")]
    position_m: Annotated[
        Float64[Array, "xyz=3"], Key("Its place.", form=Form.BOUNDED_LENGTH, plausible=plausible.PATH_M)
    ]
    orientation_xyzw: Annotated[
        Float64[Array, "xyzw=4"],
        Key("Unit quaternion; without it, that of no rotation.", form=Form.QUATERNION, presence=Presence.IF_KNOWN),
    ] = field(default_factory=lambda: np.array([0.0, 0.0, 0.0, 1.0]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionEntry:
    """The key `motion` of a scene."""

    preset: Annotated[
        target.MotionPreset | None,
        Key(
            "Name of a motion.",
            words={preset: name for name, preset in target.MOTION_PRESETS.items()},
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    angular_velocity_rad_s: Annotated[
        Float64[Array, "xyz=3"] | None,
        Key(
            "Angular velocity at the start, along the axes of the target frame.",
            form=Form.BOUNDED_LENGTH,
            plausible=plausible.RATE_RAD_S,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    inertia_kg_m2: Annotated[
        Float64[Array, "xyz=3"] | Float64[Array, "3 3"] | None,
        Key("Principal moments, or a tensor, about the centre of mass.", presence=Presence.IF_KNOWN),
    ] = None
    center_of_mass_m: Annotated[
        Float64[Array, "xyz=3"] | None,
        Key("Centre of mass in the target frame.", plausible=plausible.PART_M, presence=Presence.IF_KNOWN),
    ] = None
    velocity_m_s: Annotated[
        Float64[Array, "xyz=3"],
        Key(
            "Velocity of the centre of mass, camera frame at the start.",
            form=Form.BOUNDED_LENGTH,
            plausible=plausible.SPEED_M_S,
            presence=Presence.IF_KNOWN,
        ),
    ] = field(default_factory=lambda: np.zeros(3))
    camera: Annotated[
        tuple[TimedPose, ...] | None,
        Key("The camera's poses in its own frame at the start.", presence=Presence.IF_KNOWN),
    ] = None
    file: Annotated[
        str | None,
        Key("Name of a trajectory file, which has the poses of the target instead.", presence=Presence.IF_KNOWN),
    ] = None
    shots: Annotated[
        int,
        Key("Shots of each view, one every `period_s`.", least=1, most=MAX_SHOTS, presence=Presence.IF_KNOWN),
    ] = 1


def motion_of(
    fields: Fields,
    entry: MotionEntry,
    inertia_kg_m2: Float64[Array, "3 3"],
    center_of_mass_m: Float64[Array, "3"],
    folder: Path,
) -> target.FreeMotion | target.TimedPoses:
    """The motion of an entry, with the target's own inertia and centre of mass where it gives none."""
    if entry.file is not None:
        for key in (key for key in fields.values if key not in ("file", "shots") and fields.has(key)):
            raise fields.problem(key, "cannot be combined with file", "a file has all poses; remove one of them")
        return read_poses(folder / entry.file)
    if entry.preset is None and not any(map(fields.has, ("angular_velocity_rad_s", "velocity_m_s", "camera"))):
        raise fields.problem("", "has no motion", "give preset, angular_velocity_rad_s, velocity_m_s, camera or file")
    rate_rad_s = np.zeros(3)
    if (preset := entry.preset) is not None:
        rate_rad_s = np.array(preset.angular_velocity_rad_s)
        inertia_kg_m2 = inertia_kg_m2 if preset.inertia_kg_m2 is None else np.diag(preset.inertia_kg_m2)
    camera = None
    if entry.camera is not None:
        camera = _timed_poses(zip(fields.each("camera"), entry.camera, strict=True), fields.location("camera"))
        if camera.time_s[0] != 0:
            raise fields.problem("camera", f"begins at {camera.time_s[0]:g} s, must begin at 0")
    own_kg_m2, own_center_m, own_rate_rad_s = entry.inertia_kg_m2, entry.center_of_mass_m, entry.angular_velocity_rad_s
    return target.FreeMotion(
        inertia_kg_m2=inertia_kg_m2 if own_kg_m2 is None else _inertia(fields, own_kg_m2),
        center_of_mass_m=center_of_mass_m if own_center_m is None else own_center_m,
        angular_velocity_rad_s=rate_rad_s if own_rate_rad_s is None else own_rate_rad_s,
        velocity_m_s=entry.velocity_m_s,
        camera=camera,
    )


def _inertia(fields: Fields, given: Float64[Array, "..."]) -> Float64[Array, "3 3"]:
    """Principal moments, or a tensor, of a possible body: symmetric, positive, each moment at most the other two."""
    key = "inertia_kg_m2"
    inertia = np.diag(given) if given.ndim == 1 else given
    if np.abs(inertia - inertia.T).max() > SYMMETRIC * np.abs(inertia).max():
        raise fields.problem(key, "is not symmetric")
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] <= 0:
        raise fields.problem(key, f"has the principal moment {moments[0]:g}, must be positive")
    if moments[2] > (moments[0] + moments[1]) * (1 + SYMMETRIC):
        finding = f"has the principal moments {', '.join(f'{moment:g}' for moment in moments)}"
        raise fields.problem(key, finding, "no body has a moment larger than the sum of the other two")
    return inertia


def read_poses(path: Path) -> target.TimedPoses:
    """The poses in a trajectory file: CSV with the columns `CSV_COLUMNS`, or JSON lines, each a `TimedPose`."""
    lines = file_lines(path)
    if path.suffix.lower() == ".csv":
        entries = _csv_entries((line.decode(errors="replace") for line in lines), str(path))
    else:
        entries = (Fields(location, record) for location, record in records.read(lines, str(path)))
    pose = definition_of(TimedPose)
    return _timed_poses(((entry, pose.read(entry, OF_FILE)) for entry in entries), str(path))


def _csv_entries(lines: Iterator[str], file: str) -> Iterator[Fields]:
    reader = csv.reader(lines)
    header = tuple(cell.strip() for cell in next(reader, []))
    if header != CSV_COLUMNS:
        raise DataError(f"{file}:1", f"has the columns {', '.join(header)}", f"must be {','.join(CSV_COLUMNS)}")
    for row in filter(None, reader):
        location = f"{file}:{reader.line_num}"
        try:
            numbers = [float(cell) for cell in row]
        except ValueError:
            raise DataError(location, "has a value that is not a number") from None
        if len(numbers) != len(CSV_COLUMNS):
            raise DataError(location, f"has {len(numbers)} values, must have {len(CSV_COLUMNS)}")
        values = {"time_s": numbers[0], "position_m": numbers[1:4], "orientation_xyzw": numbers[4:]}
        yield Fields(location, values)


def _timed_poses(poses: Iterable[tuple[Fields, TimedPose]], where: str) -> target.TimedPoses:
    """Poses at ascending times, each with its place for messages."""
    listed: list[TimedPose] = []
    for fields, pose in poses:
        if listed and pose.time_s <= listed[-1].time_s:
            raise fields.problem("time_s", f"is {pose.time_s:g}, not later than the time before")
        listed.append(pose)
    if len(listed) < 2:
        raise DataError(where, f"has {len(listed)} poses, must have at least 2")
    return target.TimedPoses(
        time_s=np.array([pose.time_s for pose in listed]),
        position_m=np.stack([pose.position_m for pose in listed]),
        orientation_xyzw=np.stack([pose.orientation_xyzw for pose in listed]),
    )


def mass_properties(parts: Sequence[target.Part]) -> tuple[float, Float64[Array, "xyz=3"], Float64[Array, "3 3"]]:
    """Mass, centre of mass and inertia about it, in the target frame; NaN where the parts have no mass.

    Boxes are solid and uniform, surfaces of revolution are shells of uniform thickness.
    """
    masses = np.array([part.mass_kg for part in parts])
    mass_kg = float(masses.sum())
    if mass_kg == 0.0:
        return 0.0, np.full(3, np.nan), np.full((3, 3), np.nan)
    moments = [_moments(part.shape) for part in parts]
    centers = np.array(
        [part.rotation @ center + part.translation_m for part, (center, _) in zip(parts, moments, strict=True)]
    )
    center_m: Float64[Array, "xyz=3"] = masses @ centers / mass_kg
    inertia = np.zeros((3, 3))
    for part, (_, own), at in zip(parts, moments, centers - center_m, strict=True):
        steiner = at @ at * np.eye(3) - np.outer(at, at)
        inertia += part.mass_kg * (part.rotation @ np.diag(own) @ part.rotation.T + steiner)
    return mass_kg, center_m, inertia


def _moments(shape: target.Box | target.Revolution) -> tuple[Float64[Array, "xyz=3"], Float64[Array, "xyz=3"]]:
    """Centre of mass, and principal moments about it per kilogram, in the part frame."""
    if isinstance(shape, target.Box):
        square = (shape.high_m - shape.low_m) ** 2
        return (shape.low_m + shape.high_m) / 2, (square.sum() - square) / 12
    first, second = shape.profile_m[:-1, None], shape.profile_m[1:, None]
    share = (1 + _GAUSS[0][:, None]) / 2
    point = first + share * (second - first)
    radius, height = point[..., 0], point[..., 1]
    area = np.linalg.norm(second - first, axis=-1) * _GAUSS[1] / 2 * radius  # but for 2 pi
    area = area / area.sum()
    middle = float((area * height).sum())
    axial, along = float((area * radius**2).sum()), float((area * (height - middle) ** 2).sum())
    return np.array([0.0, 0.0, middle]), np.array([axial / 2 + along, axial / 2 + along, axial])
