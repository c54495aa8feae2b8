"""Robot poses in any format that robots and their programs write, by a convention that is given or named.

Tables of numbers (CSV, TUM, robots' own lines), a folder of files with one pose each, ROS-like YAML, and JSON lines.
"""

import re
import sys
from collections.abc import Iterable, Iterator, Sequence
from math import isfinite, pi
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ringpose.errors import DataError, NoInputError, UsageError
from ringpose.files.inputs import file_lines, holds_records, inputs, lines
from ringpose.files.records.robot_poses import motion_of, pose_in_record, stamp_of
from ringpose.files.schema import MAX_QUATERNION_ERROR, NOT_KNOWN, ROUNDED, Fields
from ringpose.files.yaml import read_yaml
from ringpose.geometry.robot_conventions import PoseConvention, convention_named
from ringpose.geometry.rotations import rotation_of
from ringpose.types.image import name_order
from ringpose.types.options import STDIN
from ringpose.types.plausible import REACH_M, STAMP_S
from ringpose.types.rig import RobotPoses
from ringpose.types.robot import ReportedPose, ReportedPoses

FAR_M = 20.0
"""Distance from the base that no robot's tool has; in a file in metres it is in millimetres."""

NEAR_M = 0.02
"""Distance from the base that the tool cannot always keep; in a file in millimetres it is in metres."""

_STDIN = "standard input"

_FOLDER_SUFFIXES = (".txt", ".csv", ".dat", ".pose", ".yaml", ".yml")
_YAML_SUFFIXES = (".yaml", ".yml")

_NAME_COLUMNS = ("shot", "name", "image", "file", "filename")
_STAMP_COLUMNS = ("stamp_s", "timestamp", "stamp", "time", "t")
_OTHER_NAMES = {"tx": "x", "ty": "y", "tz": "z", "px": "x", "py": "y", "pz": "z"}

_EXPLICIT = "give --robot-convention, as kuka, or mm,ZYX,deg, or m,xyzw (ringpose-robot(7))"


def read_tool_poses(
    source: str, convention: PoseConvention | None = None, columns: Sequence[str] = (), is_tum: bool = False
) -> ReportedPoses:
    """The poses of a file, a folder of files with one pose each, or standard input (`-`).

    Standard input has a table if there is a convention, else JSON lines. Identical repeats are left out and counted;
    two poses of one stamp or name that differ are an error.
    """
    path = Path(source)
    if source == STDIN and convention is not None:
        read = list(_poses_in_table(_table_on_stdin(), _STDIN, convention, columns, is_tum))
    elif source == STDIN or holds_records(path):
        if convention is not None and (convention.order, convention.length_m) != ("xyzw", 1.0):
            raise UsageError("--robot-convention", "is of no use for JSON lines: their keys state it", "leave it out")
        read = [pose_in_record(item) for item in inputs([source], (".jsonl",))]
    elif path.is_dir():
        read = [pose for file in _files(path) for pose in _poses_in_file(file, convention, columns, is_tum, one=True)]
    else:
        read = list(_poses_in_file(path, convention, columns, is_tum, one=False))
    location = _STDIN if source == STDIN else source
    if not read:
        raise DataError(location, "holds no pose", "give one pose a line")
    _check_distances(read, location, convention)
    return _without_repeats(read)


def whole_motion(reported: ReportedPoses, source: str) -> RobotPoses:
    """The motion of the tool by the poses of a source in any order, each of which must have a stamp."""
    poses = sorted(reported.poses, key=stamp_of)
    if len(poses) < 2:
        location = _STDIN if source == STDIN else source
        raise DataError(location, "has fewer than two poses", "give the robot's poses at least ten times a second")
    return motion_of(poses, reported.repeats)


def _files(folder: Path) -> list[Path]:
    listed = (file for file in folder.iterdir() if file.suffix.lower() in _FOLDER_SUFFIXES)
    return sorted(listed, key=lambda file: name_order(file.name))


def _poses_in_file(
    path: Path, convention: PoseConvention | None, columns: Sequence[str], is_tum: bool, *, one: bool
) -> Iterator[ReportedPose]:
    if path.suffix.lower() in _YAML_SUFFIXES:
        poses = list(_poses_in_yaml(path))
    else:
        if convention is None:
            raise UsageError("--robot-convention", f"is missing: {path} does not state units and order", _EXPLICIT)
        poses = list(_poses_in_table(file_lines(path), str(path), convention, columns, is_tum))
    if one and len(poses) != 1:
        raise DataError(str(path), f"holds {len(poses)} poses, must hold one in a folder of poses", "give one file")
    for pose in poses:
        yield pose._replace(name=path.stem) if one and not pose.name else pose


