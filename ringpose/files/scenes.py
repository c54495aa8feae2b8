"""scene.yaml, the input of `ringpose simulate`; man/ringpose-simulate.1 documents its keys."""

from collections.abc import Mapping
from dataclasses import MISSING
from dataclasses import fields as record_fields
from pathlib import Path
from typing import Any, TypeVar, cast, get_args

import cv2
import numpy as np

from ringpose.errors import DataError, UsageError
from ringpose.files.boards import board_of
from ringpose.files.motions import MAX_DISTANCE_M, MOTION_KEYS, read_motion
from ringpose.files.rigs import read_rig
from ringpose.files.schema import Fields
from ringpose.files.yaml import read_yaml
from ringpose.geometry.rotations import facing_normal
from ringpose.types.arrays import Array, Float64
from ringpose.types.rig import Rig
from ringpose.types.scene import (
    MATERIALS,
    Approach,
    Beacon,
    BoardApproach,
    BoardSet,
    Body,
    Foil,
    LaserLight,
    Lens,
    Light,
    Material,
    NamedBoardPose,
    RingShape,
    RingView,
    Scene,
    Sensor,
    Speckle,
    TargetKind,
)
from ringpose.types.sequence import parsed_sequence

SCHEMA = "scene/1"

_NUMBERS = ("exposure_s", "stripe_dn", "period_s", "start_s")

_RECORDS: Mapping[str, type[Any]] = {"lasers": LaserLight, "lens": Lens, "sensor": Sensor, "speckle": Speckle}

_PARTS = (
    "ring", "body", "lasers", "lights", "lens", "sensor", "speckle", "sequence", "trajectory", "motion", "boards",
)  # fmt: skip

_KEYS = ("ringpose", "rig", "seed", *_NUMBERS, *_PARTS)

_RING_KEYS = ("profile_m", "radius_inner_m", "radius_outer_m", "height_m", "face", "wall")

_DIVISORS = (
    "f_number", "quantum_efficiency", "overall_system_gain_dn_per_e", "saturation_capacity_e", "fan_rad",
    "on_s", "off_s",
)  # fmt: skip

_FRACTIONS = ("diffuse", "specular", "roughness", "transmission", "quantum_efficiency")

_MIN_VALUE = 1e-6
"""Minimum of the numbers in `_DIVISORS`."""

_Record = TypeVar("_Record")


def read_scene(path: Path) -> Scene:
    """The scene in a scene.yaml; the path of its rig file is relative to the scene's folder."""
    fields = read_yaml(path, _KEYS)
    if fields.text("ringpose") != SCHEMA:
        raise fields.problem("ringpose", f"is {fields.text('ringpose')!r}, must be {SCHEMA!r}")
    rig = _rig(fields, path.parent)
    lights = {"dim": Light(name="dim")}
    if fields.has("lights"):
        named = fields.fields("lights")
        lights = {str(name): _light(named, str(name)) for name in named.values}
    lasers = len(rig.lasers.names)
    values: dict[str, Any] = fields.given(_NUMBERS, lambda key: fields.number(key, least=0))
    values |= fields.given(_RECORDS, lambda key: _numbers(fields, key, _RECORDS[key]))
    values["sequence"] = read_sequence(fields, "sequence", lasers) if fields.has("sequence") else (0, (1 << lasers) - 1)
    along_file = fields.has("motion") and fields.fields("motion").has("file")
    if fields.has("trajectory"):
        values["views"], values["approaches"] = read_trajectory(fields, "trajectory", tuple(lights), along_file)
    elif along_file:
        entry = Fields(fields.file, {"name": "moving"}, _VIEW_KEYS, "trajectory")
        values["views"] = (_view(entry, tuple(lights), along_file),)
    if fields.has("boards"):
        boards = fields.fields("boards", ("camera", "planes"))
        for key, name in (("camera", "camera_boards"), ("planes", "plane_boards")):
            values[name] = read_board_set(boards, key, lasers) if boards.has(key) else None
    ring = fields.fields("ring", _RING_KEYS)
    body = _body(fields.fields("body", ("size_m", "offset_m", "material", "foil")))
    if fields.has("motion"):
        motion = fields.fields("motion", MOTION_KEYS)
        values["motion"] = read_motion(motion, *body.inertia_and_center, path.parent)
        values["shots"] = motion.integer("shots", least=1) if motion.has("shots") else 1
    return Scene(
        rig=rig,
        ring=RingShape(profile_m=_profile_m(ring), **ring.given(("face", "wall"), lambda key: _material(ring, key))),
        body=body,
        lights=lights,
        seed=fields.integer("seed", least=0) if fields.has("seed") else 1,
        **values,
    )


