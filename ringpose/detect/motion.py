"""Motion of the ring within a shot, measured in ambient light (ringpose-method(7), section 8).

The frames of a switched shot show a moving ring at different places. Two frames that both show its edges reveal by how
far they moved between them. This measurement is only good enough to predict where the edges are in each frame, and
whether a frame without lasers still shows the background of another; the pose takes the motion from the features.
"""

import math
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import cv2
import numpy as np

from ringpose.geometry.least_squares import huber_weights
from ringpose.geometry.rays import POINTS_OF_A_PLANE, project, rays, undistorted_pixels, undistorted_rays
from ringpose.geometry.sheets import sheet_points
from ringpose.optics.feature_errors import MIN_PEAK, MINIMUM_POINTS
from ringpose.types.arrays import Array, Bool, Float64, UInt
from ringpose.types.assumptions import MotionPrior
from ringpose.types.detection import BreakPoints
from ringpose.types.image import Shot
from ringpose.types.rig import Rig

WINDOW_PX, LEVELS = 21, 2
"""Window and pyramid levels of the optical flow, in images of half size: displacements up to 60 px are found. Places
whose windows contain the row of a stripe's end are left out in frames with lasers on."""

MARGIN_PX = WINDOW_PX << LEVELS
"""Margin of the compared parts of both images about the edges: half of the window on the highest level."""

ACROSS_PX = np.arange(-12.0, 13.0, 4.0)
"""Distances across the edge at which that range is taken."""

SIGMA_PX = 3.0
"""Standard deviation of a single displacement: neighbouring places share their windows and what lies behind. Smaller
ones are no motion where one of the frames has lasers on, since their light spreads over it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingMotion:
    """Rigid motion of the ring at constant rates, and the speed of its edges in the image."""

    pivot_m: Float64[Array, "xyz=3"]
    """Point of the ring whose velocity is given."""
    velocity_m_s: Float64[Array, "xyz=3"]
    rate_rad_s: Float64[Array, "xyz=3"]
    edge_speed_px_s: float
    """Largest speed of the edges in the image, along their normals."""

    def points_after(self, points: Float64[Array, "*shape xyz=3"], duration_s: float) -> Float64[Array, "*shape xyz=3"]:
        """Positions of points of the ring after this time."""
        rotation = cv2.Rodrigues(self.rate_rad_s * duration_s)[0]
        moved: Float64[Array, "*shape xyz=3"] = (
            (points - self.pivot_m) @ rotation.T + self.pivot_m + self.velocity_m_s * duration_s
        )
        return moved


def ring_motion(points: BreakPoints, shot: Shot, rig: Rig, prior: MotionPrior) -> RingMotion | None:
    """The motion of a ring with these break points; None if no two frames show its edges at different times.

    The first frame without lasers, which the shot must have, is compared with the last one. The prior regularizes the
    motion across what the edges show.
    """
    dark = np.flatnonzero(shot.lasers == 0)
    first, last = int(dark[0]), int(dark[-1]) if len(dark) > 1 else len(shot.lasers) - 1
    duration_s = shot.mid_exposure_s(last) - shot.mid_exposure_s(first)
    if not duration_s > 0:
        return None
    position, normal = _edge_places(points, bool(shot.lasers[last]))
    if len(position) < MINIMUM_POINTS:
        return None
    corner = np.maximum(position.min(axis=0).astype(np.int64) - MARGIN_PX, 0)
    right, bottom = position.max(axis=0).astype(np.int64) + MARGIN_PX
    before, after = (shot.images[number, corner[1] : bottom, corner[0] : right] for number in (first, last))
    visible = _contrast(before, position - corner, normal) >= MIN_PEAK * shot.saturation_dn
    if np.count_nonzero(visible) < MINIMUM_POINTS:
        return None
    position, normal = position[visible], normal[visible]
    shift_px, tracked = _shift_across(before, after, position - corner, normal)
    if np.count_nonzero(tracked) < MINIMUM_POINTS:
        return None
    motion = _fitted(
        position[tracked], normal[tracked], shift_px[tracked] / duration_s, SIGMA_PX / duration_s, points, rig, prior
    )
    if motion is None:
        return None
    at_rest = shot.lasers[last] and motion.edge_speed_px_s * duration_s < SIGMA_PX
    return None if at_rest else motion


def _edge_places(points: BreakPoints, beside_stripes: bool) -> tuple[Float64[Array, "n 2"], Float64[Array, "n 2"]]:
    """Places on the chords between neighbouring break points of an edge, and the chords' unit normals."""
    positions, normals = [np.empty((0, 2))], [np.empty((0, 2))]
    for edge in (0, 1):
        ends = points.position_px[points.seen[:, edge], edge]
        ends = ends[np.argsort(ends[:, 1])]
        for start, stop in pairwise(ends):
            length = float(np.hypot(*(stop - start)))
            along = np.arange(0.0, length, WINDOW_PX / 2)
            if beside_stripes:
                along = along[(along > WINDOW_PX) & (along < length - WINDOW_PX)]
            direction = (stop - start) / length
            positions.append(start + along[:, None] * direction)
            normals.append(np.tile([direction[1], -direction[0]], (len(along), 1)))
    return np.concatenate(positions), np.concatenate(normals)