def _table_on_stdin() -> list[bytes]:
    """The lines of standard input, of a table; JSON lines are rejected, whose keys state what a convention does."""
    if sys.stdin is None:
        raise NoInputError(_STDIN, "is closed")
    table = [line.encode(errors="surrogateescape") for line in lines()]
    if next(filter(bytes.strip, table), b"").lstrip().startswith(b'{"'):
        raise UsageError("--robot-convention", "is of no use for JSON lines: their keys state it", "leave it out")
    return table


def _poses_in_table(
    table: Iterable[bytes], location: str, convention: PoseConvention, columns: Sequence[str], is_tum: bool
) -> Iterator[ReportedPose]:
    """The poses in the lines of a table."""
    rows = list(_rows(table, location))
    if convention.rotation == "matrix":
        rows = _whole_matrices(rows, location)
    if is_tum and not columns:
        columns = ("stamp_s", *convention.names)
    yield from _poses_in_rows(rows, convention, [name.lower() for name in columns])


class _Row(NamedTuple):
    """The words of a line."""

    location: str
    words: list[str]
    name: str = ""
    """Name of a robot's variable, or of the tool's point, that the line assigns."""


def _rows(table: Iterable[bytes], location: str) -> Iterator[_Row]:
    """The lines of a table; brackets, and what robots write around the numbers, are left out."""
    for number, line in enumerate(table, start=1):
        text = line.decode(errors="replace").strip().lstrip("\ufeff")
        if not text.replace("\t", " ").isprintable() or "\ufffd" in text:
            raise DataError(
                f"{location}:{number}", "is not text", "give a table with one pose a line (ringpose-robot(7))"
            )
        if not text or text[0] in "#%":
            continue
        name = ""
        if ":=" in text:  # an assignment of ABB's RAPID
            before, text = text.split(":=", 1)
            name = before.split()[-1] if before.split() else ""
        text = re.sub(r"\bp\[", "[", text).strip(";")  # a pose of UR's script
        if ";" in text:
            words = text.replace(",", ".").split(";")
        elif "," in text:
            words = text.split(",")
        else:
            words = text.split()
        yield _Row(f"{location}:{number}", [_bare(word) for word in words if _bare(word) or "," in text], name)


def _bare(word: str) -> str:
    return word.strip("()[]{} \t\"'")


def _number(word: str) -> float | None:
    """The number in a word, or after its name as in `X 100.5`; None for other text."""
    match = re.fullmatch(r"[A-Za-z_]\w*\s*[ =:]\s*(\S+)", word)
    try:
        return float(match[1] if match else word)
    except ValueError:
        return None


def _is_missing(word: str) -> bool:
    return word.lower() in ("", "null", "none", "nan", "-nan", "n/a")


def _whole_matrices(rows: list[_Row], location: str) -> list[_Row]:
    """One row for each matrix, if each is written in four lines."""
    if any(len(row.words) != 4 for row in rows):
        return rows
    if len(rows) % 4:
        raise DataError(location, f"has {len(rows)} lines of four numbers", "give all four lines of each matrix")
    blocks = [rows[start : start + 4] for start in range(0, len(rows), 4)]
    return [_Row(block[0].location, [word for row in block for word in row.words]) for block in blocks]


def _poses_in_rows(rows: list[_Row], convention: PoseConvention, columns: Sequence[str]) -> Iterator[ReportedPose]:
    """The poses in the rows of a table, whose columns are given, named by its first row, or those of the convention."""
    names = list(columns)
    if rows and sum(_number(word) is not None or _is_missing(word) for word in rows[0].words) < 3:
        head = [_OTHER_NAMES.get(word.lower(), word.lower()) for word in rows.pop(0).words]
        names = names or head
    for row in rows:
        yield _pose_in_row(row, convention, [_OTHER_NAMES.get(name, name) for name in names])