def _rig(fields: Fields, folder: Path) -> Rig:
    rig = read_rig(folder / fields.text("rig"))
    for name, projector_m in zip(rig.lasers.names, rig.lasers.projector_m, strict=True):
        if np.isnan(projector_m).any():
            remedy = "add the point from which its light emerges"
            raise fields.problem("rig", f"laser {name!r} has no projector_m", remedy)
    return rig


def _profile_m(fields: Fields) -> Float64[Array, "point 2"]:
    if not fields.has("profile_m"):
        inner, outer, height = (_positive_m(fields, key) for key in ("radius_inner_m", "radius_outer_m", "height_m"))
        if inner >= outer:
            raise fields.problem("radius_inner_m", f"is {inner:g}, must be smaller than radius_outer_m")
        return np.array([[inner, 0.0], [inner, height], [outer, height], [outer, 0.0]])
    profile_m = fields.array("profile_m", (None, 2))
    fields.check_metres("profile_m", profile_m.ravel())
    pieces = np.diff(profile_m, axis=0)
    if (profile_m < 0).any() or (np.abs(pieces).max(axis=1) == 0).any():
        raise fields.problem("profile_m", "has a negative number or a point twice")
    if not (pieces[:, 1] == 0).any():
        raise fields.problem("profile_m", "has no flat piece", "the ring's face needs two points at one height")
    return profile_m


def _body(fields: Fields) -> Body:
    values: dict[str, Any] = fields.given(("offset_m",), lambda key: fields.vector(key, 2))
    if values:
        fields.check_metres("offset_m", values["offset_m"])
    values |= fields.given(("material",), lambda key: _material(fields, key))
    values |= fields.given(("foil",), lambda key: _numbers(fields, key, Foil))
    size_m = fields.vector("size_m", 3)
    fields.check_metres("size_m", size_m)
    if (size_m <= 0).any():
        raise fields.problem("size_m", "must be positive")
    return Body(size_m=size_m, **values)


def _material(fields: Fields, key: str) -> Material:
    """A material, given by its name or by its parameters."""
    if isinstance(fields.raw(key), str):
        return MATERIALS[fields.choice(key, MATERIALS)]
    return _numbers(fields, key, Material)


def _light(named: Fields, name: str) -> Light:
    keys = ("ambient_w_m2", "sun_w_m2", "sun_direction", "beacon")
    light = Fields(named.file, named.values[name] or {}, keys, named.path + "." + name)
    values: dict[str, Any] = light.given(keys[:2], lambda key: light.number(key, least=0))
    if light.has("sun_direction"):
        direction = light.vector("sun_direction", 3)
        if not direction.any():
            raise light.problem("sun_direction", "has length 0")
        values["sun_direction"] = direction
    values |= light.given(("beacon",), lambda key: _numbers(light, key, Beacon))
    return Light(name=name, **values)


def _numbers(fields: Fields, key: str, record: type[_Record]) -> _Record:
    """A record whose fields are non-negative numbers; optional fields that are absent keep their defaults."""
    known = record_fields(cast(Any, record))
    entry = fields.fields(key, [field.name for field in known])
    given = [field.name for field in known if field.name in entry.values or field.default is MISSING]
    return record(**{name: _number(entry, name) for name in given})