def _contrast(
    image: UInt[Array, "row column"], position: Float64[Array, "n 2"], normal: Float64[Array, "n 2"]
) -> Float64[Array, "n"]:
    """Range of the smoothed grey values across each place."""
    at = (position[:, None] + ACROSS_PX[:, None] * normal[:, None]).astype(np.float32)
    half = cv2.pyrDown(image)
    values = cv2.remap(half, at[..., 0] / 2, at[..., 1] / 2, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    contrast: Float64[Array, "n"] = np.ptp(values.astype(np.float64), axis=1)
    return contrast


def _shift_across(
    before: UInt[Array, "row column"],
    after: UInt[Array, "row column"],
    position: Float64[Array, "n 2"],
    normal: Float64[Array, "n 2"],
) -> tuple[Float64[Array, "n"], Bool[Array, "n"]]:
    """Displacement of each place along its normal (Lucas and Kanade's method), and which were tracked.

    The displacement along the edge is not visible, and not needed.
    """
    start = (position / 2).astype(np.float32)
    to_bytes = 1.0 if before.dtype == np.uint8 else 255.0 / max(int(before.max()), 255)
    halves = [cv2.convertScaleAbs(cv2.pyrDown(each), alpha=to_bytes) for each in (before, after)]
    flow: Any = cv2.calcOpticalFlowPyrLK  # OpenCV's stubs do not allow None for points without a guess
    moved, tracked, _ = flow(
        halves[0], halves[1], start, None, winSize=(WINDOW_PX, WINDOW_PX), maxLevel=LEVELS, minEigThreshold=1e-5
    )
    shift: Float64[Array, "n"] = ((2.0 * (moved.astype(np.float64) - start)) * normal).sum(axis=1)
    return shift, tracked.ravel() > 0


def _fitted(
    position: Float64[Array, "n 2"],
    normal: Float64[Array, "n 2"],
    speed_px_s: Float64[Array, "n"],
    sigma_px_s: float,
    points: BreakPoints,
    rig: Rig,
    prior: MotionPrior,
) -> RingMotion | None:
    """Rates fitted to the speeds of the edges along their normals: robust least squares, regularized to zero."""
    laser, edge = np.nonzero(points.seen)
    ends_px = points.position_px[laser, edge]
    ends_m = sheet_points(rays(ends_px, rig.camera), laser, rig)
    pivot = ends_m.mean(axis=0)
    if len(ends_m) < POINTS_OF_A_PLANE or not (np.isfinite(ends_m).all() and pivot[2] > 0):
        return None
    # inverse depth of a plane is linear in the image
    design = np.column_stack([ends_px, np.ones(len(ends_px))])
    coefficients = np.linalg.lstsq(design, 1.0 / ends_m[:, 2])[0]
    place_m = rays(position, rig.camera) / (np.column_stack([position, np.ones(len(position))]) @ coefficients)[:, None]
    if not (place_m[:, 2] > 0).all():
        return None
    x, y, z = place_m.T
    focal = np.array([rig.camera.camera_matrix[0, 0], rig.camera.camera_matrix[1, 1]]) * normal
    by_point = np.column_stack([focal[:, 0] / z, focal[:, 1] / z, -(focal[:, 0] * x + focal[:, 1] * y) / z**2])
    sd = np.repeat([prior.speed_sd_m_s, prior.rate_sd_rad_s], 3)  # the rates are estimated in these units
    jacobian = np.concatenate([by_point, np.cross(place_m - pivot, by_point)], axis=1) * sd / sigma_px_s
    speed = speed_px_s / sigma_px_s
    weight, rates = np.ones(len(speed)), np.zeros(6)
    for _ in range(5):
        rows = np.sqrt(weight)[:, None]
        rates = np.linalg.lstsq(
            np.concatenate([rows * jacobian, np.eye(6)]), np.concatenate([rows[:, 0] * speed, np.zeros(6)])
        )[0]
        weight = huber_weights(speed - jacobian @ rates, 1.5)
    shown_px_s, rates = np.abs(jacobian @ rates) * sigma_px_s, sd * rates
    return RingMotion(
        pivot_m=pivot, velocity_m_s=rates[:3], rate_rad_s=rates[3:], edge_speed_px_s=float(shown_px_s.max())
    )


def moved_to(stamp_s: float, points: BreakPoints, rig: Rig, motion: RingMotion) -> tuple[BreakPoints, Rig]:
    """Break points and light planes as if the lasers had been on at that time.

    A point that a laser shows at its own time is moved with the ring, and the light plane with it: in the ring's frame
    every stripe stays where it was.
    """
    planes, camera = rig.lasers, rig.camera
    lines_px = np.stack([points.face_start_undistorted_px, points.face_end_undistorted_px], axis=1)
    ends_m, lines_m = (
        sheet_points(each, np.arange(len(planes.normal))[:, None], rig)
        for each in (rays(points.position_px, camera), undistorted_rays(lines_px, camera))
    )
    normal, foot_m = planes.normal.copy(), planes.normal * planes.distance_m[:, None]
    stamps = [np.nan] * len(normal) if points.stamp_s is None else points.stamp_s.tolist()
    for laser, seen_at_s in enumerate(stamps):
        if math.isfinite(seen_at_s):
            duration_s = stamp_s - seen_at_s
            for each in (ends_m, lines_m, foot_m):
                each[laser] = motion.points_after(each[laser], duration_s)
            normal[laser] = cv2.Rodrigues(motion.rate_rad_s * duration_s)[0] @ normal[laser]
    moved = replace(planes, normal=normal, distance_m=(normal * foot_m).sum(axis=1))
    lines_px = undistorted_pixels(project(lines_m, camera), camera)
    moved_points = replace(
        points,
        position_px=project(ends_m, camera),
        face_start_undistorted_px=lines_px[:, 0],
        face_end_undistorted_px=lines_px[:, 1],
    )
    return moved_points, replace(rig, lasers=moved)
