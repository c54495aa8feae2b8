"""How errors of joints and links act at the poses of a robot whose build is not known (ringpose-method(7), section 13).

A wrong angle of a joint turns all that is behind the joint about its axis. Where the axes are follows from a pose of
the tool and a few lengths, for the two kinds of arm that most robots are: with a wrist whose three axes meet, and with
three parallel axes and an offset wrist. The lengths are drawn from the ranges in which those of robots are, as shares
of the arm's reach, and the covariances of the errors are averaged over these arms.

The base frame has its z axis along the first joint, the tool frame its z axis along the last one.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from ringpose.types.arrays import Array, Float64

ARMS = 32
"""Arms drawn of each kind."""

TOOL, SHOULDER, COLUMN, ELBOW_RAD, WRIST = (0.06, 0.25), (0.0, 0.5), (0.0, 0.25), (0.0, 0.2), (0.1, 0.25)
"""Ranges of lengths, as shares of the distance from the base to the wrist: from the wrist to the tool, height of the
shoulder (a base frame at its height occurs), its distance from the first axis, angle between the forearm and the fourth
axis, offsets of a wrist. They contain those of the data sheets of eight arms of 0.5 to 2 m."""

UPPER_ARM, STRETCHED = (0.42, 0.58), (0.65, 0.97)
"""Share of the upper arm in the arm's length, and how far the arm is stretched at the pose that is farthest away."""

GEAR = 2.0 / 3.0
"""Error of a gear, once a revolution of the joint, over that of a joint's zero or an axis' direction."""

_UP = np.array([0.0, 0.0, 1.0])

Vectors = Float64[Array, "arm view xyz=3"]
Draw = Callable[[tuple[float, float]], Float64[Array, "arm 1 1"]]


class Axes(NamedTuple):
    """Direction of a joint's axis, and a point on it, of each arm at each pose, in the base."""

    direction: Vectors
    point_m: Vectors


class ErrorFields(NamedTuple):
    """Covariances of the errors of two poses: rotation vector and translation in the frame of the tool."""

    angles: Float64[Array, "view view 6 6"]
    """By angles of joints, axes and gears, which turn the tool by 1 rad about each of its axes."""
    lengths: Float64[Array, "view view 6 6"]
    """By lengths of links, which move the tool by 1 m along each of its axes."""


def error_fields(rotation: Float64[Array, "view 3 3"], position_m: Float64[Array, "view xyz=3"]) -> ErrorFields:
    """The average over the arms that may have these poses of the tool in the base."""
    arms = [_with_spherical_wrist(rotation, position_m), _with_offset_wrist(rotation, position_m)]
    errors = [_errors(axes, rotation, position_m) for axes in arms]
    angles, lengths = (_covariance([each[kind] for each in errors]) for kind in (0, 1))
    turned_rad2 = np.einsum("iiaa->a", angles)[:3].mean() / len(position_m)
    moved_m2 = np.einsum("iiaa->a", lengths)[3:].mean() / len(position_m)
    return ErrorFields(angles / turned_rad2, lengths / moved_m2)


def _covariance(errors: list[Float64[Array, "arm view 6 error"]]) -> Float64[Array, "view view 6 6"]:
    """The mean over the arms of both kinds."""
    covariances = [np.einsum("miae,mjbe->ijab", each, each, optimize=True) / len(each) for each in errors]
    mean: Float64[Array, "view view 6 6"] = np.mean(covariances, axis=0)
    return mean


def _draw() -> Draw:
    """The function that gives a length of each arm; the arms are the same for all sessions."""
    from scipy.stats import qmc

    shares = iter(qmc.Sobol(7, rng=0).random(ARMS).T)
    return lambda limits: (limits[0] + (limits[1] - limits[0]) * next(shares))[:, None, None]


def _with_spherical_wrist(rotation: Float64[Array, "view 3 3"], position_m: Float64[Array, "view xyz=3"]) -> list[Axes]:
    """Arms with an upright first axis, shoulder and elbow, and a wrist whose three axes meet."""
    draw, size_m = _draw(), _size_m(position_m)
    last = np.broadcast_to(rotation[:, :, 2], (ARMS, *position_m.shape))
    wrist_m = position_m - draw(TOOL) * size_m * last
    outwards = _unit(wrist_m * [1.0, 1.0, 0.0])
    shoulder_m = draw(SHOULDER) * size_m * _UP + draw(COLUMN) * size_m * outwards
    bend = np.cross(outwards, _UP)
    elbow_m = _elbow_m(shoulder_m, wrist_m, bend, draw(UPPER_ARM), draw(STRETCHED))
    along, turn_rad = _unit(wrist_m - elbow_m), draw(ELBOW_RAD)
    forearm = np.cos(turn_rad) * along + np.sin(turn_rad) * np.cross(bend, along)
    return [
        *_first_axes(shoulder_m, elbow_m, bend), Axes(forearm, wrist_m),
        Axes(_unit(np.cross(forearm, last)), wrist_m), Axes(last, wrist_m),
    ]  # fmt: skip


