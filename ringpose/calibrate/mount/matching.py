"""Which pose of the robot belongs to which view: by name, by stamp, or by order."""

import re
from collections.abc import Callable, Sequence
from pathlib import PurePath

import numpy as np

from ringpose.errors import DataError
from ringpose.types.robot import ReportedPose

MAX_APART_S = 1.0
"""Longest time between a shot and the pose of a robot that stands still."""

MAX_MOVED_M, MAX_TURNED_RAD = 1e-3, 1e-3
"""Largest difference of the poses before and after a shot that still count as standing."""


def matched_poses(
    names: Sequence[str], stamps_s: Sequence[float], poses: Sequence[ReportedPose], location: str
) -> list[ReportedPose | DataError]:
    """The pose of each view, or why it has none: by the names, else by the stamps, else by their order."""
    if any(pose.name for pose in poses):
        return _by_name(names, poses)
    if all(pose.stamp_s is not None for pose in poses):
        poses = sorted(poses, key=lambda pose: pose.stamp_s or 0.0)
        return [_at_stamp(name, stamp_s, poses) for name, stamp_s in zip(names, stamps_s, strict=True)]
    if len(poses) != len(names):
        finding = f"has {len(poses)} poses without names or stamps for {len(names)} images"
        raise DataError(
            location, finding, "give one for each image in their order, or name the images in a column shot"
        )
    return list(poses)


def _by_name(names: Sequence[str], poses: Sequence[ReportedPose]) -> list[ReportedPose | DataError]:
    """Poses by the name of the image without its suffix; else by the number at the end of both names."""
    pairs = _pairs(names, poses, lambda name: PurePath(name).stem)
    if all(pose is None for pose in pairs):
        pairs = _pairs(names, poses, _last_number)
    remedy = f"the poses are of {poses[0].name} to {poses[-1].name}"
    return [
        pose or DataError(name, "has no pose of the robot", remedy) for name, pose in zip(names, pairs, strict=True)
    ]


def _pairs(names: Sequence[str], poses: Sequence[ReportedPose], key: Callable[[str], str]) -> list[ReportedPose | None]:
    by_key: dict[str, list[ReportedPose]] = {}
    for pose in poses:
        by_key.setdefault(key(pose.name), []).append(pose)
    keys = [key(name) for name in names]
    return [by_key[one][0] if one and len(by_key.get(one, ())) == 1 and keys.count(one) == 1 else None for one in keys]


def _last_number(name: str) -> str:
    numbers = re.findall(r"\d+", PurePath(name).stem)
    return numbers[-1].lstrip("0") or "0" if numbers else ""


def _at_stamp(name: str, stamp_s: float, poses: Sequence[ReportedPose]) -> ReportedPose | DataError:
    """The nearest of the poses, given in the order of time, of a robot that stands still at the time of the shot."""
    if not np.isfinite(stamp_s) or stamp_s == 0.0:
        return DataError(name, "has no stamp, and the robot's poses have no names", "name the images in a column shot")
    stamps_s = np.array([pose.stamp_s for pose in poses], dtype=np.float64)
    nearest = int(np.argmin(np.abs(stamps_s - stamp_s)))
    apart_s = abs(float(stamps_s[nearest]) - stamp_s)
    if apart_s > MAX_APART_S:
        return DataError(
            name, f"has no pose of the robot within {MAX_APART_S:g} s: the nearest is {apart_s:.4g} s away"
        )
    before = [pose for pose in poses if stamp_s - MAX_APART_S <= (pose.stamp_s or 0.0) <= stamp_s]
    after = [pose for pose in poses if stamp_s <= (pose.stamp_s or 0.0) <= stamp_s + MAX_APART_S]
    if before and after:
        first, last = before[-1], after[0]
        moved_m = float(np.linalg.norm(first.position_m - last.position_m))
        if moved_m > MAX_MOVED_M or np.abs(first.rotation - last.rotation).max() > MAX_TURNED_RAD:
            finding = f"the robot moved while it was taken, by {1e3 * moved_m:.3g} mm between two poses"
            return DataError(name, finding, "let it stand still at each view")
    return poses[nearest]