def _number(fields: Fields, key: str) -> float | int:
    if key == "seed":
        return fields.integer(key, least=0)
    if key == "bits":
        bits = fields.integer(key)
        if bits not in (8, 12):
            raise fields.problem(key, f"is {bits}, must be 8 or 12")
        return bits
    if key.endswith("_m"):
        return _positive_m(fields, key)
    return fields.number(key, least=_MIN_VALUE if key in _DIVISORS else 0.0, most=1.0 if key in _FRACTIONS else np.inf)


def _positive_m(fields: Fields, key: str) -> float:
    length_m = fields.length_m(key)
    if length_m <= 0:
        raise fields.problem(key, f"is {length_m:g}, must be positive")
    return length_m


_VIEW_KEYS = ("name", "center_m", "normal", "pitch_rad", "yaw_rad", "roll_rad", "light", "target", "groups")

_APPROACH_KEYS = ("count", "distances_m", "lights", "tilt_rad", "clock_rad", "offset", "name", "seed")

_POSE_KEYS = ("name", "camera_from_board_rvec", "camera_from_board_tvec_m")

_SET_KEYS = ("board", "views", "generate", "ambient_w_m2", "exposure_s", "sequence")

_BOARD_APPROACH_KEYS = ("count", "distances_m", "tilt_rad", "turn_rad", "offset", "seed")

_ANGLES = ("tilt_rad", "clock_rad", "turn_rad")


def read_sequence(fields: Fields, key: str, lasers: int) -> tuple[int, ...]:
    """Laser masks of the frames of a shot, from steps such as `off,1,2,3,all`."""
    try:
        steps = parsed_sequence(fields.text(key))
        masks = tuple(step.mask(lasers) for step in steps)
    except UsageError as error:
        raise fields.problem(key, error.found, error.remedy) from error
    if any(step.exposure for step in steps):
        raise fields.problem(key, "has steps with an exposure of their own", "leave out what begins with @")
    return masks


def read_trajectory(
    fields: Fields, key: str, lights: tuple[str, ...], along_file: bool = False
) -> tuple[tuple[RingView, ...], tuple[Approach, ...]]:
    """The entries of a trajectory: single views, and approaches, which are sets of random views (`generate`).

    `lights` are the names of the scene's lights, one of which a view names. The poses of views `along_file` are in the
    trajectory file.
    """
    views: list[RingView] = []
    approaches: list[Approach] = []
    for entry in fields.each(key):
        if entry.has("generate"):
            if along_file:
                raise entry.problem("generate", "draws poses, but those of motion.file are given")
            alone = Fields(entry.file, entry.values, ("generate",), entry.path)
            approaches.append(_approach(alone.fields("generate", _APPROACH_KEYS), lights))
        else:
            views.append(_view(Fields(entry.file, entry.values, _VIEW_KEYS, entry.path), lights, along_file))
    names = [view.name for view in views]
    for name in names:
        if names.count(name) > 1:
            raise fields.problem(key, f"the name {name!r} occurs twice")
    return tuple(views), tuple(approaches)


def read_board_set(fields: Fields, key: str, lasers: int) -> BoardSet:
    """A board and its views."""
    entry = fields.fields(key, _SET_KEYS)
    values: dict[str, Any] = {"board": board_of(entry.fields("board"))}
    if values["board"].kind == "asymmetric_circles":
        raise entry.problem("board.kind", "is 'asymmetric_circles', which is not simulated")
    if entry.has("views"):
        values["poses"] = tuple(
            NamedBoardPose(
                name=_name(pose),
                rotation=np.asarray(cv2.Rodrigues(pose.vector("camera_from_board_rvec", 3))[0], dtype=np.float64),
                translation_m=pose.point_m("camera_from_board_tvec_m"),
            )
            for pose in entry.each("views", _POSE_KEYS)
        )
    if entry.has("generate"):
        approach = entry.fields("generate", _BOARD_APPROACH_KEYS)
        random_set = _random_set(approach)
        if len(random_set.get("distances_m", (0.0, 0.0))) != 2:
            raise approach.problem("distances_m", "must be the nearest and the farthest distance")
        values["approach"] = BoardApproach(**random_set)
    values |= entry.given(("ambient_w_m2", "exposure_s"), lambda key: entry.number(key, least=0))
    values |= entry.given(("sequence",), lambda key: read_sequence(entry, key, lasers))
    return BoardSet(**values)


