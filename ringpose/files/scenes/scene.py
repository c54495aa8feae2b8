"""scene.yaml, the input of `ringpose simulate`; man/ringpose-simulate.1 documents its keys."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, cast, get_args

import cv2
import numpy as np

from ringpose.errors import DataError, UsageError
from ringpose.files.boards import board_of
from ringpose.files.rigs import read_rig
from ringpose.files.scenes.motions import MOTION_KEYS, mass_properties, read_motion
from ringpose.files.scenes.targets import (
    RING_KEYS,
    TARGET_KEYS,
    Target,
    numbers_of,
    read_material,
    read_profile,
    read_target,
    with_details,
)
from ringpose.files.schema import Fields
from ringpose.files.yaml import read_yaml
from ringpose.geometry.rotations import facing_normal
from ringpose.types.arrays import Array, Float64
from ringpose.types.plausible import (
    ANGLE_RAD,
    DETAIL_M,
    DISTANCE_M,
    EXPOSURE_S,
    FACE_WIDTH_M,
    FACING_RAD,
    IRRADIANCE_W_M2,
    OFFSET_SHARE,
    RING_HEIGHT_M,
    RING_RADIUS_M,
    SUN_RAD,
    TARGET_DISTANCE_M,
    TILT_RAD,
)
from ringpose.types.rig import Rig
from ringpose.types.scene import (
    EARTH_RADIUS_M,
    Approach,
    Beacon,
    BoardApproach,
    BoardSet,
    Earth,
    LaserLight,
    Light,
    NamedBoardPose,
    Optics,
    RingView,
    Scene,
    Sensor,
    Speckle,
    TargetKind,
)
from ringpose.types.session import parsed_sequence
from ringpose.types.target import Body, Foil, Part, Revolution, RingShape

SCHEMA = "scene/1"

_NUMBERS = ("stripe_dn", "period_s", "start_s")

_RECORDS: Mapping[str, type[Any]] = {"lasers": LaserLight, "lens": Optics, "sensor": Sensor, "speckle": Speckle}

_PARTS = (
    "target", "ring", "body", "sun", "earth", "lasers", "lights", "lens", "sensor", "speckle", "sequence",
    "trajectory", "motion", "boards",
)  # fmt: skip

_KEYS = ("ringpose", "rig", "seed", "exposure_s", *_NUMBERS, *_PARTS)

MAX_SHOTS = 1_000_000
"""Maximum number of shots of a view: a day of shots, one every 0.1 s."""

MAX_SCENE_SHOTS = 10_000_000
"""Maximum number of shots of all views together."""

MAX_COUNT = 10_000
"""Maximum number of random poses of a set."""

NO_RING = RingShape(profile_m=np.array([[0.575, 0.0], [0.597, 0.0]]))
"""Where the ring of a target without a ring would be: poses of views refer to it."""


def read_scene(path: Path) -> Scene:
    """The scene in a scene.yaml; the path of its rig file is relative to the scene's folder."""
    fields = read_yaml(path, _KEYS)
    fields.choice("ringpose", (SCHEMA,))
    rig = _rig(fields, path.parent)
    space = _space(fields)
    lights = {"dim": replace(space, name="dim")}
    if fields.has("lights"):
        named = fields.fields("lights")
        lights = {str(name): _light(named, str(name), space) for name in named.values}
    lasers = len(rig.lasers.names)
    values: dict[str, Any] = fields.given(_NUMBERS, lambda key: fields.number(key, least=0))
    values |= fields.given(("exposure_s",), lambda key: fields.quantity(key, EXPOSURE_S))
    values |= fields.given(_RECORDS, lambda key: numbers_of(fields, key, _RECORDS[key]))
    values["sequence"] = read_sequence(fields, "sequence", lasers) if fields.has("sequence") else (0, (1 << lasers) - 1)
    values["views"], values["approaches"] = _views(fields, tuple(lights))
    if fields.has("boards"):
        boards = fields.fields("boards", ("camera", "planes"))
        for key, name in (("camera", "camera_boards"), ("planes", "plane_boards")):
            values[name] = read_board_set(boards, key, lasers) if boards.has(key) else None
    values |= _target_and_motion(fields, path.parent)
    _check_number_of_shots(fields, values)
    if values["ring"] is NO_RING:
        for key in ("views", "approaches"):  # they show the rest
            values[key] = tuple(replace(each, target=_WITHOUT_RING[each.target]) for each in values[key])
    return Scene(rig=rig, lights=lights, seed=fields.integer("seed", least=0) if fields.has("seed") else 1, **values)


def _views(fields: Fields, lights: tuple[str, ...]) -> tuple[tuple[RingView, ...], tuple[Approach, ...]]:
    """The views of the trajectory; a target that moves along a file needs none."""
    along_file = fields.has("motion") and fields.fields("motion").has("file")
    if fields.has("trajectory"):
        return read_trajectory(fields, "trajectory", lights, along_file)
    if not along_file:
        return (), ()
    return (_view(Fields(fields.file, {"name": "moving"}, _VIEW_KEYS, "trajectory"), lights, along_file),), ()


