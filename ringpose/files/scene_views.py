"""The parts of scene.yaml that say what stands where: sequences, the trajectory, board views."""

from typing import Any, cast, get_args

import cv2
import numpy as np

from ringpose.errors import DataError, UsageError
from ringpose.files.boards import board_of
from ringpose.files.fields import Fields
from ringpose.geometry.rotations import facing_normal
from ringpose.types.arrays import Array, Float64
from ringpose.types.scene import Approach, BoardApproach, BoardPlace, BoardSet, RingView, TargetKind
from ringpose.types.sequence import parsed_sequence

_VIEW_KEYS = ("name", "center_m", "normal", "pitch_rad", "yaw_rad", "roll_rad", "light", "target", "groups")
_APPROACH_KEYS = ("count", "distances_m", "lights", "tilt_rad", "clock_rad", "offset", "name", "seed")
_PLACE_KEYS = ("name", "camera_from_board_rvec", "camera_from_board_tvec_m")
_SET_KEYS = ("board", "views", "generate", "ambient_w_m2", "exposure_s", "sequence")
_BOARD_APPROACH_KEYS = ("count", "distances_m", "tilt_rad", "turn_rad", "offset", "seed")
_ANGLES = ("tilt_rad", "clock_rad", "turn_rad")


def read_sequence(fields: Fields, key: str, lasers: int) -> tuple[int, ...]:
    """Masks of the frames of a shot, from steps such as `off,1,2,3,all`."""
    try:
        steps = parsed_sequence(fields.text(key))
        masks = tuple(step.mask(lasers) for step in steps)
    except UsageError as error:
        raise fields.problem(key, error.found, error.remedy) from error
    if any(step.exposure for step in steps):
        raise fields.problem(key, "has steps with an exposure of their own", "leave out what begins with @")
    return masks


def read_trajectory(
    fields: Fields, key: str, lights: tuple[str, ...]
) -> tuple[tuple[RingView, ...], tuple[Approach, ...]]:
    """The views that are written out, and the sets to be drawn at random."""
    views: list[RingView] = []
    approaches: list[Approach] = []
    for entry in fields.each(key):
        if entry.has("generate"):
            alone = Fields(entry.file, entry.values, ("generate",), entry.path)
            approaches.append(_approach(alone.fields("generate", _APPROACH_KEYS), lights))
        else:
            views.append(_view(Fields(entry.file, entry.values, _VIEW_KEYS, entry.path), lights))
    names = [view.name for view in views]
    for name in names:
        if names.count(name) > 1:
            raise fields.problem(key, f"the name {name!r} stands twice")
    return tuple(views), tuple(approaches)


def read_board_set(fields: Fields, key: str, lasers: int) -> BoardSet:
    """A board and its views."""
    entry = fields.fields(key, _SET_KEYS)
    values: dict[str, Any] = {"board": board_of(entry.fields("board"))}
    if values["board"].kind == "asymmetric_circles":
        raise entry.problem("board.kind", "is 'asymmetric_circles', which is not simulated")
    if entry.has("views"):
        values["places"] = tuple(_place(place) for place in entry.each("views", _PLACE_KEYS))
    if entry.has("generate"):
        values["approach"] = _board_approach(entry.fields("generate", _BOARD_APPROACH_KEYS))
    values |= {k: entry.number(k, least=0) for k in ("ambient_w_m2", "exposure_s") if entry.has(k)}
    if entry.has("sequence"):
        values["sequence"] = read_sequence(entry, "sequence", lasers)
    return BoardSet(**values)


def _view(entry: Fields, lights: tuple[str, ...]) -> RingView:
    values: dict[str, Any] = {"name": _name(entry), "center_m": entry.point_m("center_m"), "normal": _normal(entry)}
    if entry.has("light"):
        values["light"] = entry.choice("light", lights)
    elif "dim" not in lights:
        raise entry.problem("light", "is not given, and no light is called 'dim'")
    if entry.has("target"):
        values["target"] = cast(TargetKind, entry.choice("target", get_args(TargetKind)))
    if entry.has("roll_rad"):
        values["roll_rad"] = entry.number("roll_rad", least=-7, most=7)
    if entry.has("groups"):
        values["groups"] = entry.fields("groups").values
        if not all(isinstance(value, str | int | float | bool) for value in values["groups"].values()):
            raise entry.problem("groups", "must hold texts, numbers, true or false")
    return RingView(**values)


def _normal(entry: Fields) -> Float64[Array, "3"]:
    """Given itself or by the paper's pitch and yaw; always towards the camera."""
    if not entry.has("normal"):
        pitch, yaw = (entry.number(key, least=-1.5, most=1.5) for key in ("pitch_rad", "yaw_rad"))
        return facing_normal(pitch, yaw)
    if entry.has("pitch_rad") or entry.has("yaw_rad"):
        raise entry.problem("normal", "is given beside pitch_rad or yaw_rad", "give one of the two")
    normal = entry.unit_vector("normal")
    if normal[2] >= 0:
        raise entry.problem("normal", "points away from the camera", "turn its signs: z is forward")
    return normal


def _approach(entry: Fields, lights: tuple[str, ...]) -> Approach:
    values = _drawn(entry)
    values |= {"name": _name(entry)} if entry.has("name") else {}
    if entry.has("lights"):
        values["lights"] = entry.texts("lights")
    for light in values.get("lights", ("dim",)):
        if light not in lights:
            raise entry.problem("lights", f"has {light!r}, which is none of {', '.join(lights)}")
    return Approach(**values)


def _board_approach(entry: Fields) -> BoardApproach:
    values = _drawn(entry)
    if "distances_m" in values and len(values["distances_m"]) != 2:
        raise entry.problem("distances_m", "must be the nearest and the farthest distance")
    return BoardApproach(**values)


def _drawn(entry: Fields) -> dict[str, Any]:
    """What both kinds of random sets have."""
    values: dict[str, Any] = {key: entry.integer(key, least=0) for key in ("count", "seed") if entry.has(key)}
    values |= {key: entry.number(key, least=0, most=1.2) for key in _ANGLES if entry.has(key)}
    if entry.has("offset"):
        values["offset"] = entry.number("offset", least=0, most=0.5)
    if entry.has("distances_m"):
        distances_m = entry.array("distances_m", (None,))
        entry.check_metres("distances_m", distances_m)
        if (distances_m <= 0).any():
            raise entry.problem("distances_m", "must be positive")
        values["distances_m"] = tuple(distances_m.tolist())
    return values


def _place(entry: Fields) -> BoardPlace:
    rotation = cv2.Rodrigues(entry.vector("camera_from_board_rvec", 3))[0]
    return BoardPlace(
        name=_name(entry),
        rotation=np.asarray(rotation, dtype=np.float64),
        translation_m=entry.point_m("camera_from_board_tvec_m"),
    )


def _name(entry: Fields) -> str:
    """A name that can be a file's."""
    name = entry.text("name")
    if "/" in name or name.startswith("."):
        raise DataError(entry.place("name"), f"is {name!r}, must be a plain file name")
    return name
