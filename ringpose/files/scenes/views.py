"""The views of a scene: the keys `trajectory` and `boards`, single views and sets of random ones."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Annotated, Any

import cv2
import numpy as np

from ringpose.errors import UsageError
from ringpose.files.boards import board_of
from ringpose.files.schema import Fields
from ringpose.geometry.board import LAYOUTS
from ringpose.geometry.rotations import facing_normal
from ringpose.types import plausible
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import Board
from ringpose.types.record import Form, Key, Presence
from ringpose.types.scene import (
    Approach,
    BoardApproach,
    BoardSet,
    NamedBoardPose,
    RingView,
    TargetKind,
)
from ringpose.types.session import parsed_sequence


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ViewEntry:
    """A single view of the ring."""

    name: Annotated[str, Key("Name of the shot.", form=Form.FILE_NAME)]
    center_m: Annotated[
        Float64[Array, "xyz=3"] | None,
        Key(
            "Centre of the ring's face; needed unless `motion` names a file.",
            form=Form.BOUNDED_LENGTH,
            plausible=plausible.TARGET_DISTANCE_M,
            presence=Presence.IF_KNOWN,
        ),
    ] = None
    normal: Annotated[
        Float64[Array, "xyz=3"] | None,
        Key("Normal of the face, towards the camera.", form=Form.UNIT_VECTOR, presence=Presence.IF_KNOWN),
    ] = None
    pitch_rad: Annotated[
        float | None,
        Key("Pitch of the paper, instead of the normal.", plausible=plausible.FACING_RAD, presence=Presence.IF_KNOWN),
    ] = None
    yaw_rad: Annotated[
        float | None, Key("Yaw of the paper.", plausible=plausible.FACING_RAD, presence=Presence.IF_KNOWN)
    ] = None
    roll_rad: Annotated[
        float,
        Key("Rotation of the body about the normal.", plausible=plausible.ANGLE_RAD, presence=Presence.IF_KNOWN),
    ] = 0.0
    light: Annotated[str | None, Key("Name of a light; `dim` without it.", presence=Presence.IF_KNOWN)] = None
    target: Annotated[
        TargetKind,
        Key("`ring`, `body` for the target without its ring, or `none`.", presence=Presence.IF_KNOWN),
    ] = "ring"
    groups: Annotated[
        Mapping[str, str | float | int | bool],
        Key("Copied to the truth, for `ringpose bench --by`.", presence=Presence.IF_KNOWN),
    ] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class GeneratedViews:
    """A set of random views of the ring."""

    generate: Annotated[Approach, Key("Limits of the random views.")]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardViewEntry:
    """A single view of a board."""

    name: Annotated[str, Key("Name of the shot.", form=Form.FILE_NAME)]
    camera_from_board_rvec: Annotated[Float64[Array, "xyz=3"], Key("Rotation vector of the board, in radians.")]
    camera_from_board_tvec_m: Annotated[
        Float64[Array, "xyz=3"],
        Key("Place of the board's corner.", form=Form.BOUNDED_LENGTH, plausible=plausible.DISTANCE_M),
    ]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardSetEntry:
    """Views of one calibration board."""

    board: Annotated[Board, Key("The board, with the keys of a board file.")]
    views: Annotated[tuple[BoardViewEntry, ...], Key("Single views.", presence=Presence.IF_KNOWN)] = ()
    generate: Annotated[BoardApproach | None, Key("Limits of random views.", presence=Presence.IF_KNOWN)] = None
    ambient_w_m2: Annotated[
        float | None,
        Key("Irradiance by the lamps.", plausible=plausible.IRRADIANCE_W_M2, presence=Presence.IF_KNOWN),
    ] = None
    exposure_s: Annotated[
        float | None, Key("Exposure.", plausible=plausible.EXPOSURE_S, presence=Presence.IF_KNOWN)
    ] = None
    sequence: Annotated[
        str | None, Key("Frames of a shot, as for `ringpose capture`; `off` without it.", presence=Presence.IF_KNOWN)
    ] = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardsEntry:
    """The key `boards` of a scene."""

    camera: Annotated[
        BoardSetEntry | None, Key("Views for `ringpose calibrate-camera`.", presence=Presence.IF_KNOWN)
    ] = None
    planes: Annotated[
        BoardSetEntry | None, Key("Views for `ringpose calibrate-planes`.", presence=Presence.IF_KNOWN)
    ] = None


def sequence_of(fields: Fields, key: str, text: str, lasers: int) -> tuple[int, ...]:
    """Laser masks of the frames of a shot, from steps such as `off,1,2,3,all`."""
    try:
        steps = parsed_sequence(text)
        masks = tuple(step.mask(lasers) for step in steps)
    except UsageError as error:
        raise fields.problem(key, error.finding, error.remedy) from error
    if any(step.exposure for step in steps):
        raise fields.problem(key, "has steps with an exposure of their own", "leave out what begins with @")
    return masks


def views_of(
    fields: Fields, key: str, entries: Sequence[ViewEntry | GeneratedViews], lights: tuple[str, ...], along_file: bool
) -> tuple[tuple[RingView, ...], tuple[Approach, ...]]:
    """The single views of a trajectory, and its approaches, which are sets of random views (`generate`).

    `lights` are the names of the scene's lights, one of which a view names. The poses of views `along_file` are in the
    trajectory file.
    """
    views: list[RingView] = []
    approaches: list[Approach] = []
    for place, entry in zip(fields.each(key), entries, strict=True):
        if isinstance(entry, ViewEntry):
            views.append(view_of(place, entry, lights, along_file))
            continue
        if along_file:
            raise place.problem("generate", "draws poses, but those of motion.file are given")
        for light in entry.generate.lights:
            if light not in lights:
                finding = f"has {light!r}, must be one of {', '.join(lights)}"
                raise place.problem("generate.lights", finding)
        approaches.append(entry.generate)
    names = [view.name for view in views]
    for name in names:
        if names.count(name) > 1:
            raise fields.problem(key, f"the name {name!r} occurs twice")
    return tuple(views), tuple(approaches)


_POSE_OF_VIEW = ("center_m", "normal", "pitch_rad", "yaw_rad", "roll_rad")


def view_of(fields: Fields, entry: ViewEntry, lights: tuple[str, ...], along_file: bool) -> RingView:
    """A single view."""
    if along_file:
        for key in filter(fields.has, _POSE_OF_VIEW):
            raise fields.problem(key, "is given, but the poses are those of motion.file", "remove it")
        center_m, normal = np.zeros(3), np.array([0.0, 0.0, -1.0])  # not used
    else:
        center_m, normal = _center_m(fields), _normal(fields, entry)
    if entry.light is not None:
        fields.choice("light", lights)
    elif "dim" not in lights:
        raise fields.problem("light", "is missing, and there is no light 'dim'")
    return RingView(
        name=entry.name,
        center_m=center_m,
        normal=normal,
        roll_rad=entry.roll_rad,
        light=entry.light or "dim",
        target=entry.target,
        groups=entry.groups,
    )


def _center_m(fields: Fields) -> Float64[Array, "3"]:
    center_m = fields.vector("center_m", 3)
    if center_m[2] <= 0:
        raise fields.problem("center_m", f"lies behind the camera, at z = {center_m[2]:g}", "z is forward")
    return center_m


def _normal(fields: Fields, entry: ViewEntry) -> Float64[Array, "3"]:
    """The normal, given as a vector or by the paper's pitch and yaw; it must point towards the camera."""
    if entry.normal is None:
        return facing_normal(fields.number("pitch_rad"), fields.number("yaw_rad"))
    if entry.pitch_rad is not None or entry.yaw_rad is not None:
        raise fields.problem("normal", "cannot be combined with pitch_rad or yaw_rad", "give one of the two")
    if entry.normal[2] >= 0:
        raise fields.problem("normal", "points away from the camera", "change its sign: z is forward")
    return entry.normal


def board_set_of(fields: Fields, entry: BoardSetEntry, lasers: int) -> BoardSet:
    """A board and its views."""
    board = board_of(fields.fields("board"))
    if LAYOUTS[board.kind].pattern == "circles":
        raise fields.problem("board.kind", f"is {board.kind!r}, which is not simulated")
    poses = tuple(
        NamedBoardPose(
            name=view.name,
            rotation=np.asarray(cv2.Rodrigues(view.camera_from_board_rvec)[0], dtype=np.float64),
            translation_m=view.camera_from_board_tvec_m,
        )
        for view in entry.views
    )
    given: dict[str, Any] = {"ambient_w_m2": entry.ambient_w_m2, "exposure_s": entry.exposure_s}
    if entry.sequence is not None:
        given["sequence"] = sequence_of(fields, "sequence", entry.sequence, lasers)
    given = {key: value for key, value in given.items() if value is not None}
    return BoardSet(board=board, poses=poses, approach=entry.generate, **given)
