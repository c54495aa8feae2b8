"""What the likelihood is made of: stripe lines, break points and ring edges in normalised undistorted coordinates.

Normalised coordinates are those of rays (x, y, 1). Stripes run roughly along x, as the detector reads them: a line is
measured by its ordinates, a break point by its abscissa.

What the points of a visible edge err alike, as errors that are unknowns beside the ring.

A point's place errs mostly by what lies beside the edge: the foil behind it, a wall, a shadow that runs towards it.
That goes on for a while, so a part of each error is that of the neighbours too, by exp(-distance / length). Such
errors are a sum of independent waves (the Karhunen-Loeve series of this covariance; ringpose-method(7), section 5).

How many independent measurements the points of a visible edge are.

Neighbours on an edge see the same shade, the same facet of the foil behind, the same speckle: what they err alike no
number of them averages (ringpose-method(7), section 5).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from math import sqrt
from typing import NamedTuple

import cv2
import numpy as np

from ringpose.geometry.rays import undistort
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.camera import Camera
from ringpose.types.detection import BreakPoints, RingEdgePoints
from ringpose.types.rig import LaserPlanes, Rig

NOMINAL_SIGMA_PX = 0.3
"""Of a break point that comes without a covariance: it weighs the points against each other and is told nobody."""

MIN_SIGMA_PX = 1e-4
"""Of anything measured: nobody knows an image better, and what is less drowns the rest in rounding."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Lines:
    """The stripes' lines on the ring's face, by their ordinates at the two ends."""

    laser: Int64[Array, "line"]
    x: Float64[Array, "line end=2"]
    y: Float64[Array, "line end=2"]
    whitening: Float64[Array, "line 2 end=2"]
    """W with W^T W the inverse covariance of the two ordinates."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Points:
    """Break points."""

    laser: Int64[Array, "point"]
    edge: Int64[Array, "point"]
    x: Float64[Array, "point"]
    y: Float64[Array, "point"]
    covariance: Float64[Array, "point xy=2 xy=2"]
    sigma_x: Float64[Array, "point"]
    middle_x: Float64[Array, "point"]
    """Of the stripe that it is an end of."""
    alone: Bool[Array, "point"]
    """Whether no line of its stripe is known: its ordinate then counts; else the line knows it better."""


class Observations(NamedTuple):
    """The lines' ends and the break points, with their light planes: what the predicted stripes are compared at."""

    rays: Float64[Array, "sight xyz=3"]
    """As measured."""
    light: Float64[Array, "sight 4"]
    """Normal and distance of the light planes."""
    whitening: Float64[Array, "end end"]
    """Of the lines' ordinates."""
    edge_sign_and_sigma: Float64[Array, "point 2"]
    """-1 for the inner edge, +1 for the outer, and the standard deviation of the abscissa."""

    @property
    def light_normal(self) -> Float64[Array, "sight xyz=3"]:
        """Of the light planes."""
        return self.light[:, :3]

    @property
    def light_distance_m(self) -> Float64[Array, "sight"]:
        """Of the light planes."""
        return self.light[:, 3]

    @property
    def edge_sign(self) -> Float64[Array, "point"]:
        """-1 for the inner edge, +1 for the outer."""
        return self.edge_sign_and_sigma[:, 0]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Edges:
    """Visible points of the ring's edges."""

    edge: Int64[Array, "visible"]
    ray: Float64[Array, "visible xyz=3"]
    step: Float64[Array, "visible xy=2"]
    """Displacement by one standard deviation, along the edge's normal in the image."""
    common: Float64[Array, "visible error"]
    """What unit errors that an edge's points have in common do, in the points' standard deviations."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measurements:
    """All that was measured in one shot."""

    lines: Lines
    points: Points
    edges: Edges
    sure: bool
    """Whether every break point came with its covariance."""

    def sighted(self, planes: LaserPlanes) -> Observations:
        """Ends and break points in one."""
        laser = np.concatenate([np.repeat(self.lines.laser, 2), self.points.laser])
        rays = np.ones((len(laser), 3))
        ends = 2 * len(self.lines.laser)
        rays[:ends, 0], rays[:ends, 1] = self.lines.x.ravel(), self.lines.y.ravel()
        rays[ends:, 0], rays[ends:, 1] = self.points.x, self.points.y
        whitening = np.zeros((ends, ends))
        for number, block in enumerate(self.lines.whitening):
            whitening[2 * number : 2 * number + 2, 2 * number : 2 * number + 2] = block
        light = np.empty((len(laser), 4))
        light[:, :3], light[:, 3] = planes.normal[laser], planes.distance_m[laser]
        signed = np.empty((len(self.points.edge), 2))
        signed[:, 0], signed[:, 1] = 2.0 * self.points.edge - 1.0, self.points.sigma_x
        return Observations(rays, light, whitening, signed)

    def with_points(self, keep: Bool[Array, "point"]) -> "Measurements":
        """With these break points only."""
        points = {each.name: getattr(self.points, each.name)[keep] for each in fields(Points)}
        return replace(self, points=Points(**points))

    def without_laser(self, laser: int) -> "Measurements":
        """Without a laser's line and break points."""
        keep = self.lines.laser != laser
        lines = {each.name: getattr(self.lines, each.name)[keep] for each in fields(Lines)}
        return replace(self.with_points(self.points.laser != laser), lines=Lines(**lines))

    def relabelled(self, laser_of: Mapping[int, int]) -> "Measurements":
        """With stripes given to other lasers."""
        lines = np.array([laser_of[laser] for laser in self.lines.laser.tolist()], dtype=np.int64)
        points = np.array([laser_of[laser] for laser in self.points.laser.tolist()], dtype=np.int64)
        return replace(self, lines=replace(self.lines, laser=lines), points=replace(self.points, laser=points))


