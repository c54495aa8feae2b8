"""Tracks of rings in known motion, and their errors."""

from collections.abc import Iterable

import numpy as np
from moving_rings import START_S

from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.rotations import tilt_basis
from ringpose.track.explanations import TrackOptions
from ringpose.track.pipeline import Tracker
from ringpose.types.pose import PoseLine
from ringpose.types.track import TrackLine

DEGREES_OF_FREEDOM = {"centre": 3, "normal": 2, "grasp": 2, "velocity": 3}


def track_of(
    lines: Iterable[PoseLine], options: TrackOptions | None = None, camera: CameraMotion | None = None
) -> Tracker:
    """The track of all records."""
    tracker = Tracker(None, options, camera=camera)
    for line in lines:
        tracker.add(line)
    return tracker


def newest(tracker: Tracker, ahead_s: float = 0.0) -> TrackLine:
    """The record of the track at its last measurement, or predicted from it."""
    return tracker.line_at(tracker.track.stamp_s + ahead_s)


def errors_at(motion, line: TrackLine) -> dict[str, tuple[np.ndarray, np.ndarray]]:
    """Errors of a record and their covariances; of the grasp point radially and along the normal."""
    time_s = line.stamp_s - START_S
    ring, basis = motion.at(time_s), tilt_basis(line.pose.normal)
    away = line.grasp.point_m - ring.center_m
    axial = float(away @ ring.normal)
    radial = away - axial * ring.normal
    across = np.stack([radial / np.linalg.norm(radial), ring.normal])
    grasp = np.array([np.linalg.norm(radial) - ring.radius_m.mean(), axial])
    return {
        "centre": (line.pose.center_m - ring.center_m, line.pose.covariance_center_m2),
        "normal": (basis @ (ring.normal - line.pose.normal), line.pose.covariance[:2, :2]),
        "grasp": (grasp, across @ line.grasp.covariance[:3, :3] @ across.T),
        "velocity": (line.velocity.center_m_s - motion.velocity_at(time_s), line.velocity.covariance[:3, :3]),
    }


def nees_at(motion, line: TrackLine) -> dict[str, float]:
    """Normalised squared errors of a record, by degree of freedom; none of a record without a centre."""
    if line.pose is None or not np.isfinite(line.pose.center_m).all():
        return {}
    found = errors_at(motion, line).items()
    return {name: float(error @ np.linalg.solve(matrix, error)) / len(error) for name, (error, matrix) in found}
