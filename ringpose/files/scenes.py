"""scene.yaml: everything that `ringpose simulate` needs; man/ringpose-simulate.1 documents its keys."""

from dataclasses import MISSING
from dataclasses import fields as record_fields
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np

from ringpose.files.fields import Fields
from ringpose.files.rigs import read_rig
from ringpose.files.scene_views import read_board_set, read_sequence, read_trajectory
from ringpose.files.yaml import read_yaml
from ringpose.types.arrays import Array, Float64
from ringpose.types.rig import Rig
from ringpose.types.scene import (
    MATERIALS,
    Beacon,
    Body,
    Foil,
    LaserLight,
    Lens,
    Light,
    Material,
    RingShape,
    Scene,
    Sensor,
    Speckle,
)

SCHEMA = "scene/1"

_NUMBERS = ("exposure_s", "stripe_dn", "period_s", "start_s")
_PARTS = ("ring", "body", "lasers", "lights", "lens", "sensor", "speckle", "sequence", "trajectory", "boards")
_KEYS = ("ringpose", "rig", "seed", *_NUMBERS, *_PARTS)
_RING_KEYS = ("profile_m", "radius_inner_m", "radius_outer_m", "height_m", "face", "wall")

_DIVISORS = (
    "f_number", "quantum_efficiency", "overall_system_gain_dn_per_e", "saturation_capacity_e", "fan_rad",
    "on_s", "off_s",
)  # fmt: skip
_SHARES = ("diffuse", "specular", "roughness", "transmission", "quantum_efficiency")
_LEAST = 1e-6
"""Of numbers that must not be zero."""

_Record = TypeVar("_Record")


def read_scene(path: Path) -> Scene:
    """The scene in a scene.yaml; its rig stands in a file of its own, named from where the scene lies."""
    fields = read_yaml(path, _KEYS)
    if fields.text("ringpose") != SCHEMA:
        raise fields.problem("ringpose", f"is {fields.text('ringpose')!r}, must be {SCHEMA!r}")
    rig = _rig(fields, path.parent)
    lights = _lights(fields)
    values: dict[str, Any] = {key: fields.number(key, least=0) for key in _NUMBERS if fields.has(key)}
    values |= {
        key: _numbers(fields, key, record)
        for key, record in (("lasers", LaserLight), ("lens", Lens), ("sensor", Sensor), ("speckle", Speckle))
        if fields.has(key)
    }
    if fields.has("sequence"):
        values["sequence"] = read_sequence(fields, "sequence", len(rig.lasers.names))
    else:
        values["sequence"] = (0, (1 << len(rig.lasers.names)) - 1)
    if fields.has("trajectory"):
        values["views"], values["approaches"] = read_trajectory(fields, "trajectory", tuple(lights))
    if fields.has("boards"):
        boards = fields.fields("boards", ("camera", "planes"))
        for key, name in (("camera", "camera_boards"), ("planes", "plane_boards")):
            values[name] = read_board_set(boards, key, len(rig.lasers.names)) if boards.has(key) else None
    return Scene(
        rig=rig,
        ring=_ring(fields.fields("ring", _RING_KEYS)),
        body=_body(fields.fields("body", ("size_m", "offset_m", "material", "foil"))),
        lights=lights,
        seed=fields.integer("seed", least=0) if fields.has("seed") else 1,
        **values,
    )


def _rig(fields: Fields, folder: Path) -> Rig:
    rig = read_rig(folder / fields.text("rig"))
    for name, projector_m in zip(rig.lasers.names, rig.lasers.projector_m, strict=True):
        if np.isnan(projector_m).any():
            remedy = "add the point from which its light comes"
            raise fields.problem("rig", f"laser {name!r} has no projector_m", remedy)
    return rig


def _ring(fields: Fields) -> RingShape:
    materials = {key: _material(fields, key) for key in ("face", "wall") if fields.has(key)}
    return RingShape(profile_m=_profile_m(fields), **materials)


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
    values: dict[str, Any] = {}
    if fields.has("offset_m"):
        values["offset_m"] = fields.vector("offset_m", 2)
        fields.check_metres("offset_m", values["offset_m"])
    if fields.has("material"):
        values["material"] = _material(fields, "material")
    if fields.has("foil"):
        values["foil"] = _numbers(fields, "foil", Foil)
    size_m = fields.vector("size_m", 3)
    fields.check_metres("size_m", size_m)
    if (size_m <= 0).any():
        raise fields.problem("size_m", "must be positive")
    return Body(size_m=size_m, **values)


def _material(fields: Fields, key: str) -> Material:
    """A material by its name or by its numbers."""
    if isinstance(fields.raw(key), str):
        return MATERIALS[fields.choice(key, MATERIALS)]
    return _numbers(fields, key, Material)


def _lights(fields: Fields) -> dict[str, Light]:
    if not fields.has("lights"):
        return {"dim": Light(name="dim")}
    named = fields.fields("lights")
    return {str(name): _light(named, str(name)) for name in named.values}


def _light(named: Fields, name: str) -> Light:
    keys = ("ambient_w_m2", "sun_w_m2", "sun_direction", "beacon")
    light = Fields(named.file, named.values[name] or {}, keys, named.path + "." + name)
    values: dict[str, Any] = {key: light.number(key, least=0) for key in keys[:2] if light.has(key)}
    if light.has("sun_direction"):
        direction = light.vector("sun_direction", 3)
        if not direction.any():
            raise light.problem("sun_direction", "has length 0")
        values["sun_direction"] = direction
    if light.has("beacon"):
        values["beacon"] = _numbers(light, "beacon", Beacon)
    return Light(name=name, **values)


def _numbers(fields: Fields, key: str, record: type[_Record]) -> _Record:
    """A record whose fields are numbers, none of them negative; what may be left out keeps its default."""
    known = record_fields(cast(Any, record))
    below = fields.fields(key, [field.name for field in known])
    given = [field.name for field in known if field.name in below.values or field.default is MISSING]
    return record(**{name: _number(below, name) for name in given})


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
    return fields.number(key, least=_LEAST if key in _DIVISORS else 0.0, most=1.0 if key in _SHARES else np.inf)


def _positive_m(fields: Fields, key: str) -> float:
    length_m = fields.length_m(key)
    if length_m <= 0:
        raise fields.problem(key, f"is {length_m:g}, must be positive")
    return length_m