def _check_number_of_shots(fields: Fields, values: dict[str, Any]) -> None:
    approaches: tuple[Approach, ...] = values["approaches"]
    drawn = sum(each.count * len(each.distances_m) * len(each.lights) for each in approaches)
    shots = (len(values["views"]) + drawn) * values.get("shots", 1)
    if shots > MAX_SCENE_SHOTS:
        found = f"gives {shots:g} shots, must give at most {MAX_SCENE_SHOTS:g}"
        raise fields.problem("trajectory", found, "give fewer poses, distances, lights or shots of the motion")


def _target_and_motion(fields: Fields, folder: Path) -> dict[str, Any]:
    target = _target(fields)
    body = _body(fields.fields("body", _BODY_KEYS)) if fields.has("body") or not fields.has("target") else None
    values: dict[str, Any] = {"ring": target.ring or NO_RING, "body": body, "parts": target.parts}
    if fields.has("motion"):
        motion = fields.fields("motion", MOTION_KEYS)
        values["motion"] = read_motion(motion, *_inertia_and_center(fields, target, body), folder)
        values["shots"] = motion.integer("shots", least=1, most=MAX_SHOTS) if motion.has("shots") else 1
    return values


_WITHOUT_RING: Mapping[TargetKind, TargetKind] = {"ring": "body", "body": "body", "none": "none"}


def _target(fields: Fields) -> Target:
    """The parts and the ring of the scene."""
    if not fields.has("target"):
        return Target(parts=(), ring=_ring(fields.fields("ring", RING_KEYS)))
    target = read_target(fields.fields("target", TARGET_KEYS))
    if fields.has("ring"):
        if target.ring is not None:
            raise fields.problem("ring", "is given, but the target has a ring", "remove one of them")
        target = Target(parts=target.parts, ring=_ring(fields.fields("ring", RING_KEYS)))
    return target


def _inertia_and_center(
    fields: Fields, target: Target, body: Body | None
) -> tuple[Float64[Array, "3 3"], Float64[Array, "3"]]:
    """Inertia and centre of mass of the target: of its parts if they have masses, else of the uniform body.

    Without either, the motion must state its own values or be read from a file; an error is raised otherwise.
    """
    rings = [] if target.ring is None else [target.ring]
    shells = [
        Part(name="ring", shape=Revolution(profile_m=ring.profile_m), materials=(ring.wall,), mass_kg=ring.mass_kg)
        for ring in rings
    ]
    mass_kg, center_m, inertia = mass_properties((*target.parts, *shells))
    if mass_kg == 0.0 and body is not None:
        return body.inertia_and_center
    motion = fields.fields("motion")
    if mass_kg == 0.0 and not (motion.has("file") or (motion.has("inertia_kg_m2") and motion.has("center_of_mass_m"))):
        remedy = "give the parts mass_kg, or the motion inertia_kg_m2 and center_of_mass_m"
        raise fields.problem("motion", "moves a target whose parts have no mass", remedy)
    return inertia, center_m


def _rig(fields: Fields, folder: Path) -> Rig:
    rig = read_rig(folder / fields.text("rig"))
    for name, projector_m in zip(rig.lasers.names, rig.lasers.projector_m, strict=True):
        if np.isnan(projector_m).any():
            remedy = "add the point from which its light emerges"
            raise fields.problem("rig", f"laser {name!r} has no projector_m", remedy)
    return rig


def _profile_m(fields: Fields) -> Float64[Array, "point 2"]:
    if not fields.has("profile_m"):
        inner, outer = (fields.quantity(key, RING_RADIUS_M) for key in ("radius_inner_m", "radius_outer_m"))
        height = fields.quantity("height_m", RING_HEIGHT_M)
        if inner >= outer:
            raise fields.problem("radius_inner_m", f"is {inner:g}, must be smaller than radius_outer_m")
        return np.array([[inner, 0.0], [inner, height], [outer, height], [outer, 0.0]])
    profile_m = read_profile(fields)
    fields.check("profile_m", profile_m[:, 0], RING_RADIUS_M)
    fields.check("profile_m", profile_m[:, 1].max(keepdims=True), RING_HEIGHT_M)
    if (profile_m[:, 1] < 0).any():
        raise fields.problem("profile_m", "has a negative height")
    if not (np.diff(profile_m[:, 1]) == 0).any():
        raise fields.problem("profile_m", "has no flat piece", "the ring's face needs two points at one height")
    return profile_m


def _ring(fields: Fields) -> RingShape:
    values: dict[str, Any] = fields.given(("face", "wall"), lambda key: read_material(fields, key))
    ring = RingShape(profile_m=_profile_m(fields), **values)
    width_m = ring.radius_outer_m - ring.radius_inner_m
    if not FACE_WIDTH_M.holds(width_m):
        found, remedy = FACE_WIDTH_M.finding(width_m)
        raise fields.problem("", f"has a face whose width {found}", remedy)
    return with_details(fields, ring)


_BODY_KEYS = ("size_m", "offset_m", "material", "foil")