def _pose_in_row(row: _Row, convention: PoseConvention, names: list[str]) -> ReportedPose:
    words = row.words
    if not names:
        if convention.rotation == "quaternion" and len(words) >= 17:
            words = words[:7]  # ABB's robtarget goes on with configuration and external axes
        names = _usual_columns(row, words, convention)
    if len(words) < len(names):
        finding = f"has {len(words)} columns, must have {len(names)}: {', '.join(names)}"
        raise DataError(row.location, finding, "name the columns with --robot-columns")
    values = dict(zip(names, words, strict=False))
    missing = [name for name in convention.names if name not in values]
    if missing:
        finding = f"has no column {missing[0]!r}, its columns are {', '.join(names)}"
        remedy = f"name them with --robot-columns: {','.join(convention.names)}, with shot, stamp_s or - for others"
        raise DataError(row.location, finding, remedy)
    stated = np.array([_value(row, name, values[name]) for name in convention.names])
    stamp = next((values[name] for name in _STAMP_COLUMNS if name in values), None)
    name = next((values[name] for name in _NAME_COLUMNS if name in values), row.name)
    position_m, rotation = _placed(row.location, stated, convention)
    stamp_s = None if stamp is None else _value(row, "stamp_s", stamp)
    if stamp_s is not None and not STAMP_S.holds(stamp_s):
        raise DataError(
            row.location, f"stamp_s {stamp_s:.17g}: {STAMP_S.finding(stamp_s)[0]}", STAMP_S.finding(stamp_s)[1]
        )
    return ReportedPose(row.location, name, stamp_s, position_m, rotation)


def _usual_columns(row: _Row, words: list[str], convention: PoseConvention) -> list[str]:
    """The columns of a table without names: those of the convention, with a name before them if it is a text."""
    extra = len(words) - len(convention.names)
    if extra == 0:
        return list(convention.names)
    if extra == 1 and _number(words[0]) is None:
        return ["shot", *convention.names]
    finding = f"has {len(words)} columns, a pose of this convention has {len(convention.names)}"
    remedy = f"name them with --robot-columns, as stamp_s,{','.join(convention.names)}"
    raise DataError(row.location, finding, remedy)


def _value(row: _Row, name: str, word: str) -> float:
    value = _number(word)
    if _is_missing(word):
        raise DataError(f"{row.location}: {name}", *NOT_KNOWN)
    if value is None or not isfinite(value):
        raise DataError(row.location, f"{name} is {word}, must be a number", "leave out lines without a pose")
    return value


def _placed(
    location: str, numbers: np.ndarray[Any, np.dtype[np.float64]], convention: PoseConvention
) -> tuple[np.ndarray[Any, np.dtype[np.float64]], np.ndarray[Any, np.dtype[np.float64]]]:
    """Position in metres and rotation of the numbers of a pose."""
    matrix = numbers.reshape(4, 4) if convention.rotation == "matrix" else None
    if matrix is not None and convention.order == "columns":
        matrix = matrix.T
    position_m = convention.length_m * (numbers[:3] if matrix is None else matrix[:3, 3])
    if np.abs(position_m).max() > REACH_M.highest:
        finding = f"is {np.abs(position_m).max():.4g} m away from the base along an axis"
        raise DataError(location, finding, "likely the positions are in millimetres: give mm in --robot-convention")
    if matrix is not None:
        return position_m, _rotation(location, matrix)
    turn = numbers[3:]
    if convention.rotation == "quaternion":
        length = float(np.linalg.norm(turn))
        if abs(length - 1.0) > MAX_QUATERNION_ERROR:
            finding = f"its quaternion has length {length:.6g}, must be 1"
            raise DataError(location, finding, "likely these are angles, or other columns: see --robot-columns")
    elif convention.angle_rad == 1.0 and np.linalg.norm(turn) > 2 * pi * (2 if convention.rotation == "angles" else 1):
        finding = f"has an angle of {np.abs(turn).max():.4g} rad"
        raise DataError(location, finding, "likely the angles are in degrees: give deg in --robot-convention")
    return position_m, convention.rotation_of(turn)


def _rotation(location: str, matrix: np.ndarray[Any, np.dtype[np.float64]]) -> np.ndarray[Any, np.dtype[np.float64]]:
    """The rotation in a 4 x 4 matrix, orthogonal but for rounding."""
    if not np.array_equal(matrix[3], [0, 0, 0, 1]):
        cause = "likely it is given column by column" if np.array_equal(matrix[:, 3], [0, 0, 0, 1]) else ""
        raise DataError(location, "its matrix does not end with the row 0, 0, 0, 1", cause)
    rotation = matrix[:3, :3]
    error = float(np.abs(rotation @ rotation.T - np.eye(3)).max())
    if error > MAX_QUATERNION_ERROR or np.linalg.det(rotation) < 0:
        raise DataError(location, "its upper left 3 x 3 matrix is not a rotation", "see --robot-columns")
    left, _, right = np.linalg.svd(rotation)
    return rotation if error < ROUNDED**2 else left @ right


