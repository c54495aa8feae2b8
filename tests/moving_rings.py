"""Rings in known motion and the records of shots of them, without anything of the filters under test.

The true break points of each laser are those of the ring at the time of its frame (`ring_scenes.Ring`: quadratic
equations and OpenCV); the records come from the estimator of single shots.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import cv2
import numpy as np
from ring_scenes import RIGS, Ring, break_points_of, line_of_face, pixels_of, ring_at, Scene

from ringpose.pose.maximum_likelihood import most_likely_pose
from ringpose.types.pose import PoseLine, RingPose

START_S = 1_700_000_000.0
LASERS_FRAME = (1, 2, 3)
"""Number of each laser's frame in the sequence off, 1, 2, 3, off."""


@dataclass(frozen=True, kw_only=True)
class Motion:
    """Rigid motion: the centre of mass, `lever_m` behind the ring, has a velocity; the normal turns about `rate`."""

    ring: Ring
    velocity_m_s: np.ndarray
    rate_rad_s: np.ndarray
    lever_m: float = 0.0

    def at(self, time_s: float) -> Ring:
        normal = cv2.Rodrigues(self.rate_rad_s * time_s)[0] @ self.ring.normal
        mass = self.ring.center_m - self.lever_m * self.ring.normal + self.velocity_m_s * time_s
        return Ring(center_m=mass + self.lever_m * normal, normal=normal, radius_m=self.ring.radius_m)

    def velocity_at(self, time_s: float) -> np.ndarray:
        """Of the ring's centre."""
        return self.velocity_m_s + self.lever_m * np.cross(self.rate_rad_s, self.at(time_s).normal)

    def rates_at(self, time_s: float) -> np.ndarray:
        normal = self.at(time_s).normal
        return self.rate_rad_s - (self.rate_rad_s @ normal) * normal


@dataclass(frozen=True, kw_only=True)
class Shots:
    """How shots are taken and what their errors are."""

    rig: str = "B"
    frame_s: float = 1 / 30
    sigma_px: float = 0.3
    line_px: float = 0.02
    assumed_rig: object = None
    """The rig that the estimator uses, if not the true one."""
    true_rig: object = None


def detection(ring_at_s: Callable[[float], Ring], start_s: float, shots: Shots, rng) -> object:
    """Break points and lines of one switched shot that begins at `start_s` after the start."""
    rig = shots.true_rig or RIGS[shots.rig]
    times = [start_s + number * shots.frame_s for number in LASERS_FRAME]
    points_m = np.stack([ring_at_s(t).break_points_m(rig.lasers)[i] for i, t in enumerate(times)])
    scene = Scene(rig=rig, ring=ring_at_s(times[1]), points_m=points_m, position_px=pixels_of(points_m, rig.camera))
    points = scene.break_points(shots.sigma_px, rng)
    lines = np.array([line_of_face(scene, laser) for laser in range(3)])
    middle, slope = shots.line_px * rng.normal(size=(2, 3, 1))
    lines[:, :, 1] += middle + np.sqrt(3.0) * slope * [-1.0, 1.0]
    sigma = np.full((3, 2), 2.0 * shots.line_px)
    stamp_s = START_S + np.array(times)
    return replace(points, face_start_px=lines[:, 0], face_end_px=lines[:, 1], face_sigma_px=sigma, stamp_s=stamp_s)


def record(ring_at_s, start_s: float, shots: Shots, rng, known=None, name=None) -> PoseLine:
    """The pose record of one shot."""
    rig = shots.assumed_rig or RIGS[shots.rig]
    points = detection(ring_at_s, start_s, shots, rng)
    result = most_likely_pose(points, rig, known=known)
    return PoseLine(
        shot=name or f"{start_s:.4f}",
        stamp_s=float(points.stamp_s[0]),
        pose_stamp_s=result.stamp_s,
        pose=result.pose if isinstance(result.pose, RingPose) else None,
        flags=result.flags,
        measurement=result.measurement,
        priors=result.priors,
        rig=rig.sha256,
    )


def drawn_motion(rng, distance_m=0.5, speed_m_s=0.02, rate_deg_s=1.0, lever_m=0.0, rig="B", size="R597", **ring) -> Motion:
    """Constant velocity and rates about a pose at the given distance; drawn per axis."""
    first = ring_at(RIGS[rig], distance_m=distance_m, tilt_rad=tuple(0.1 * rng.normal(size=2)), size=size, **ring)
    rate = np.deg2rad(rate_deg_s) * rng.normal(size=3)
    rate -= (rate @ first.normal) * first.normal
    return Motion(ring=first, velocity_m_s=speed_m_s * rng.normal(size=3), rate_rad_s=rate, lever_m=lever_m)
