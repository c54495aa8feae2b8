"""The motion of a scene's target: the key `motion` of scene.yaml, trajectory files, mass and inertia of the parts."""

import csv
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.files import records
from ringpose.files.inputs import file_lines
from ringpose.files.schema import Fields
from ringpose.types.arrays import Array, Float64
from ringpose.types.plausible import PART_M, PATH_M, RATE_RAD_S, SPEED_M_S
from ringpose.types.target import MOTION_PRESETS, Box, FreeMotion, Part, Revolution, TimedPoses

MOTION_KEYS = (
    "preset",
    "inertia_kg_m2",
    "center_of_mass_m",
    "angular_velocity_rad_s",
    "velocity_m_s",
    "camera",
    "file",
    "shots",
)

POSE_KEYS = ("time_s", "position_m", "orientation_xyzw")

CSV_COLUMNS = ("time_s", "x_m", "y_m", "z_m", "qx", "qy", "qz", "qw")

_GAUSS = np.polynomial.legendre.leggauss(3)
"""Nodes and weights, exact for the moments of a straight piece of a profile."""

SYMMETRIC = 1e-9
"""Relative tolerance of the symmetry of an inertia tensor and of the triangle inequality."""


def read_motion(
    fields: Fields, inertia_kg_m2: Float64[Array, "3 3"], center_of_mass_m: Float64[Array, "3"], folder: Path
) -> FreeMotion | TimedPoses:
    """The motion in a mapping, with the target's own inertia and centre of mass where it gives none."""
    if fields.has("file"):
        others = [key for key in MOTION_KEYS if fields.has(key) and key not in ("file", "shots")]
        if others:
            raise fields.problem(others[0], "cannot be combined with file", "a file has all poses; remove one of them")
        return read_poses(folder / fields.text("file"))
    preset = MOTION_PRESETS[fields.choice("preset", MOTION_PRESETS)] if fields.has("preset") else None
    if preset is None and not any(fields.has(key) for key in ("angular_velocity_rad_s", "velocity_m_s", "camera")):
        raise fields.problem("", "has no motion", "give preset, angular_velocity_rad_s, velocity_m_s, camera or file")
    rate_rad_s = np.zeros(3) if preset is None else np.array(preset.angular_velocity_rad_s)
    if preset is not None and preset.inertia_kg_m2 is not None:
        inertia_kg_m2 = np.diag(preset.inertia_kg_m2)
    values: dict[str, Any] = fields.given(("velocity_m_s",), lambda key: fields.sized(key, SPEED_M_S))
    values |= fields.given(("camera",), lambda key: _poses(fields.each(key, POSE_KEYS), fields.location(key)))
    if "camera" in values and values["camera"].time_s[0] != 0:
        raise fields.problem("camera", f"begins at {values['camera'].time_s[0]:g} s, must begin at 0")
    return FreeMotion(
        inertia_kg_m2=_inertia(fields) if fields.has("inertia_kg_m2") else inertia_kg_m2,
        center_of_mass_m=fields.quantities("center_of_mass_m", 3, PART_M)
        if fields.has("center_of_mass_m")
        else center_of_mass_m,
        angular_velocity_rad_s=fields.sized("angular_velocity_rad_s", RATE_RAD_S)
        if fields.has("angular_velocity_rad_s")
        else rate_rad_s,
        **values,
    )


def _inertia(fields: Fields) -> Float64[Array, "3 3"]:
    """Principal moments, or a tensor, of a possible body: symmetric, positive, each moment at most the other two."""
    key = "inertia_kg_m2"
    rows = fields.raw(key)
    nested = isinstance(rows, list) and any(isinstance(row, list) for row in rows)
    inertia = fields.array(key, (3, 3)) if nested else np.diag(fields.vector(key, 3))
    if np.abs(inertia - inertia.T).max() > SYMMETRIC * np.abs(inertia).max():
        raise fields.problem(key, "is not symmetric")
    moments = np.linalg.eigvalsh(inertia)
    if moments[0] <= 0:
        raise fields.problem(key, f"has the principal moment {moments[0]:g}, must be positive")
    if moments[2] > (moments[0] + moments[1]) * (1 + SYMMETRIC):
        found = f"has the principal moments {', '.join(f'{moment:g}' for moment in moments)}"
        raise fields.problem(key, found, "no body has a moment larger than the sum of the other two")
    return inertia


def read_poses(path: Path) -> TimedPoses:
    """The poses in a trajectory file: CSV with the columns `CSV_COLUMNS`, or JSON lines with the keys `POSE_KEYS`."""
    lines = file_lines(path)
    if path.suffix.lower() == ".csv":
        return _poses(_csv_entries((line.decode(errors="replace") for line in lines), str(path)), str(path))
    entries = (Fields(location, record, POSE_KEYS) for location, record in records.read(lines, str(path)))
    return _poses(entries, str(path))


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


def _poses(entries: Iterator[Fields], where: str) -> TimedPoses:
    times_s: list[float] = []
    positions_m, orientations = [], []
    for entry in entries:
        times_s.append(entry.number("time_s"))
        if len(times_s) > 1 and times_s[-1] <= times_s[-2]:
            raise entry.problem("time_s", f"is {times_s[-1]:g}, not later than the time before")
        positions_m.append(entry.sized("position_m", PATH_M))
        orientation = entry.optional("orientation_xyzw", entry.quaternion)
        orientations.append(np.array([0.0, 0.0, 0.0, 1.0]) if orientation is None else orientation)
    if len(times_s) < 2:
        raise DataError(where, f"has {len(times_s)} poses, must have at least 2")
    return TimedPoses(
        time_s=np.array(times_s), position_m=np.stack(positions_m), orientation_xyzw=np.stack(orientations)
    )


def mass_properties(parts: Sequence[Part]) -> tuple[float, Float64[Array, "xyz=3"], Float64[Array, "3 3"]]:
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


def _moments(shape: Box | Revolution) -> tuple[Float64[Array, "xyz=3"], Float64[Array, "xyz=3"]]:
    """Centre of mass, and principal moments about it per kilogram, in the part frame."""
    if isinstance(shape, Box):
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