def _check_distances(poses: Sequence[ReportedPose], location: str, convention: PoseConvention | None) -> None:
    """Reject poses that are far too near to the base, or too far, or that never turn, for their units."""
    distance_m = np.array([float(np.linalg.norm(pose.position_m)) for pose in poses])
    if np.median(distance_m) > FAR_M:
        far_m = float(np.median(distance_m))
        finding = f"the tool is {far_m:.4g} m from the base"
        remedy = f"give metres: {1e-3 * far_m:.3g} if these are millimetres, {1e-2 * far_m:.3g} if centimetres"
        raise DataError(location, finding, f"{remedy}, {0.0254 * far_m:.3g} if inches")
    if convention is not None and convention.length_m < 1.0 and distance_m.max() < NEAR_M:
        finding = f"the tool is never more than {1e3 * distance_m.max():.4g} mm from the base"
        raise DataError(location, finding, "likely the positions are in metres: give m in --robot-convention")
    if convention is not None and convention.rotation in ("angles", "rotation_vector") and len(poses) > 2:
        turned = [np.arccos(np.clip((np.trace(pose.rotation) - 1) / 2, -1, 1)) for pose in poses]
        # Radians that are read as degrees: none of the three exceeds pi.
        if convention.angle_rad < 1.0 and max(turned) < pi * convention.angle_rad * np.sqrt(3):
            finding = f"no pose is turned by more than {max(turned) / convention.angle_rad:.3g} degrees from the base"
            raise DataError(location, finding, "likely the angles are in radians: give rad in --robot-convention")


def _pose_of(pose: Fields, location: str, name: str, stamp_s: float | None) -> ReportedPose:
    position_m = pose.quantities("position_m", 3, REACH_M)
    return ReportedPose(location, name, stamp_s, position_m, rotation_of(pose.quaternion("orientation_xyzw")))


def _poses_in_yaml(path: Path) -> Iterator[ReportedPose]:
    """The poses in a list `poses`, as messages of ROS: `pose` or `transform`, in a stamped message or bare."""
    top = read_yaml(path)
    entries = list(top.each("poses")) if top.has("poses") else [top]
    for number, entry in enumerate(entries):
        location = f"{path}: poses[{number}]"
        name = next((entry.text(key) for key in _NAME_COLUMNS if entry.has(key)), "")
        stamp_s = _ros_stamp_s(entry)
        body = entry
        for key in ("pose", "transform", "pose", "base_from_tool"):
            body = body.fields(key) if body.has(key) else body
        if body.has("position_m"):
            yield _pose_of(body, location, name, stamp_s)
            continue
        place = body.fields("position" if body.has("position") else "translation")
        turn = body.fields("orientation" if body.has("orientation") else "rotation")
        position_m = _listed(place, "xyz").quantities(place.path, 3, REACH_M)
        rotation = rotation_of(_listed(turn, "xyzw").quaternion(turn.path))
        yield ReportedPose(location, name, stamp_s, position_m, rotation)


def _listed(fields: Fields, axes: str) -> Fields:
    """The numbers of a point or a quaternion as one list, under its own name."""
    for axis in axes:
        if axis not in fields.values:
            raise fields.missing(axis)
    return Fields(fields.file, {fields.path: [fields.values[axis] for axis in axes]})


def _ros_stamp_s(entry: Fields) -> float | None:
    if entry.has("header"):
        stamp = entry.fields("header")
        if stamp.has("stamp"):
            parts = stamp.fields("stamp")
            small = next((parts.number(key) for key in ("nanosec", "nsec", "nsecs") if parts.has(key)), 0.0)
            return next((parts.number(key) for key in ("sec", "secs") if parts.has(key)), 0.0) + 1e-9 * small
    return entry.optional("stamp_s", entry.stamp_s)


def _without_repeats(read: Iterable[ReportedPose]) -> ReportedPoses:
    """The poses without identical repeats; two of one name or stamp that differ are an error."""
    kept: list[ReportedPose] = []
    known: dict[tuple[str, float | None], ReportedPose] = {}
    repeats = 0
    for pose in read:
        key = (pose.name, pose.stamp_s)
        first = known.setdefault(key, pose) if key != ("", None) else pose
        if first is pose:
            kept.append(pose)
        elif pose.repeats(first):
            repeats += 1
        else:
            what = f"name {pose.name!r}" if pose.name else f"stamp {pose.stamp_s:.6f}"
            finding = f"has the {what} of {first.location}, but another pose"
            raise DataError(pose.location, finding, "leave out the wrong one")
    return ReportedPoses(poses=tuple(kept), repeats=repeats)


def convention_of(text: str | None) -> tuple[PoseConvention | None, bool]:
    """The convention of an option's value, and whether it is TUM's, whose lines begin with a stamp."""
    if text is None:
        return None, False
    return convention_named(text), text.lower() == "tum"