def _with_offset_wrist(rotation: Float64[Array, "view 3 3"], position_m: Float64[Array, "view xyz=3"]) -> list[Axes]:
    """Arms whose fourth axis is parallel to those of shoulder and elbow, and beside them."""
    draw, size_m = _draw(), _size_m(position_m)
    last = np.broadcast_to(rotation[:, :, 2], (ARMS, *position_m.shape))
    wrist_m = position_m - draw(TOOL) * size_m * last
    shoulder_m = draw(SHOULDER) * size_m * _UP + np.zeros_like(wrist_m)
    # the plane of upper arm and forearm passes beside the first axis
    aside = draw(WRIST) * size_m / np.linalg.norm(wrist_m[..., :2], axis=-1, keepdims=True)
    azimuth_rad = np.arctan2(wrist_m[..., 1], wrist_m[..., 0]) - np.arcsin(np.clip(aside[..., 0], -0.99, 0.99))
    bend = np.stack([np.sin(azimuth_rad), -np.cos(azimuth_rad), np.zeros_like(azimuth_rad)], axis=-1)
    fifth = _unit(np.cross(bend, last))
    side = np.sign(draw((-1.0, 1.0)))
    end_m = wrist_m - side * draw(WRIST) * size_m * fifth
    end_m = end_m - np.sum(end_m * bend, axis=-1, keepdims=True) * bend
    elbow_m = _elbow_m(shoulder_m, end_m, bend, draw(UPPER_ARM), draw(STRETCHED))
    return [*_first_axes(shoulder_m, elbow_m, bend), Axes(bend, end_m), Axes(fifth, wrist_m), Axes(last, wrist_m)]


def _size_m(position_m: Float64[Array, "view xyz=3"]) -> float:
    return float(np.sqrt(np.mean(np.sum(position_m**2, axis=1))))


def _unit(vectors: Vectors) -> Vectors:
    return vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)


def _elbow_m(
    shoulder_m: Vectors, end_m: Vectors, bend: Vectors,
    upper_share: Float64[Array, "arm 1 1"], stretched: Float64[Array, "arm 1 1"],
) -> Vectors:  # fmt: skip
    """The elbow above the line from the shoulder to the end of the forearm, by the law of cosines."""
    reach_m = np.linalg.norm(end_m - shoulder_m, axis=-1, keepdims=True)
    arm_m = reach_m.max(axis=1, keepdims=True) / stretched
    upper_m, forearm_m = upper_share * arm_m, (1.0 - upper_share) * arm_m
    cosine = np.clip((upper_m**2 + reach_m**2 - forearm_m**2) / (2.0 * upper_m * reach_m), -1.0, 1.0)
    along = _unit(end_m - shoulder_m)
    above = np.cross(bend, along)
    above = above * np.where(above[..., 2:] < 0.0, -1.0, 1.0)
    return shoulder_m + upper_m * (cosine * along + np.sqrt(1.0 - cosine**2) * above)


def _first_axes(shoulder_m: Vectors, elbow_m: Vectors, bend: Vectors) -> list[Axes]:
    upright = np.broadcast_to(_UP, bend.shape)
    return [Axes(upright, np.zeros_like(bend)), Axes(bend, shoulder_m), Axes(bend, elbow_m)]


def _errors(
    axes: list[Axes], rotation: Float64[Array, "view 3 3"], position_m: Float64[Array, "view xyz=3"]
) -> tuple[Float64[Array, "arm view 6 angle"], Float64[Array, "arm view 6 length"]]:
    """What a unit error of each angle and of each length does to the tool, by Denavit and Hartenberg's parameters.

    These are, of each joint, its angle and offset along its axis, and of the link behind it, its length along the
    common normal of two axes and the angle between these about it. A gear's error is a sine of the joint's angle.
    """
    back = rotation.swapaxes(1, 2)

    def turned(direction: Vectors, point_m: Vectors) -> Float64[Array, "arm view 6"]:
        shift = np.cross(direction, position_m - point_m)
        return np.concatenate([np.einsum("vab,mvb->mva", back, each) for each in (direction, shift)], axis=-1)

    def shifted(direction: Vectors) -> Float64[Array, "arm view 6"]:
        shift = np.einsum("vab,mvb->mva", back, direction)
        return np.concatenate([np.zeros_like(shift), shift], axis=-1)

    last = axes[-1].direction
    ends = [*axes[1:], Axes(np.broadcast_to(rotation[:, :, 2], last.shape), np.broadcast_to(position_m, last.shape))]
    before = np.broadcast_to([1.0, 0.0, 0.0], last.shape)
    angles, lengths = [], []
    for joint, end in zip(axes, ends, strict=True):
        normal = _common_normal(joint, end) if end is not ends[-1] else np.broadcast_to(rotation[:, :, 0], last.shape)
        sine = np.sum(joint.direction * np.cross(before, normal), axis=-1, keepdims=True)
        cosine = np.sum(before * normal, axis=-1, keepdims=True)
        by_joint = turned(*joint)
        gear = GEAR / np.sqrt(2.0) / np.maximum(np.hypot(sine, cosine), 1e-9)
        angles += [by_joint, turned(normal, end.point_m), gear * sine * by_joint, gear * cosine * by_joint]
        lengths += [shifted(joint.direction), shifted(normal)]
        before = normal
    return np.stack(angles, axis=-1), np.stack(lengths, axis=-1)


def _common_normal(joint: Axes, following: Axes) -> Vectors:
    """Unit vectors across two axes; from the one to the other where they are parallel."""
    across = np.cross(joint.direction, following.direction)
    apart_m = following.point_m - joint.point_m
    apart_m = apart_m - np.sum(apart_m * joint.direction, axis=-1, keepdims=True) * joint.direction
    parallel = np.linalg.norm(across, axis=-1, keepdims=True) < 1e-6
    return _unit(np.where(parallel, apart_m, across))
