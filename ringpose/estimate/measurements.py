"""Measurements of one shot in normalised undistorted coordinates: lines, break points, ring edges.

Normalised coordinates are those of rays (x, y, 1). Stripes run roughly along x: a line is measured by its ordinates, a
break point by its abscissa.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from math import sqrt
from typing import NamedTuple, TypeVar

import numpy as np

from ringpose.estimate.factors import EdgeFactor, Factor, Index, LineFactor, PointFactor
from ringpose.estimate.linearization import Observations
from ringpose.estimate.nuisance import (
    ERRORS,
    MAX_SHARE_OF_LENGTH,
    common_errors_px,
    integrated_autocorrelation_time,
)
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.rays import rays_wrt_pixel_and_camera, undistort, undistorted_rays
from ringpose.geometry.ring import RingSamples
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.detection import BreakPointFlag, BreakPoints, RingEdgePoints
from ringpose.types.pose import NoPose
from ringpose.types.rig import Camera, Rig

NOMINAL_SIGMA_PX = 0.3
"""Sigma of a break point without a covariance; it only weights points against each other and is not reported."""

MIN_SIGMA_PX = 1e-4
"""Lower bound of all standard deviations: smaller ones would make the normal equations ill-conditioned."""

Parts = TypeVar("Parts", "Lines", "Points")


class Lines(NamedTuple):
    """Lines of the stripes on the ring's face, given by the ordinates at their two ends."""

    laser: Int64[Array, "line"]
    x: Float64[Array, "line end=2"]
    y: Float64[Array, "line end=2"]
    whitening: Float64[Array, "line 2 end=2"]
    """W with W^T W the inverse covariance of the two ordinates."""
    wrt_camera: Float64[Array, "line end=2 xy=2 parameter"]
    """Derivatives of x and y for fixed pixels by the camera's parameters, as in `CAMERA_PARAMETERS`."""
    stamp_s: Float64[Array, "line"]
    """Mid exposure of the stripe's frame; NaN if unknown."""
    opposite: Bool[Array, "line"]
    """Whether the piece lies on the opposite arc."""

    @property
    def pieces(self) -> Int64[Array, "line"]:
        """A number for each piece of a stripe on an arc, the same where it was measured again."""
        numbers: Int64[Array, "line"] = 2 * self.laser + self.opposite
        return numbers

    @property
    def numbers(self) -> int:
        """Number of measured values; the line of a piece that was measured twice counts once."""
        return 2 * len(set(self.pieces.tolist()))

    def factor(self) -> LineFactor:
        """Their factor; the rays of their ends come first."""
        whitening = np.zeros((2 * len(self.laser), 2 * len(self.laser)))
        for number, block in enumerate(self.whitening):
            whitening[2 * number : 2 * number + 2, 2 * number : 2 * number + 2] = block
        return LineFactor(
            stamp_s=np.repeat(self.stamp_s, 2),
            opposite=np.repeat(self.opposite, 2),
            ray=slice(0, len(whitening)),
            whitening=whitening,
            y=self.y.ravel(),
        )