def _body(fields: Fields) -> Body:
    values: dict[str, Any] = fields.given(("offset_m",), lambda key: fields.quantities(key, 2, DETAIL_M))
    values |= fields.given(("material",), lambda key: read_material(fields, key))
    values |= fields.given(("foil",), lambda key: numbers_of(fields, key, Foil))
    size_m = fields.quantities("size_m", 3, DETAIL_M)
    if (size_m <= 0).any():
        raise fields.problem("size_m", "must be positive")
    return Body(size_m=size_m, **values)


_SUN_KEYS = ("irradiance_w_m2", "direction", "diameter_rad")

_EARTH_KEYS = ("direction", "orbit_radius_m", "albedo")


def _space(fields: Fields) -> Light:
    """Sun and Earth, which all lights of the scene have in common unless they have their own sun."""
    values: dict[str, Any] = {}
    if fields.has("sun"):
        sun = fields.fields("sun", _SUN_KEYS)
        values["sun_w_m2"] = sun.quantity("irradiance_w_m2", IRRADIANCE_W_M2)
        values["sun_direction"] = _direction(sun, "direction")
        values |= {f"sun_{key}": sun.quantity(key, SUN_RAD) for key in ("diameter_rad",) if sun.has(key)}
    if fields.has("earth"):
        earth = fields.fields("earth", _EARTH_KEYS)
        given: dict[str, Any] = {"direction": _direction(earth, "direction")}
        if earth.has("orbit_radius_m"):
            given["orbit_radius_m"] = earth.number("orbit_radius_m", least=1.02 * EARTH_RADIUS_M)
        if earth.has("albedo"):
            given["albedo"] = earth.number("albedo", least=0, most=1)
        values["earth"] = Earth(**given)
    return Light(name="space", **values)


def _direction(fields: Fields, key: str) -> Float64[Array, "3"]:
    direction = fields.vector(key, 3)
    if not direction.any():
        raise fields.problem(key, "has length 0")
    return direction


def _light(named: Fields, name: str, space: Light) -> Light:
    keys = ("ambient_w_m2", "sun_w_m2", "sun_direction", "beacon")
    light = Fields(named.file, named.values[name] or {}, keys, named.path + "." + name)
    values: dict[str, Any] = light.given(keys[:2], lambda key: light.quantity(key, IRRADIANCE_W_M2))
    if light.has("sun_direction"):
        values["sun_direction"] = _direction(light, "sun_direction")
    values |= light.given(("beacon",), lambda key: numbers_of(light, key, Beacon))
    return replace(space, name=name, **values)


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
                translation_m=pose.sized("camera_from_board_tvec_m", DISTANCE_M),
            )
            for pose in entry.each("views", _POSE_KEYS)
        )
    if entry.has("generate"):
        approach = entry.fields("generate", _BOARD_APPROACH_KEYS)
        random_set = _random_set(approach)
        if len(random_set.get("distances_m", (0.0, 0.0))) != 2:
            raise approach.problem("distances_m", "must be the nearest and the farthest distance")
        values["approach"] = BoardApproach(**random_set)
    values |= entry.given(("ambient_w_m2",), lambda key: entry.quantity(key, IRRADIANCE_W_M2))
    values |= entry.given(("exposure_s",), lambda key: entry.quantity(key, EXPOSURE_S))
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
    values |= entry.given(("roll_rad",), lambda key: entry.quantity(key, ANGLE_RAD))
    if entry.has("groups"):
        values["groups"] = entry.fields("groups").values
        if not all(isinstance(value, str | int | float | bool) for value in values["groups"].values()):
            raise entry.problem("groups", "must contain texts, numbers, true or false")
    return RingView(**values)


def _center_m(entry: Fields) -> Float64[Array, "3"]:
    center_m = entry.sized("center_m", TARGET_DISTANCE_M)
    if center_m[2] <= 0:
        raise entry.problem("center_m", f"lies behind the camera, at z = {center_m[2]:g}", "z is forward")
    return center_m


def _normal(entry: Fields) -> Float64[Array, "3"]:
    """The normal, given as a vector or by the paper's pitch and yaw; it must point towards the camera."""
    if not entry.has("normal"):
        pitch, yaw = (entry.quantity(key, FACING_RAD) for key in ("pitch_rad", "yaw_rad"))
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
    values: dict[str, Any] = entry.given(("count",), lambda key: entry.integer(key, least=1, most=MAX_COUNT))
    values |= entry.given(("seed",), lambda key: entry.integer(key, least=0))
    values |= entry.given(_ANGLES, lambda key: entry.quantity(key, TILT_RAD))
    values |= entry.given(("offset",), lambda key: entry.quantity(key, OFFSET_SHARE))
    if entry.has("distances_m"):
        distances_m = entry.array("distances_m", (None,))
        entry.check("distances_m", distances_m, DISTANCE_M)
        values["distances_m"] = tuple(distances_m.tolist())
    return values


def _name(entry: Fields) -> str:
    """A name that is a valid file name."""
    name = entry.text("name")
    if "/" in name or name.startswith("."):
        raise DataError(entry.location("name"), f"is {name!r}, must be a plain file name")
    return name
