"""Measurements of one shot in normalised undistorted coordinates: lines, break points, ring edges.

Normalised coordinates are those of rays (x, y, 1). Stripes run roughly along x: a line is measured by its ordinates, a
break point by its abscissa.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TypeVar

import numpy as np

from ringpose.estimate.factors.edges import Edges, edges_of, no_edges
from ringpose.estimate.factors.lines import Lines, lines_of
from ringpose.estimate.factors.points import Points, points_of
from ringpose.estimate.linearization import Factor, Observations
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.ring import RingSamples
from ringpose.geometry.sheets import bends_of, light_planes, line_planes, sheet_points
from ringpose.types.arrays import Array, Bool, Float64, Int64
from ringpose.types.detection import BreakPoints, RingEdgePoints
from ringpose.types.pose import NoPose
from ringpose.types.rig import Rig

Parts = TypeVar("Parts", Lines, Points)


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
        lines, points, edges = self.lines, self.points, self.edges
        laser = np.concatenate([np.repeat(lines.laser, 2), points.laser])
        ends, samples = 2 * len(lines.laser), len(laser)
        rays = np.ones((samples, 3))
        rays[:ends, 0], rays[:ends, 1] = lines.x.ravel(), lines.y.ravel()
        rays[ends:, 0], rays[ends:, 1] = points.x, points.y
        stamp_s = np.concatenate([np.repeat(lines.stamp_s, 2), points.stamp_s, edges.stamp_s])
        instant_s, instant = np.unique(self.times_s(stamp_s), return_inverse=True)
        light_normal, light_distance_m, bend_m = _light(rays, laser, ends, self.rig)
        view = RingSamples(
            rays=rays,
            light_normal=light_normal,
            light_distance_m=light_distance_m,
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
            bend_m=bend_m,
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


def _light(
    rays: Float64[Array, "sample xyz=3"], laser: Int64[Array, "sample"], ends: int, rig: Rig
) -> tuple[Float64[Array, "sample xyz=3"], Float64[Array, "sample"], Float64[Array, "sample bow=3"] | None]:
    """Normal and distance of the light plane of each sample, and `Observations.bend_m`; the first are ends of lines."""
    normal, distance_m = light_planes(rays, laser, rig)
    bent = bends_of(rig)
    if bent is None:
        return normal, distance_m, None
    bend_m = bent.of(laser).wrt_parameters(sheet_points(rays, laser, rig))
    of_line, line_distance_m, by_bow = line_planes(rays[:ends].reshape(-1, 2, 3), laser[:ends:2], rig)
    met = np.repeat(np.isfinite(line_distance_m), 2)
    normal[:ends][met] = of_line.repeat(2, axis=0)[met]
    distance_m[:ends][met], bend_m[:ends] = line_distance_m.repeat(2)[met], by_bow.reshape(-1, bend_m.shape[1])
    return normal, distance_m, bend_m


def measurements_of(
    break_points: BreakPoints,
    rig: Rig,
    ring_edges: RingEdgePoints | None = None,
    camera: CameraMotion | None = None,
) -> Measurements:
    """The measurements of a detection; NaN where a point cannot be undistorted."""
    lines = lines_of(break_points, rig.camera)
    points, has_covariances = points_of(break_points, lines, rig.camera)
    if break_points.repeated is not None:
        lines_again = lines_of(break_points.repeated, rig.camera)
        points_again, have_covariances = points_of(break_points.repeated, lines_again, rig.camera)
        lines, points = _repeated_lines(lines, lines_again), _repeated_points(points, points_again)
        has_covariances = has_covariances and have_covariances
    if break_points.opposite is not None:
        lines_beyond = lines_of(break_points.opposite, rig.camera, opposite=True)
        every_line = joined(lines, lines_beyond)
        points_beyond, have_covariances = points_of(break_points.opposite, every_line, rig.camera, opposite=True)
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
