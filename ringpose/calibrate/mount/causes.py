"""The likely cause of robot poses that contradict the views: another convention, unit or direction."""

from collections.abc import Iterator, Sequence
from typing import Any, cast

import numpy as np

from ringpose.calibrate.mount.closed_form import (
    Transform,
    Turns,
    best_rotation,
    closed_form_mount,
    moving_from_fixed,
    turns_between,
)
from ringpose.calibrate.mount.stations import Station
from ringpose.geometry.robot_conventions import ANGLE_ORDERS, PoseConvention
from ringpose.types.arrays import Array, Float64

CONTRADICTION_RAD = np.radians(1.0)
"""Median difference of the rotations of robot and camera from which another convention is looked for."""

MIN_GAIN = 5.0
"""An explanation reduces that difference at least by this factor."""

_MAX_VIEWS = 12


def rotation_error_rad(turns: Turns) -> float:
    """Median difference between the rotation vectors of robot and camera, after the best rotation between them."""
    rotation = best_rotation(turns)
    return float(np.median(np.linalg.norm(turns.robot_rad - turns.camera_rad @ rotation.T, axis=1)))


def likely_cause(
    stations: Sequence[Station], boards: Sequence[Transform], eye_to_hand: bool, convention: PoseConvention | None
) -> str:
    """The reading of the robot's poses that explains the views much better; empty if there is none.

    Several readings may explain the rotations, as those of some orders are the inverse ones in other axes; the
    positions decide between them.
    """
    stations, boards = stations[:_MAX_VIEWS], boards[:_MAX_VIEWS]
    given = [station.base_from_tool for station in stations]
    rotations = [pose.rotation for pose in given]
    before = _error_rad(given, boards, eye_to_hand)
    readings = [(given, not eye_to_hand, _other_direction(eye_to_hand))]
    for other, words in other_rotations(rotations, convention):
        poses = [Transform(rotation, pose.translation_m) for rotation, pose in zip(other, given, strict=True)]
        readings.append((poses, eye_to_hand, words))
    errors = [_error_rad(poses, boards, to_hand) for poses, to_hand, _ in readings]
    likely = [index for index, error in enumerate(errors) if error < before / MIN_GAIN and error < 2.0 * min(errors)]
    if not likely:
        return ""
    best = min(likely, key=lambda index: _scatter_m(readings[index][0], boards, readings[index][1]))
    return (
        f"{readings[best][2]}: the rotations then differ by {np.degrees(errors[best]):.2g} instead of "
        f"{np.degrees(before):.2g} degrees"
    )


def _error_rad(poses: Sequence[Transform], boards: Sequence[Transform], eye_to_hand: bool) -> float:
    return rotation_error_rad(turns_between([moving_from_fixed(pose, eye_to_hand) for pose in poses], boards))


def _scatter_m(poses: Sequence[Transform], boards: Sequence[Transform], eye_to_hand: bool) -> float:
    """How far the places of the board scatter that the views give with the mount in closed form."""
    robot = [moving_from_fixed(pose, eye_to_hand) for pose in poses]
    mount, fixed, _ = closed_form_mount(robot, boards, turns_between(robot, boards))
    places_m = [one.inverse().after(mount).after(board).translation_m for one, board in zip(robot, boards, strict=True)]
    return float(np.median(np.linalg.norm(np.array(places_m) - fixed.translation_m, axis=1)))


def _other_direction(eye_to_hand: bool) -> str:
    other = "the camera is on the robot: leave out --eye-to-hand" if eye_to_hand else (
        "the camera is fixed beside the robot and the board is on its tool: give --eye-to-hand"
    )  # fmt: skip
    return f"the poses are those of the base in the tool, inverted; or {other}"


def other_rotations(
    given: Sequence[Float64[Array, "3 3"]], convention: PoseConvention | None
) -> Iterator[tuple[list[Float64[Array, "3 3"]], str]]:
    """The rotations that the same numbers are in other conventions."""
    from scipy.spatial.transform import Rotation

    rotations = Rotation.from_matrix(np.array(given))
    form = convention.rotation if convention is not None else "quaternion"
    if form == "quaternion":
        order = convention.order if convention is not None else "xyzw"
        xyzw = rotations.as_quat()
        numbers = xyzw if order == "xyzw" else np.roll(xyzw, 1, axis=1)
        other = np.roll(numbers, -1, axis=1) if order == "xyzw" else numbers
        words = "wxyz (w first)" if order == "xyzw" else "xyzw (w last)"
        yield list(Rotation.from_quat(other).as_matrix()), f"the quaternions are {words}"
        return
    if form == "matrix" or convention is None:
        return
    if form == "rotation_vector":
        numbers, own = rotations.as_rotvec(), "rotation_vector"
    else:
        numbers, own = rotations.as_euler(cast(Any, convention.order)), convention.order
    for order in ANGLE_ORDERS:
        if order != own:
            yield list(Rotation.from_euler(order, numbers).as_matrix()), f"the angles are of the order {order}"
    if form == "angles":
        yield list(Rotation.from_rotvec(numbers).as_matrix()), "the three numbers are a rotation vector"