def measurements_of(break_points: BreakPoints, rig: Rig, ring_edges: RingEdgePoints | None = None) -> Measurements:
    """The measurements of a detection."""
    lines = _lines(break_points, rig.camera)
    laser, edge = np.nonzero(break_points.seen)
    covariance_px2 = break_points.covariance_px2[laser, edge]
    sure = bool(np.isfinite(covariance_px2).all())
    if not sure:
        unknown = ~np.isfinite(covariance_px2).all(axis=(1, 2))
        covariance_px2[unknown] = NOMINAL_SIGMA_PX**2 * np.eye(2)
    xy = undistort(break_points.position_px[laser, edge], rig.camera)
    by_pixel = rays_by_pixel(xy, rig.camera)
    has_line = np.zeros(len(break_points.position_px), dtype=bool)
    has_line[lines.laser] = True
    covariance = by_pixel @ (covariance_px2 + MIN_SIGMA_PX**2 * np.eye(2)) @ by_pixel.swapaxes(1, 2)
    points = Points(
        laser=laser,
        edge=edge,
        x=xy[:, 0],
        y=xy[:, 1],
        covariance=covariance,
        sigma_x=np.sqrt(covariance[:, 0, 0]),
        middle_x=_middles(laser, xy[:, 0], lines),
        alone=~has_line[laser],
    )
    return Measurements(lines=lines, points=points, edges=_edges(ring_edges, rig.camera), sure=sure)


def line_whitening(start_sd: float, end_sd: float) -> tuple[float, float, float]:
    """Inverse Cholesky factor (11, 21, 22) of the joint covariance of a fitted line's ordinates at its two ends.

    An ordinate at the share t of the line's length has the variance s^2 (1 + 12 (t - a)^2), for centres spread
    evenly over the length; a, where the line is known best, follows from the two given ones (1/2 if they are
    equal), and the covariance of the two ends is s^2 (1 - 12 a (1 - a)). Ends of which one is known more than
    sqrt(13) times as well err together as those for which a lies at that end.
    """
    start, end = start_sd * start_sd, end_sd * end_sd
    bend, lean, level = 12.0 * (end - start), 24.0 * start, end - 13.0 * start
    # the root that stays finite as the sigmas become equal
    best = -2.0 * level / (lean + sqrt(max(lean * lean - 4.0 * bend * level, 0.0)))
    best = min(max(best, 0.0), 1.0)
    together = 1.0 - 12.0 * best * (1.0 - best)
    correlation = together / sqrt((1.0 + 12.0 * best * best) * (1.0 + 12.0 * (1.0 - best) ** 2))
    left = sqrt(1.0 - correlation * correlation)
    return 1.0 / start_sd, -correlation / (start_sd * left), 1.0 / (end_sd * left)


