"""Which pose of the robot belongs to which view: by name, by stamp, or by order."""

import re
from collections.abc import Callable, Sequence
from pathlib import PurePath

import numpy as np

from ringpose.calibrate.mount.adjustment import PRIOR_ROTATION_RAD, PRIOR_TRANSLATION_M
from ringpose.calibrate.mount.moving import ToolMotion
from ringpose.errors import DataError
from ringpose.types.robot import ReportedPose

MAX_APART_S = 1.0
"""Longest time between a shot and the pose of a robot that stands still."""

MAX_MOVED_M, MAX_TURNED_RAD = 1e-3, 1e-3
"""Largest difference of the poses before and after a shot that still count as standing."""

MAX_REPEATED = 6.0
"""Displacement, in standard deviations of a robot's usual error, which two poses of one that rests do not have: chance
gives it once in ten thousand; halved, robots at rest would be said to move, doubled, a motion by 1 mm is overlooked."""


def matched_poses(
    names: Sequence[str], stamps_s: Sequence[float], poses: Sequence[ReportedPose], location: str
) -> list[ReportedPose | DataError]:
    """The pose of each view, or why it has none: by the names, else by the stamps, else by their order."""
    if any(pose.name for pose in poses):
        unnamed = next((pose for pose in poses if not pose.name), None)
        if unnamed is not None:
            raise DataError(unnamed.location, "names no shot, as other poses do", "give all poses a shot, or none")
        return _by_name(names, poses)
    if all(pose.stamp_s is not None for pose in poses):
        poses = sorted(poses, key=lambda pose: pose.stamp_s or 0.0)
        _check_clocks(stamps_s, poses, location)
        return [_at_stamp(name, stamp_s, poses) for name, stamp_s in zip(names, stamps_s, strict=True)]
    if len(poses) != len(names):
        finding = f"has {len(poses)} poses without names or stamps for {len(names)} images"
        raise DataError(
            location, finding, "give one for each image in their order, or name the images in a column shot"
        )
    return list(poses)


def _by_name(names: Sequence[str], poses: Sequence[ReportedPose]) -> list[ReportedPose | DataError]:
    """Poses by the name of the image without its suffix; else by the number at the end of both names, or by order.

    Numbers that do not agree, as those of p10, p20 and so on, are those of a robot's program.
    """
    pairs = _pairs(names, poses, lambda name: PurePath(name).stem)
    if all(pose is None for pose in pairs):
        pairs = _pairs(names, poses, _last_number)
        if None in pairs and len(poses) == len(names):
            return list(poses)
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


def _check_clocks(stamps_s: Sequence[float], poses: Sequence[ReportedPose], location: str) -> None:
    """Reject stamps of which none is near one of an image: those of other clocks, or of the files of the images."""
    known_s = np.array([stamp_s for stamp_s in stamps_s if np.isfinite(stamp_s) and stamp_s != 0.0])
    if not len(known_s):
        return
    apart_s = float(np.abs(known_s[:, None] - [pose.stamp_s for pose in poses]).min())
    if apart_s > MAX_APART_S:
        finding = f"its stamps are all {apart_s:.4g} s or more away from those of the images"
        remedy = (
            "that of an image that is no shot is the time of its file: name the images in a column shot, or, for poses "
            "in the order of the images, leave the stamps out (in a table: - for stamp_s in --robot-columns)"
        )
        raise DataError(location, finding, remedy)


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
            return DataError(name, finding, "let it stand still at each view, or give --moving")
    return poses[nearest]


def motion_finding(stamps_s: Sequence[float], motion: ToolMotion) -> str:
    """At how many of the views the tool moves, and how fast; empty if it stands still at all of them."""
    instants = [instant for instant in map(motion.at, stamps_s) if instant is not None]
    twists = np.array([instant.twist for instant in instants]).reshape(-1, 6)
    rate_rad_s, speed_m_s = (np.linalg.norm(twists[:, part], axis=1) for part in (slice(0, 3), slice(3, 6)))
    around_s = 2.0 * motion.span_s
    moving = (speed_m_s * around_s > MAX_REPEATED * PRIOR_TRANSLATION_M) | (
        rate_rad_s * around_s > MAX_REPEATED * PRIOR_ROTATION_RAD
    )
    if not moving.any():
        return ""
    return (
        f"the robot moves at {moving.sum()} of {len(stamps_s)} views, by up to {1e3 * speed_m_s.max():.3g} mm/s and "
        f"{np.degrees(rate_rad_s.max()):.2g} degrees/s: clocks that differ by 10 ms are an error of "
        f"{10.0 * speed_m_s.max():.2g} mm"
    )