class Points(NamedTuple):
    """Break points."""

    laser: Int64[Array, "point"]
    edge: Int64[Array, "point"]
    x: Float64[Array, "point"]
    y: Float64[Array, "point"]
    covariance: Float64[Array, "point xy=2 xy=2"]
    sigma_x: Float64[Array, "point"]
    middle_x: Float64[Array, "point"]
    """Abscissa of the middle of the point's stripe."""
    isolated: Bool[Array, "point"]
    """Whether its stripe has no line, so that the ordinate of the point is used too."""
    stamp_s: Float64[Array, "point"]
    """Mid exposure of the stripe's frame; NaN if unknown."""
    beside_occluder: Bool[Array, "point"]
    """Whether the image shows a surface in front of the ring beside the point."""
    wrt_camera: Float64[Array, "point xy=2 parameter"]
    """Derivatives of x and y for fixed pixels by the camera's parameters, as in `CAMERA_PARAMETERS`."""
    opposite: Bool[Array, "point"]
    """Whether the point lies on the arc opposite to that at which the ring is described."""

    @property
    def ends(self) -> Int64[Array, "point"]:
        """A number for each end of a stripe, the same where it was measured again."""
        numbers: Int64[Array, "point"] = 4 * self.laser + 2 * self.opposite + self.edge
        return numbers

    @property
    def numbers(self) -> int:
        """Number of measured values; an end that was measured twice counts once."""
        return len(set(self.ends.tolist())) + len(set(self.ends[self.isolated].tolist()))

    @property
    def described(self) -> Bool[Array, "point"]:
        """Whether the point is on the arc at which the ring is described: the opposite one if nothing else is seen."""
        return np.ones_like(self.opposite) if self.opposite.all() else ~self.opposite

    def factor(self, ends: int) -> PointFactor:
        """Their factor; their rays come after so many of ends of lines."""
        isolated, count = np.flatnonzero(self.isolated), len(self.x)
        row: Index = slice(0, count)
        ray: Index = slice(ends, ends + count)
        if len(isolated):
            row = np.concatenate([np.arange(count), isolated])
            ray = ends + row
        return PointFactor(
            stamp_s=self.stamp_s[row],
            opposite=self.opposite[row],
            ray=ray,
            beside=row,
            edge=self.edge[row],
            sigma_x=self.sigma_x,
            y=self.y,
            covariance=self.covariance,
            isolated=isolated,
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Edges:
    """Visible points of the ring's edges."""

    edge: Int64[Array, "visible"]
    ray: Float64[Array, "visible xyz=3"]
    step: Float64[Array, "visible xy=2"]
    """Displacement by one standard deviation, along the edge's normal in the image."""
    wrt_camera: Float64[Array, "visible xy=2 parameter"]
    """Derivatives of x and y of the rays for fixed pixels by the camera's parameters, as in `CAMERA_PARAMETERS`."""
    common: Float64[Array, "visible error"]
    """Derivatives with respect to the common errors (unit variance), in the points' standard deviations."""
    stamp_s: Float64[Array, "visible"]
    """Mid exposure of the frame in which they were measured; NaN if unknown."""
    walls: bool = True
    """Whether the edges may be the feet of the ring's walls."""

    def with_sigmas_raised(self, factor: Float64[Array, "visible"]) -> "Edges":
        """The points with standard deviations that are higher by a factor."""
        return replace(self, step=self.step * factor[:, None], common=self.common / factor[:, None])

    def factor(self, ends: int, points: int) -> EdgeFactor:
        """Their factor; their rays come after so many of ends of lines and of break points."""
        visible = len(self.edge)
        return EdgeFactor(
            stamp_s=self.stamp_s,
            opposite=np.zeros(visible, dtype=bool),
            ray=slice(ends + points, ends + points + visible),
            beside=slice(points, points + visible),
            edge=self.edge,
            step=self.step,
            common=self.common,
            walls=self.walls,
        )


@dataclass(frozen=True, kw_only=True, eq=False)
class Measurements:
    """All that was measured in one shot, and the rig that measured it."""

    rig: Rig
    lines: Lines
    points: Points
    edges: Edges
    has_covariances: bool
    """Whether every break point has a covariance; otherwise the pose is reported without."""
    reference_s: float = math.nan
    """The instant at which the ring is estimated, t_0; NaN if the stamps are unknown."""
    moving: bool = False
    """Whether the shot, of which these may be a part, has times from which a motion can be estimated."""
    camera: CameraMotion | None = None
    """Motion of the camera by the poses of a robot that carries it; None if the camera counts as inertial."""
    others: tuple[Factor, ...] = ()
    """Measurements of other kinds."""

    @cached_property
    def observations(self) -> Observations:
        """The factors of the shot, and the view of the ring by ends of lines, break points and visible edge points."""
        lines, points, edges, planes = self.lines, self.points, self.edges, self.rig.lasers
        laser = np.concatenate([np.repeat(lines.laser, 2), points.laser])
        ends, samples = 2 * len(lines.laser), len(laser)
        rays = np.ones((samples, 3))
        rays[:ends, 0], rays[:ends, 1] = lines.x.ravel(), lines.y.ravel()
        rays[ends:, 0], rays[ends:, 1] = points.x, points.y
        stamp_s = np.concatenate([np.repeat(lines.stamp_s, 2), points.stamp_s, edges.stamp_s])
        instant_s, instant = np.unique(self.times_s(stamp_s), return_inverse=True)
        view = RingSamples(
            rays=rays,
            light_normal=planes.normal[laser],
            light_distance_m=planes.distance_m[laser],
            ends=ends,
            visible_rays=edges.ray,
            visible_step=edges.step,
            edge_sign=2.0 * np.concatenate([points.edge, edges.edge]) - 1.0,
            instant_s=instant_s,
            instant=instant,
            camera=None if self.camera is None else self.camera.displacements(self.reference_s, instant_s),
        )
        of_lines, of_points = lines.factor(), points.factor(ends)
        factors: list[Factor] = [of_lines, of_points, *self.others, edges.factor(ends, len(points.x))]
        blocks, count = [], 0
        for factor in factors:
            if rows := len(factor.stamp_s):
                blocks.append((factor, slice(count, count + rows)))
                count += rows
        robust, many = np.zeros(count, dtype=bool), np.zeros(count, dtype=bool)
        for factor, block in blocks:
            robust[block], many[block] = factor.robust, factor.many
        of_rays = lines.wrt_camera.reshape(ends, *lines.wrt_camera.shape[2:]), points.wrt_camera, edges.wrt_camera
        return Observations(
            blocks=tuple(blocks),
            view=view,
            rig=self.rig,
            moving=self.moving,
            laser=laser,
            whitening=of_lines.whitening,
            points=of_points,
            described=ends + np.flatnonzero(points.described),
            wrt_camera=np.concatenate(of_rays),
            camera=self.camera,
            robust=robust,
            many=many,
            numbers=self.stripe_numbers + sum(len(each.stamp_s) for each in self.others if not each.many),
        )

    @cached_property
    def unusable(self) -> NoPose | None:
        """The reason why no ring can be estimated from these measurements; None if it can."""
        if not len(self.points.x):
            return NoPose.TOO_FEW_BREAK_POINTS
        if not bool(np.isfinite(self.points.x + self.points.y).all()):
            return NoPose.UNTRIANGULATED
        if self.camera is not None and self.observations.view.camera is None:
            return NoPose.NO_ROBOT_POSES
        return None

    def times_s(self, stamp_s: Float64[Array, "n"]) -> Float64[Array, "n"]:
        """Times from the reference time; 0 where a stamp is unknown."""
        time_s = stamp_s - self.reference_s
        return np.where(np.isfinite(time_s), time_s, 0.0)

    @cached_property
    def stamp_s(self) -> Float64[Array, "row"]:
        """Mid exposure of the frame that each row of the factors comes from; NaN if unknown."""
        return np.concatenate([factor.stamp_s for factor, _ in self.observations.blocks])

    @cached_property
    def of_first_arc(self) -> Bool[Array, "row"]:
        """Whether each row of the factors is not of the opposite arc."""
        return ~np.concatenate([factor.opposite for factor, _ in self.observations.blocks])

    @property
    def stripe_numbers(self) -> int:
        """Number of measured values of stripes and break points; a value that was measured twice counts once."""
        return self.lines.numbers + self.points.numbers

    @cached_property
    def stripes(self) -> list[int]:
        """The lasers with a line, in ascending order."""
        return sorted(set(self.lines.laser.tolist()))

    def once(self) -> "Measurements":
        """The measurements with each stripe and break point once; repeated measurements in later frames are dropped."""
        first = np.unique(self.points.ends, return_index=True)[1]
        return self._selected(np.unique(self.lines.pieces, return_index=True)[1], first)

    def of_one_arc(self) -> "Measurements":
        """The measurements without those on the opposite arc."""
        if not (self.points.opposite.any() or self.lines.opposite.any()):
            return self
        return self._selected(~self.lines.opposite, ~self.points.opposite)

    def _selected(self, lines: Array, points: Array) -> "Measurements":
        """The measurements with these lines and break points only, given by indices or by which to keep."""
        return replace(
            self,
            lines=Lines(*(values[lines] for values in self.lines)),
            points=Points(*(values[points] for values in self.points)),
        )

    def with_points(self, keep: Bool[Array, "point"]) -> "Measurements":
        """The measurements with these break points only."""
        return self._selected(np.arange(len(self.lines.laser)), keep)

    def without_laser(self, laser: int) -> "Measurements":
        """The measurements without a laser's line and break points."""
        return self._selected(self.lines.laser != laser, self.points.laser != laser)

    def without_edges(self) -> "Measurements":
        """The measurements without visible edges."""
        return replace(self, edges=no_edges(self.rig.camera))

    def with_edges_exchanged(self) -> "Measurements":
        """The measurements with inner edges taken for outer ones and the reverse."""
        points, edges = self.points, self.edges
        edges = replace(edges, edge=1 - edges.edge)
        return replace(self, points=points._replace(edge=1 - points.edge), edges=edges)

    @cached_property
    def lasers(self) -> list[int]:
        """The lasers with a line or a break point, in ascending order."""
        return sorted({*self.points.laser.tolist(), *self.lines.laser.tolist()})

    def relabelled(self, laser_of: Mapping[int, int]) -> "Measurements":
        """The measurements with stripes assigned to other lasers."""
        lines = np.array([laser_of[laser] for laser in self.lines.laser.tolist()], dtype=np.int64)
        points = np.array([laser_of[laser] for laser in self.points.laser.tolist()], dtype=np.int64)
        return replace(self, lines=self.lines._replace(laser=lines), points=self.points._replace(laser=points))


def measurements_of(
    break_points: BreakPoints,
    rig: Rig,
    ring_edges: RingEdgePoints | None = None,
    camera: CameraMotion | None = None,
) -> Measurements:
    """The measurements of a detection; NaN where a point cannot be undistorted."""
    lines = _lines(break_points, rig.camera)
    points, has_covariances = _points(break_points, lines, rig.camera)
    if break_points.repeated is not None:
        lines_again = _lines(break_points.repeated, rig.camera)
        points_again, have_covariances = _points(break_points.repeated, lines_again, rig.camera)
        lines, points = _repeated_lines(lines, lines_again), _repeated_points(points, points_again)
        has_covariances = has_covariances and have_covariances
    if break_points.opposite is not None:
        lines_beyond = _lines(break_points.opposite, rig.camera, opposite=True)
        every_line = joined(lines, lines_beyond)
        points_beyond, have_covariances = _points(break_points.opposite, every_line, rig.camera, opposite=True)
        lines, points = every_line, joined(points, points_beyond)
        has_covariances = has_covariances and have_covariances
    stamps, edges = np.concatenate([lines.stamp_s, points.stamp_s]), edges_of(ring_edges, rig.camera)
    reference_s = float(stamps.mean()) if len(stamps) else math.nan
    every = np.concatenate([stamps, edges.stamp_s])
    return Measurements(
        rig=rig,
        lines=lines,
        points=points,
        edges=edges,
        has_covariances=has_covariances,
        reference_s=reference_s,
        moving=math.isfinite(reference_s) and bool(np.nanmin(every) < np.nanmax(every)),
        camera=camera,
    )


def _lines(break_points: BreakPoints, camera: Camera, *, opposite: bool = False) -> Lines:
    """The lines of the stripes on the face that are known."""
    stamp_s = _stamps(break_points)
    line_px = np.stack([break_points.face_start_undistorted_px, break_points.face_end_undistorted_px], axis=1)
    has_line = np.isfinite(line_px.sum(axis=(1, 2)) + break_points.face_sigma_px.sum(axis=1))
    line_xy = undistorted_rays(line_px[has_line], camera)[..., :2]
    _, wrt_camera = rays_wrt_pixel_and_camera(line_xy.reshape(-1, 2), camera)
    sigma = np.maximum(break_points.face_sigma_px[has_line], MIN_SIGMA_PX) / camera.camera_matrix[1, 1]
    whitening = np.zeros((len(line_xy), 2, 2))
    for block, sds in zip(whitening, sigma.tolist(), strict=True):
        block[0, 0], block[1, 0], block[1, 1] = line_whitening(*sds)
    return Lines(
        laser=np.flatnonzero(has_line),
        x=line_xy[..., 0],
        y=line_xy[..., 1],
        whitening=whitening,
        wrt_camera=wrt_camera.reshape(*line_xy.shape, wrt_camera.shape[-1]),
        stamp_s=stamp_s[has_line],
        opposite=np.full(len(line_xy), opposite),
    )


def _points(break_points: BreakPoints, lines: Lines, camera: Camera, *, opposite: bool = False) -> tuple[Points, bool]:
    """The break points that were seen, and whether all of these have a covariance."""
    laser, edge = np.nonzero(~np.isnan(break_points.position_px[..., 0]))
    xy = undistort(break_points.position_px[laser, edge], camera)
    wrt_pixel, wrt_camera = rays_wrt_pixel_and_camera(xy, camera)
    covariance_px2 = break_points.covariance_px2[laser, edge]
    has_covariance = np.isfinite(covariance_px2).all(axis=(1, 2))
    covariance_px2[~has_covariance] = NOMINAL_SIGMA_PX**2 * np.eye(2)
    covariance_px2 = covariance_px2 + MIN_SIGMA_PX**2 * np.eye(2)
    covariance = wrt_pixel @ covariance_px2 @ wrt_pixel.swapaxes(1, 2)
    points = Points(
        laser=laser,
        edge=edge,
        x=xy[:, 0],
        y=xy[:, 1],
        covariance=covariance,
        sigma_x=np.sqrt(covariance[:, 0, 0]),
        middle_x=_middles(laser, xy[:, 0], lines),
        isolated=~np.isin(laser, lines.laser),
        stamp_s=_stamps(break_points)[laser],
        beside_occluder=break_points.flags[laser, edge] & int(BreakPointFlag.BESIDE_OCCLUDER) != 0,
        wrt_camera=wrt_camera,
        opposite=np.full(len(laser), opposite),
    )
    return points, bool(has_covariance.all())


def _stamps(break_points: BreakPoints) -> Float64[Array, "laser"]:
    """Mid exposure of the frame of each laser; NaN where it is unknown."""
    return np.full(len(break_points.flags), np.nan) if break_points.stamp_s is None else break_points.stamp_s


REPEATED = 2.0
"""Factor on the variances of what was measured twice: the same speckle and the same edge of the face make both errors
similar, so that two measurements determine the ring no better than one. Only their difference is information."""


def _repeated_lines(first: Lines, again: Lines) -> Lines:
    every = joined(first, again)
    twice = np.isin(every.laser, first.laser) & np.isin(every.laser, again.laser)
    return every._replace(whitening=every.whitening / np.sqrt(np.where(twice, REPEATED, 1.0))[:, None, None])


def _repeated_points(first: Points, again: Points) -> Points:
    every = joined(first, again)
    variances = np.where(np.isin(every.ends, first.ends) & np.isin(every.ends, again.ends), REPEATED, 1.0)
    return every._replace(
        covariance=every.covariance * variances[:, None, None], sigma_x=every.sigma_x * np.sqrt(variances)
    )


def joined(first: Parts, second: Parts) -> Parts:
    """The lines, or the break points, of both."""
    return type(first)._make(map(np.concatenate, zip(first, second, strict=True)))


def line_whitening(start_sd: float, end_sd: float) -> tuple[float, float, float]:
    """Inverse Cholesky factor (11, 21, 22) of the joint covariance of a fitted line's ordinates at its two ends.

    An ordinate at the share t of the line's length has the variance s^2 (1 + 12 (t - a)^2), for centres spread
    evenly over the length; a, where this variance is smallest, follows from the two given ones (1/2 if they are
    equal), and the covariance of the two ends is s^2 (1 - 12 a (1 - a)). If the ratio of the two exceeds sqrt(13),
    a is set to the end with the smaller one.
    """
    start, end = start_sd * start_sd, end_sd * end_sd
    # (end - start) 12 a^2 + 24 start a + end - 13 start = 0; the root that stays finite for equal sigmas
    quadratic, linear, constant = 12.0 * (end - start), 24.0 * start, end - 13.0 * start
    a = -2.0 * constant / (linear + sqrt(max(linear * linear - 4.0 * quadratic * constant, 0.0)))
    a = min(max(a, 0.0), 1.0)
    covariance = 1.0 - 12.0 * a * (1.0 - a)
    correlation = covariance / sqrt((1.0 + 12.0 * a * a) * (1.0 + 12.0 * (1.0 - a) ** 2))
    sine = sqrt(1.0 - correlation * correlation)
    return 1.0 / start_sd, -correlation / (start_sd * sine), 1.0 / (end_sd * sine)


def _middles(laser: Int64[Array, "point"], x: Float64[Array, "point"], lines: Lines) -> Float64[Array, "point"]:
    """Abscissa of the middle of each point's stripe: of its line, or else of its break points."""
    middle = {number: sum(ends) / 2 for number, ends in zip(lines.laser.tolist(), lines.x.tolist(), strict=True)}
    for number in set(laser.tolist()) - middle.keys():
        middle[number] = float(x[laser == number].mean())
    return np.array([middle[number] for number in laser.tolist()], dtype=np.float64)


def no_edges(camera: Camera) -> Edges:
    """No visible edge points."""
    return Edges(
        edge=np.empty(0, dtype=np.int64),
        ray=np.empty((0, 3)),
        step=np.empty((0, 2)),
        wrt_camera=np.empty((0, 2, 4 + len(camera.distortion_coefficients))),
        common=np.empty((0, ERRORS)),
        stamp_s=np.empty(0),
    )


def edges_of(ring_edges: RingEdgePoints | None, camera: Camera) -> Edges:
    """The visible edges as measurements; none without points."""
    if ring_edges is None or not len(ring_edges.edge):
        return no_edges(camera)
    xy = undistort(ring_edges.position_px, camera)
    ray_wrt_pixel, wrt_camera = rays_wrt_pixel_and_camera(xy, camera)
    sigma_px = np.maximum(ring_edges.sigma_px, MIN_SIGMA_PX)[:, None]
    step_px = ring_edges.normal * sigma_px
    return Edges(
        edge=ring_edges.edge,
        ray=np.concatenate([xy, np.ones((len(xy), 1))], axis=1),
        step=(ray_wrt_pixel @ step_px[:, :, None])[:, :, 0],
        wrt_camera=wrt_camera,
        common=common_errors_px(ring_edges) / sigma_px,
        stamp_s=np.full(len(xy), np.nan) if ring_edges.stamp_s is None else ring_edges.stamp_s,
    )


def error_inflation(edges: Edges, residual: Float64[Array, "visible"]) -> Float64[Array, "visible"]:
    """Factors on the points' standard deviations: roots of their integrated autocorrelation times in each frame.

    `residual` are the points' residuals in a fit to all measurements, in standard deviations.
    """
    factor = np.ones(len(residual))
    _, frame = np.unique(edges.stamp_s, return_inverse=True)
    for edge, number in product((0, 1), range(int(frame.max(initial=-1)) + 1)):
        members = np.flatnonzero((edges.edge == edge) & (frame == number))
        if len(members) > MAX_SHARE_OF_LENGTH:
            along = edges.ray[members, :2] - edges.ray[members, :2].mean(axis=0)
            direction = np.linalg.svd(along, full_matrices=False)[2][0]
            factor[members] = np.sqrt(integrated_autocorrelation_time(residual[members][np.argsort(along @ direction)]))
    return factor
