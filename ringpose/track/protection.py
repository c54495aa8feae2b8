"""How far the pose of a track may be off: the errors of its filter, and what may be wrong in all of its shots.

A filter averages: if the levels of shots leave room for faults, the error of their weighted mean is at most the
weighted mean of what these leave room for (ringpose-method(7), section 15).
"""

from collections.abc import Sequence
from math import inf
from typing import NamedTuple

import numpy as np

from ringpose.measure.status import unbounded
from ringpose.pose.protection import MAX_ANGLE_RAD, NORMAL, in_plane
from ringpose.types.arrays import Array, Float64
from ringpose.types.options import PoseFrame
from ringpose.types.pose import PoseFlag, PoseLine, RingPose
from ringpose.types.protection import Protection

LEVELS = 6
"""Levels of a pose: grasp point along the normal and radially, normal, centre by axis."""


class ShotLevels(NamedTuple):
    """What the levels of a shot leave room for beyond the errors of its covariance."""

    risk: float
    uncovered: float
    excess: Float64[Array, "level=6"]
    variance: Float64[Array, "level=6"]
    """Of the quantities, by which the filter weights the shot."""


def shot_levels(line: PoseLine, frame: str) -> ShotLevels | None:
    """The levels of a pose line, with the centre's in the frame of the track; None for a line without levels."""
    pose, own = line.pose, line.protection
    if pose is None or own is None:
        return None
    level = np.array([own.grasp_normal_m, own.grasp_radial_m, own.normal_rad, *own.center_m])
    multiple, variance = _gaussian_levels(pose, own.risk - own.uncovered)
    variance = variance / own.sd_factor**2  # a plane that has moved is common to all shots: its error is in the level
    # a quantity whose direction is not known counts with its whole level, and the weight of a Gaussian with that level
    known = np.isfinite(variance)
    excess = np.maximum(level - np.where(known, multiple * np.sqrt(np.where(known, variance, 0.0)), 0.0), 0.0)
    variance = np.where(known, variance, (level / multiple) ** 2)
    if line.frame is PoseFrame.CAMERA and frame != "camera":
        excess[3:], variance[3:] = excess[3:].max(), variance[3:].max()
    return ShotLevels(own.risk, own.uncovered, excess, variance)


def track_protection(
    pose: RingPose, shots: Sequence[ShotLevels], flags: PoseFlag, *, side_known_to: float
) -> Protection | None:
    """The levels of a track's pose from those of its last shots; None if these have none.

    `side_known_to`: the probability that the ring's centre is on the other side.
    """
    if not shots:
        return None
    risk, uncovered = max(each.risk for each in shots), max(each.uncovered for each in shots)
    multiple, variance = _gaussian_levels(pose, risk - uncovered)
    excess, of_shots = (np.array([each[place] for each in shots]) for place in (2, 3))
    weight = np.where(np.isfinite(excess), 1.0 / np.maximum(of_shots, 1e-30), 0.0)
    total = weight.sum(axis=0)
    mean = (weight * np.where(np.isfinite(excess), excess, 0.0)).sum(axis=0) / np.where(total > 0, total, 1.0)
    level = np.where((total > 0) & np.isfinite(variance), mean + multiple * np.sqrt(variance), inf)
    if level[2] >= MAX_ANGLE_RAD:
        level[2] = inf
    if side_known_to > risk:
        level[3:] = inf
    found = Protection(
        risk=risk,
        uncovered=uncovered,
        grasp_normal_m=float(level[0]),
        grasp_radial_m=float(level[1]),
        normal_rad=float(level[2]),
        center_m=level[3:],
    )
    return found.without(unbounded(flags))


def _gaussian_levels(pose: RingPose, allowed: float) -> tuple[Float64[Array, "level=6"], Float64[Array, "level=6"]]:
    """Levels of Gaussian errors in standard deviations, and the variances; NaN for those that are not known."""
    variance = np.full(LEVELS, np.nan)
    multiple = np.full(LEVELS, _alone(allowed))
    outward = pose.grasp_m - pose.center_m
    outward = outward - (outward @ pose.normal) * pose.normal
    length = float(np.linalg.norm(outward))
    if pose.covariance_grasp_m2 is not None and length > 0.0:
        across = np.array([pose.normal, outward / length])
        variance[:2] = (across @ pose.covariance_grasp_m2 @ across.T).diagonal()
    if pose.covariance is not None and bool(np.isfinite(pose.covariance[:2, :2]).all()):
        smaller, larger = np.linalg.eigvalsh(pose.covariance[:2, :2]).tolist()
        variance[2], multiple[2] = larger, _alone(allowed / in_plane(smaller / larger))
    if pose.covariance_center_m2 is not None:
        variance[3:] = pose.covariance_center_m2.diagonal()
    return multiple, variance


def _alone(allowed: float) -> float:
    """Level of one solution, in standard deviations: 2 Q(L) = `allowed`."""
    return -NORMAL.inv_cdf(0.5 * allowed) if allowed > 0.0 else inf
