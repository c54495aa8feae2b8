"""truth.jsonl: the ground truth, one record per shot."""

from collections.abc import Iterator, Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, cast

import numpy as np

from ringpose.files import records
from ringpose.files.inputs import file_lines
from ringpose.files.schema import Fields, kind
from ringpose.types.arrays import Array, Float64
from ringpose.types.plausible import RING_RADIUS_M, TARGET_DISTANCE_M
from ringpose.types.scene import Truth, TruthFrame

_KEYS = ("schema", *Truth.__slots__)
_FRAME_KEYS = TruthFrame.__slots__
_EXPECT = ("pose", "partial", "no_target")


def read_truths(path: Path) -> Iterator[Truth]:
    """Yield the truths in a file in order; a shot that occurs twice is rejected."""
    shots: set[str] = set()
    for location, record in records.read(file_lines(path), str(path)):
        truth = truth_of(Fields(location, record, _KEYS))
        if truth.shot in shots:
            raise Fields(location, record).problem("shot", f"{truth.shot!r} occurs twice")
        shots.add(truth.shot)
        yield truth


def truth_of(fields: Fields) -> Truth:
    """The truth in one record."""
    return Truth(
        shot=fields.text("shot"),
        expect=cast(Literal["pose", "partial", "no_target"], fields.choice("expect", _EXPECT)),
        center_m=fields.sized("center_m", TARGET_DISTANCE_M) if fields.has("center_m") else None,
        normal=fields.unit_vector("normal") if fields.has("normal") else None,
        radius_inner_m=fields.quantity("radius_inner_m", RING_RADIUS_M) if fields.has("radius_inner_m") else None,
        radius_outer_m=fields.quantity("radius_outer_m", RING_RADIUS_M) if fields.has("radius_outer_m") else None,
        break_points_px=_break_points(fields) if fields.has("break_points_px") else None,
        stamp_s=fields.stamp_s("stamp_s") if fields.has("stamp_s") else None,
        velocity_m_s=fields.vector("velocity_m_s", 3) if fields.has("velocity_m_s") else None,
        angular_velocity_rad_s=fields.vector("angular_velocity_rad_s", 3)
        if fields.has("angular_velocity_rad_s")
        else None,
        frames=_frames(fields) if fields.has("frames") else (),
        groups=_groups(fields.fields("groups")) if fields.has("groups") else {},
    )


def truth_record(truth: Truth) -> dict[str, Any]:
    """The record that `truth_of` reads; a break point that is not visible is null."""
    motion = {
        "stamp_s": truth.stamp_s,
        "velocity_m_s": truth.velocity_m_s,
        "angular_velocity_rad_s": truth.angular_velocity_rad_s,
    }
    return {
        "shot": truth.shot,
        "center_m": truth.center_m,
        "normal": truth.normal,
        "radius_inner_m": truth.radius_inner_m,
        "radius_outer_m": truth.radius_outer_m,
        "break_points_px": None if truth.break_points_px is None else _points_or_null(truth.break_points_px),
        "expect": truth.expect,
        "groups": dict(truth.groups),
        **{name: value for name, value in motion.items() if value is not None},
        **({"frames": [_frame_record(frame) for frame in truth.frames]} if truth.frames else {}),
    }


def _frame_record(frame: TruthFrame) -> dict[str, Any]:
    points = frame.break_points_px
    return {
        "stamp_s": frame.stamp_s,
        "center_m": frame.center_m,
        "normal": frame.normal,
        "break_points_px": None if points is None else _points_or_null(points),
    }


def _frames(fields: Fields) -> tuple[TruthFrame, ...]:
    frames = tuple(
        TruthFrame(
            stamp_s=each.stamp_s("stamp_s"),
            center_m=each.sized("center_m", TARGET_DISTANCE_M),
            normal=each.unit_vector("normal"),
            break_points_px=_break_points(each) if each.has("break_points_px") else None,
        )
        for each in fields.each("frames", _FRAME_KEYS)
    )
    if any(later.stamp_s <= earlier.stamp_s for earlier, later in pairwise(frames)):
        raise fields.problem("frames", "are not in chronological order: stamp_s must increase")
    return frames


def _groups(fields: Fields) -> Mapping[str, str | float | int | bool]:
    for key, value in fields.values.items():
        if not isinstance(key, str) or not isinstance(value, str | float | int):
            raise fields.problem(str(key), f"is {kind(value)}, must be a text, a number, true or false")
    return fields.values


def _break_points(fields: Fields) -> Float64[Array, "laser edge=2 xy=2"]:
    """Break points in pixels; a missing one is null, or a list of two nulls."""
    lasers = fields.raw("break_points_px")
    filled = lasers
    if isinstance(lasers, list):
        nothing = [None, None]
        filled = [
            [nothing if p is None else p for p in edges] if isinstance(edges, list) else edges for edges in lasers
        ]
    shaped = Fields(fields.file, {"break_points_px": filled}, path=fields.path)
    return shaped.array("break_points_px", (None, 2, 2), allow_nan=True)


def _points_or_null(points: Float64[Array, "laser edge=2 xy=2"]) -> list[list[Any]]:
    return [[None if np.isnan(p).any() else p.tolist() for p in edges] for edges in points]