_POSE_OF_VIEW = ("center_m", "normal", "pitch_rad", "yaw_rad", "roll_rad")


def _view(entry: Fields, lights: tuple[str, ...], along_file: bool) -> RingView:
    values: dict[str, Any] = {"name": _name(entry)}
    if along_file:
        for key in filter(entry.has, _POSE_OF_VIEW):
            raise entry.problem(key, "is given, but the poses are those of motion.file", "remove it")
        values |= {"center_m": np.zeros(3), "normal": np.array([0.0, 0.0, -1.0])}  # not used
    else:
        values |= {"center_m": _center_m(entry), "normal": _normal(entry)}
    if entry.has("light"):
        values["light"] = entry.choice("light", lights)
    elif "dim" not in lights:
        raise entry.problem("light", "is missing, and there is no light 'dim'")
    if entry.has("target"):
        values["target"] = cast(TargetKind, entry.choice("target", get_args(TargetKind)))
    values |= entry.given(("roll_rad",), lambda key: entry.number(key, least=-7, most=7))
    if entry.has("groups"):
        values["groups"] = entry.fields("groups").values
        if not all(isinstance(value, str | int | float | bool) for value in values["groups"].values()):
            raise entry.problem("groups", "must contain texts, numbers, true or false")
    return RingView(**values)


def _center_m(entry: Fields) -> Float64[Array, "3"]:
    center_m = entry.vector("center_m", 3)
    if np.linalg.norm(center_m) > MAX_DISTANCE_M:
        raise entry.problem(
            "center_m", f"is more than {MAX_DISTANCE_M:g} m away", "give metres; this looks like millimetres"
        )
    if center_m[2] <= 0:
        raise entry.problem("center_m", f"lies behind the camera, at z = {center_m[2]:g}", "z is forward")
    return center_m


def _normal(entry: Fields) -> Float64[Array, "3"]:
    """The normal, given as a vector or by the paper's pitch and yaw; it must point towards the camera."""
    if not entry.has("normal"):
        pitch, yaw = (entry.number(key, least=-1.5, most=1.5) for key in ("pitch_rad", "yaw_rad"))
        return facing_normal(pitch, yaw)
    if entry.has("pitch_rad") or entry.has("yaw_rad"):
        raise entry.problem("normal", "cannot be combined with pitch_rad or yaw_rad", "give one of the two")
    normal = entry.unit_vector("normal")
    if normal[2] >= 0:
        raise entry.problem("normal", "points away from the camera", "change its sign: z is forward")
    return normal


def _approach(entry: Fields, lights: tuple[str, ...]) -> Approach:
    values = _random_set(entry)
    values |= {"name": _name(entry)} if entry.has("name") else {}
    values |= entry.given(("lights",), entry.texts)
    for light in values.get("lights", ("dim",)):
        if light not in lights:
            raise entry.problem("lights", f"has {light!r}, must be one of {', '.join(lights)}")
    return Approach(**values)


def _random_set(entry: Fields) -> dict[str, Any]:
    """The values that random sets of ring views and of board views have in common."""
    values: dict[str, Any] = entry.given(("count", "seed"), lambda key: entry.integer(key, least=0))
    values |= entry.given(_ANGLES, lambda key: entry.number(key, least=0, most=1.2))
    values |= entry.given(("offset",), lambda key: entry.number(key, least=0, most=0.5))
    if entry.has("distances_m"):
        distances_m = entry.array("distances_m", (None,))
        entry.check_metres("distances_m", distances_m)
        if (distances_m <= 0).any():
            raise entry.problem("distances_m", "must be positive")
        values["distances_m"] = tuple(distances_m.tolist())
    return values


def _name(entry: Fields) -> str:
    """A name that is a valid file name."""
    name = entry.text("name")
    if "/" in name or name.startswith("."):
        raise DataError(entry.location("name"), f"is {name!r}, must be a plain file name")
    return name
