"""scene.yaml, the input of `ringpose simulate`; man/ringpose-simulate.1 documents its keys."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np

from ringpose.files.records.codec import OF_FILE, RecordType, definition_of
from ringpose.files.rigs import read_rig
from ringpose.files.scenes import rings, targets, views
from ringpose.files.scenes.motions import MotionEntry, mass_properties, motion_of
from ringpose.files.schema import SCENE, Fields
from ringpose.files.yaml import read_yaml
from ringpose.types import plausible
from ringpose.types.arrays import Array, Float64
from ringpose.types.obstacles import Obstacle
from ringpose.types.record import Form, Key, Presence
from ringpose.types.rig import Rig
from ringpose.types.scene import (
    Approach,
    Beacon,
    Earth,
    LaserLight,
    Light,
    Optics,
    RingView,
    Scene,
    Sensor,
    Speckle,
    TargetKind,
)
from ringpose.types.target import Body, Part, Revolution, RingShape

SCHEMA = "scene/1"

MAX_SCENE_SHOTS = 10_000_000
"""Maximum number of shots of all views together."""

NO_RING = RingShape(profile_m=np.array([[0.575, 0.0], [0.597, 0.0]]))
"""Where the ring of a target without a ring would be: poses of views refer to it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SunEntry:
    """The key `sun` of a scene."""

    irradiance_w_m2: Annotated[
        float, Key("Irradiance on a plane perpendicular to the rays.", plausible=plausible.IRRADIANCE_W_M2)
    ]
    direction: Annotated[Float64[Array, "xyz=3"], Key("Direction towards the sun, camera frame.", form=Form.DIRECTION)]
    diameter_rad: Annotated[
        float | None, Key("Angular diameter.", plausible=plausible.SUN_RAD, presence=Presence.IF_KNOWN)
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LightEntry:
    """A light of a scene; what it does not state is that of the sun of all lights, and dark."""

    ambient_w_m2: Annotated[
        float | None,
        Key(
            "Irradiance by the lamps and walls of a laboratory.",
            plausible=plausible.IRRADIANCE_W_M2,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    sun_w_m2: Annotated[
        float | None,
        Key(
            "Irradiance of its own sun on a plane perpendicular to the rays.",
            plausible=plausible.IRRADIANCE_W_M2,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    sun_direction: Annotated[
        Float64[Array, "xyz=3"] | None,
        Key("Direction towards its own sun, camera frame.", form=Form.DIRECTION, presence=Presence.IF_KNOWN),
    ] = None
    beacon: Annotated[Beacon | None, Key("A flashing lamp.", presence=Presence.IF_KNOWN)] = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SceneFile:
    """scene.yaml."""

    rig: Annotated[str, Key("The rig file, relative to the scene's folder; its lasers need `projector_m`.")]
    seed: Annotated[int, Key("Seed of random poses, speckle and noise.", least=0, presence=Presence.IF_KNOWN)] = 1
    sequence: Annotated[str, Key("Frames of a shot, as for `ringpose capture`.", presence=Presence.IF_KNOWN)] = (
        "off,all"
    )
    exposure_s: Annotated[
        float | None, Key("Exposure of each frame.", plausible=plausible.EXPOSURE_S, presence=Presence.IF_KNOWN)
    ] = None
    stripe_dn: Annotated[
        float | None,
        Key(
            "Instead of the exposure: grey value of the stripes on the ring's face.",
            least=0,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    period_s: Annotated[float | None, Key("Time between shots.", least=0, presence=Presence.IF_KNOWN)] = None
    start_s: Annotated[float | None, Key("Stamp of the first shot.", least=0, presence=Presence.IF_KNOWN)] = None
    ring: Annotated[rings.RingEntry | None, Key("The ring; needed without a target.", presence=Presence.IF_KNOWN)] = (
        None
    )
    body: Annotated[
        Body | None,
        Key("The box whose front face carries the ring; needed without a target.", presence=Presence.IF_KNOWN),
    ] = None
    target: Annotated[
        targets.TargetEntry | None, Key("Instead of ring and body: a model, or parts.", presence=Presence.IF_KNOWN)
    ] = None
    obstacles: Annotated[
        tuple[Obstacle, ...],
        Key("What stands on the ring's face or lies over it.", tag="kind", presence=Presence.IF_KNOWN),
    ] = ()
    gripper: Annotated[
        tuple[targets.BoxEntry, ...],
        Key(
            "Boxes in the camera frame that are fixed to the camera and may hide the ring, as a gripper's fingers do.",
            presence=Presence.IF_KNOWN,
        ),
    ] = ()
    sun: Annotated[
        SunEntry | None,
        Key("The sun in all lights that have no `sun_w_m2` of their own.", presence=Presence.IF_KNOWN),
    ] = None
    earth: Annotated[Earth | None, Key("The Earth, lit by the sun.", presence=Presence.IF_KNOWN)] = None
    motion: Annotated[
        MotionEntry | None, Key("Motion of the target; it is still without it.", presence=Presence.IF_KNOWN)
    ] = None
    lasers: Annotated[LaserLight, Key("The line lasers.", presence=Presence.IF_KNOWN)] = LaserLight()
    lights: Annotated[
        Mapping[str, LightEntry | None] | None,
        Key("Lights by their names; a dark one, `dim`, without it.", presence=Presence.IF_KNOWN),
    ] = None
    lens: Annotated[Optics, Key("The lens; its distortion is part of the rig.", presence=Presence.IF_KNOWN)] = Optics()
    sensor: Annotated[Sensor, Key("The linear camera model of EMVA 1288.", presence=Presence.IF_KNOWN)] = Sensor()
    speckle: Annotated[
        Speckle, Key("Speckle of laser light, before the blur of the lens.", presence=Presence.IF_KNOWN)
    ] = Speckle()
    trajectory: Annotated[
        tuple[views.ViewEntry | views.GeneratedViews, ...] | None,
        Key("Single views, and sets of random ones.", tag="generate", presence=Presence.IF_KNOWN),
    ] = None
    boards: Annotated[views.BoardsEntry | None, Key("Views of calibration boards.", presence=Presence.IF_KNOWN)] = None


RECORD = RecordType(
    cls=SceneFile,
    kind=SCENE,
    version=SCHEMA,
    description="scene.yaml: what `ringpose simulate` renders. Metres, radians, pixels, seconds, watts. Your own keys "
    "begin with x_.",
    is_file=True,
    strict=True,
)


def read_scene(path: Path) -> Scene:
    """The scene in a scene.yaml; the path of its rig file is relative to the scene's folder."""
    fields, entry = read_scene_file(path)
    rig = _rig(fields, entry, path.parent)
    space = _space(entry)
    lights = {"dim": replace(space, name="dim")}
    if entry.lights is not None:
        lights = {name: _light(name, light or LightEntry(), space) for name, light in entry.lights.items()}
    lasers = len(rig.lasers.names)
    values: dict[str, Any] = {}
    values["views"], values["approaches"] = _views(fields, entry, tuple(lights))
    boards = entry.boards or views.BoardsEntry()
    for key, board_set in (("camera", boards.camera), ("planes", boards.planes)):
        if board_set is not None:
            own = fields.fields("boards").fields(key)
            values["camera_boards" if key == "camera" else "plane_boards"] = views.board_set_of(own, board_set, lasers)
    values |= _target_and_motion(fields, entry, path.parent)
    values["gripper"] = targets.parts_of(fields, "gripper", entry.gripper)
    _check_number_of_shots(fields, values)
    if values["ring"] is NO_RING:
        for key in ("views", "approaches"):  # they show the rest
            values[key] = tuple(replace(view, target=_WITHOUT_RING[view.target]) for view in values[key])
    numbers = {key: getattr(entry, key) for key in ("exposure_s", "stripe_dn", "period_s", "start_s")}
    return Scene(
        rig=rig,
        lights=lights,
        seed=entry.seed,
        sequence=views.sequence_of(fields, "sequence", entry.sequence, lasers),
        lasers=entry.lasers,
        lens=entry.lens,
        sensor=entry.sensor,
        speckle=entry.speckle,
        **{key: number for key, number in numbers.items() if number is not None},
        **values,
    )


def read_scene_file(path: Path) -> tuple[Fields, SceneFile]:
    """The keys of a scene.yaml, and the same with their places for messages."""
    fields = read_yaml(path, RECORD.keys)
    fields.choice("ringpose", (SCHEMA,))
    return fields, definition_of(SceneFile).read(fields, OF_FILE)


def _views(
    fields: Fields, entry: SceneFile, lights: tuple[str, ...]
) -> tuple[tuple[RingView, ...], tuple[Approach, ...]]:
    """The views of the trajectory; a target that moves along a file needs none."""
    along_file = entry.motion is not None and entry.motion.file is not None
    if entry.trajectory is not None:
        return views.views_of(fields, "trajectory", entry.trajectory, lights, along_file)
    if not along_file:
        return (), ()
    moving = views.ViewEntry(name="moving")
    return (views.view_of(Fields(fields.file, {}, path="trajectory"), moving, lights, along_file),), ()


def _check_number_of_shots(fields: Fields, values: dict[str, Any]) -> None:
    approaches: tuple[Approach, ...] = values["approaches"]
    drawn = sum(approach.count * len(approach.distances_m) * len(approach.lights) for approach in approaches)
    shots = (len(values["views"]) + drawn) * values.get("shots", 1)
    if shots > MAX_SCENE_SHOTS:
        finding = f"gives {shots:g} shots, must give at most {MAX_SCENE_SHOTS:g}"
        raise fields.problem("trajectory", finding, "give fewer poses, distances, lights or shots of the motion")


def _target_and_motion(fields: Fields, entry: SceneFile, folder: Path) -> dict[str, Any]:
    target = _target(fields, entry)
    if entry.body is None and entry.target is None:
        raise fields.missing("body")
    values: dict[str, Any] = {"ring": target.ring or NO_RING, "body": entry.body, "parts": target.parts}
    values["obstacles"] = entry.obstacles
    if entry.obstacles and target.ring is None:
        raise fields.problem("obstacles", "lie on a ring, and the target has none", "remove them")
    if entry.motion is not None:
        inertia_and_center = _inertia_and_center(fields, target, entry.body)
        values["motion"] = motion_of(fields.fields("motion"), entry.motion, *inertia_and_center, folder)
        values["shots"] = entry.motion.shots
    return values


_WITHOUT_RING: Mapping[TargetKind, TargetKind] = {"ring": "body", "body": "body", "none": "none"}


def _target(fields: Fields, entry: SceneFile) -> targets.Target:
    """The parts and the ring of the scene."""
    target = targets.Target(parts=(), ring=None)
    if entry.target is not None:
        target = targets.target_of(fields.fields("target"), entry.target)
    elif entry.ring is None:
        raise fields.missing("ring")
    if entry.ring is not None:
        if target.ring is not None:
            raise fields.problem("ring", "is given, but the target has a ring", "remove one of them")
        target = targets.Target(parts=target.parts, ring=rings.ring_of(fields.fields("ring"), entry.ring))
    return target


def _inertia_and_center(
    fields: Fields, target: targets.Target, body: Body | None
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


def _rig(fields: Fields, entry: SceneFile, folder: Path) -> Rig:
    rig = read_rig(folder / entry.rig)
    for name, projector_m in zip(rig.lasers.names, rig.lasers.projector_m, strict=True):
        if np.isnan(projector_m).any():
            remedy = "add the point from which its light emerges"
            raise fields.problem("rig", f"laser {name!r} has no projector_m", remedy)
    return rig


def _space(entry: SceneFile) -> Light:
    """Sun and Earth, which all lights of the scene have in common unless they have their own sun."""
    space, sun = Light(name="space", earth=entry.earth), entry.sun
    if sun is not None:
        space = replace(space, sun_w_m2=sun.irradiance_w_m2, sun_direction=sun.direction)
        if sun.diameter_rad is not None:
            space = replace(space, sun_diameter_rad=sun.diameter_rad)
    return space


def _light(name: str, entry: LightEntry, space: Light) -> Light:
    own = {key: getattr(entry, key) for key in definition_of(LightEntry).names}
    return replace(space, name=name, **{key: value for key, value in own.items() if value is not None})