def rays_by_pixel(xy: Float64[Array, "n xy=2"], camera: Camera) -> Float64[Array, "n 2 2"]:
    """Derivatives of the normalised coordinates by the distorted pixel."""
    by_ray, _ = pixels_by_ray_and_camera(xy, camera)
    inverse: Float64[Array, "n 2 2"] = np.linalg.inv(by_ray)
    return inverse


def pixels_by_ray_and_camera(
    xy: Float64[Array, "n xy=2"], camera: Camera
) -> tuple[Float64[Array, "n 2 2"], Float64[Array, "n 2 parameter"]]:
    """Derivatives of the distorted pixel by the normalised coordinates, and by fx, fy, cx, cy, k1, k2, ..."""
    if not len(xy):
        return np.empty((0, 2, 2)), np.empty((0, 2, 4 + len(camera.distortion_coefficients)))
    rays = np.concatenate([xy, np.ones((len(xy), 1))], axis=1)
    zero = np.zeros(3)
    _, jacobian = cv2.projectPoints(rays, zero, zero, camera.camera_matrix, camera.distortion_coefficients)
    by = np.asarray(jacobian, dtype=np.float64).reshape(len(xy), 2, -1)
    return by[:, :, 3:5], by[:, :, 6:]  # after rotation 3: translation 3, of which two move the ray


def _middles(laser: Int64[Array, "point"], x: Float64[Array, "point"], lines: Lines) -> Float64[Array, "point"]:
    """Middle of each point's stripe: of its line, or of its own ends."""
    middle = {number: sum(ends) / 2 for number, ends in zip(lines.laser.tolist(), lines.x.tolist(), strict=True)}
    for number in set(laser.tolist()) - middle.keys():
        middle[number] = float(x[laser == number].mean())
    return np.array([middle[number] for number in laser.tolist()], dtype=np.float64)


def _lines(break_points: BreakPoints, camera: Camera) -> Lines:
    ends = np.stack([break_points.face_start_px, break_points.face_end_px], axis=1)
    laser = np.flatnonzero(np.isfinite(ends.sum(axis=(1, 2)) + break_points.face_sigma_px.sum(axis=1)))
    matrix = camera.camera_matrix
    sigma = np.maximum(break_points.face_sigma_px[laser], MIN_SIGMA_PX) / matrix[1, 1]
    whitening = np.zeros((len(laser), 2, 2))
    for block, sds in zip(whitening, sigma.tolist(), strict=True):
        block[0, 0], block[1, 0], block[1, 1] = line_whitening(*sds)
    return Lines(
        laser=laser,
        x=(ends[laser, :, 0] - matrix[0, 2]) / matrix[0, 0],
        y=(ends[laser, :, 1] - matrix[1, 2]) / matrix[1, 1],
        whitening=whitening,
    )


def _edges(ring_edges: RingEdgePoints | None, camera: Camera) -> Edges:
    if ring_edges is None or not len(ring_edges.edge):
        return Edges(
            edge=np.empty(0, dtype=np.int64), ray=np.empty((0, 3)), step=np.empty((0, 2)), common=np.empty((0, ERRORS))
        )
    xy = undistort(ring_edges.position_px, camera)
    sigma_px = np.maximum(ring_edges.sigma_px, MIN_SIGMA_PX)[:, None]
    step_px = ring_edges.normal * sigma_px
    return Edges(
        edge=ring_edges.edge,
        ray=np.concatenate([xy, np.ones((len(xy), 1))], axis=1),
        step=(rays_by_pixel(xy, camera) @ step_px[:, :, None])[:, :, 0],
        common=common_errors_px(ring_edges) / sigma_px,
    )


ROUNDED_PX = 0.05
"""What a whole edge errs alike: where the half brightness lies on a rounded corner."""

ALIKE_SHARE = 0.4
"""Of a point's standard deviation, what it shares with its neighbours; the most likely one for 60 edges of rendered
rings before foil, walls and shadows, of which an error in pixels that is alike for all edges explains far less."""

ALIKE_PX = 150.0
"""Length along the edge over which that persists, from the same edges (100 and 200 are nearly as likely)."""

WAVES = 8
"""Shorter ones weigh less than the points' own errors."""

ERRORS = 2 * (1 + WAVES)
"""Common errors of a shot: of each edge."""


def common_errors_px(edges: RingEdgePoints) -> Float64[Array, "visible error"]:
    """What each unit error does to the points of its edge, along their normals; 0 for those of the other edge."""
    errors = np.zeros((len(edges.edge), 2, 1 + WAVES))
    for edge in (0, 1):
        own = np.flatnonzero(edges.edge == edge)
        if len(own):
            errors[own, edge, 0] = ROUNDED_PX
            along_px = _along_px(edges.position_px[own], edges.normal[own])
            errors[own, edge, 1:] = ALIKE_SHARE * edges.sigma_px[own, None] * waves(along_px)
    return errors.reshape(len(errors), ERRORS)


def waves(along_px: Float64[Array, "n"]) -> Float64[Array, "n wave"]:
    """The longest waves of a series of variance one that is alike over `ALIKE_PX`, cosines and sines by turns."""
    first, last = float(along_px.min()), float(along_px.max())
    half_px = max(0.5 * (last - first), 1.0)
    phase = _phases(half_px / ALIKE_PX)
    sign = np.where(np.arange(WAVES) % 2, -1.0, 1.0)
    size = np.sqrt(2.0 * half_px / ALIKE_PX / ((half_px / ALIKE_PX) ** 2 + phase**2))
    size /= np.sqrt(1.0 + sign * np.sin(2.0 * phase) / (2.0 * phase))
    angle = ((along_px - 0.5 * (first + last)) / half_px)[:, None] * phase
    scaled: Float64[Array, "n wave"] = size * np.where(sign > 0, np.cos(angle), np.sin(angle))
    return scaled


def _phases(lengths: float) -> Float64[Array, "wave"]:
    """Phase of each wave at the end of an edge: the solution of p = k pi/2 + atan(lengths / p), by Newton's steps.

    Each starts on that side from which it does not overshoot.
    """
    quarter = 0.5 * np.pi * np.arange(WAVES)
    phase: Float64[Array, "wave"] = np.maximum(quarter, math.sqrt(lengths / (1.0 + lengths)))
    for _ in range(6):
        off = phase - quarter - np.arctan(lengths / phase)
        phase = phase - off / (1.0 + lengths / (phase**2 + lengths**2))
    return phase


def _along_px(position_px: Float64[Array, "n xy=2"], normal: Float64[Array, "n xy=2"]) -> Float64[Array, "n"]:
    across_x, across_y = normal.sum(axis=0)
    size = math.hypot(across_x, across_y) or 1.0
    along_px: Float64[Array, "n"] = (position_px[:, 1] * across_x - position_px[:, 0] * across_y) / size
    return along_px


SHORT_SERIES = 1.5
"""A circle fitted to a short series takes part of its likeness away: what is found is so much too small."""

MAX_SHARE_OF_LENGTH = 3
"""Likeness is looked for up to this part of an edge's points; fewer pairs say nothing."""


def inflate_sigma(edges: Edges, residual: Float64[Array, "visible"]) -> Edges:
    """Each edge's points with their standard deviations raised, so that together they weigh what they know.

    `residual` is what a fit of all leaves, in standard deviations.
    """
    factor = np.ones(len(residual))
    for edge in (0, 1):
        own = np.flatnonzero(edges.edge == edge)
        if len(own) > MAX_SHARE_OF_LENGTH:
            along = edges.ray[own, :2] - edges.ray[own, :2].mean(axis=0)
            direction = np.linalg.svd(along, full_matrices=False)[2][0]
            factor[own] = np.sqrt(excess(residual[own][np.argsort(along @ direction)]))
    return replace(edges, step=edges.step * factor[:, None], common=edges.common / factor[:, None])


def excess(series: Float64[Array, "n"]) -> float:
    """Variance of the mean of a series, in that of as many independent numbers of variance one; at least 1.

    The variance, and twice the autocovariance as far as it stays positive (Geyer's initial sequence).
    """
    inside = np.clip(series, -3.0, 3.0)
    variance = total = float(inside @ inside) / len(inside)
    for lag in range(1, len(inside) // MAX_SHARE_OF_LENGTH):
        likeness = float(inside[lag:] @ inside[:-lag]) / len(inside)
        if likeness <= 0:
            break
        total += 2.0 * likeness
    return max(1.0, SHORT_SERIES * total if total > variance else variance)
