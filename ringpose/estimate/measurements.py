"""Measurements of one shot in normalised undistorted coordinates: lines, break points, ring edges.

Normalised coordinates are those of rays (x, y, 1). Stripes run roughly along x: a line is measured by its ordinates, a
break point by its abscissa.

The errors of neighbouring points of a visible edge are correlated, as they come from what lies beside the edge: the
foil behind it, a wall, a shadow (ringpose-method(7), section 5). The correlation exp(-distance / length) is represented
by the first terms of its Karhunen-Loeve series, which are nuisance parameters of the fit (`Edges.common`). What
correlation remains in the residuals raises the points' standard deviations (`inflate_sigma`).
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from math import sqrt
from typing import NamedTuple

import numpy as np

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

ROUNDED_PX = 0.05
"""Standard deviation of the common displacement of an edge: half the brightness on a rounded corner."""

CORRELATED_SHARE = 0.4
"""Share of a point's standard deviation that is correlated with its neighbours; maximum-likelihood estimate from 60
edges of rendered rings before foil, walls and shadows, which a constant error in pixels explains far worse."""

CORRELATION_LENGTH_PX = 150.0
"""Correlation length along the edge, estimated from the same edges (100 and 200 are nearly as likely)."""

TERMS = 8
"""Terms of the series; further ones have less variance than the points' independent errors."""

FRAME_PX = 0.03
"""Standard deviation of the displacement of an edge in one frame against another, by what shades or passes behind it
and differs between them; measured on rendered rings with gaps, in the sun, 6 ms apart."""

FRAMES = 2
"""Number of frames in which the edges of a moving ring are measured."""

ERRORS = 2 * (1 + TERMS + FRAMES)
"""Number of common errors of a shot: one displacement, the terms of the series and one in each frame, for each edge."""

SHORT_SERIES = 1.5
"""Factor on the autocorrelation time: a circle fitted to a short series removes part of the correlation."""

MAX_SHARE_OF_LENGTH = 3
"""Largest lag as a fraction 1 / 3 of the number of points; longer lags have too few pairs."""


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


class Observations(NamedTuple):
    """The measurements with the light planes of their lasers, as one view of the ring."""

    measured: "Measurements"
    view: RingSamples
    laser: Int64[Array, "sample"]
    wrt_camera: Float64[Array, "ray xy=2 parameter"]
    """Derivatives of the rays of samples and visible edge points by the camera's parameters."""
    whitening: Float64[Array, "end end"]
    """Block-diagonal, of the lines' ordinates."""
    isolated: int
    """Number of the break points without a line."""
    stripe_numbers: int
    """Number of distinct numbers of stripes and break points."""
    described: Bool[Array, "point"]
    """Whether the point is on the arc at which the ring is described: the opposite one if nothing else is seen."""


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

    @cached_property
    def observations(self) -> Observations:
        """The view of the ring by ends of lines, break points and visible edge points, and the errors of these."""
        planes = self.rig.lasers
        laser = np.concatenate([np.repeat(self.lines.laser, 2), self.points.laser])
        rays = np.ones((len(laser), 3))
        ends = 2 * len(self.lines.laser)
        rays[:ends, 0], rays[:ends, 1] = self.lines.x.ravel(), self.lines.y.ravel()
        rays[ends:, 0], rays[ends:, 1] = self.points.x, self.points.y
        whitening = np.zeros((ends, ends))
        for number, block in enumerate(self.lines.whitening):
            whitening[2 * number : 2 * number + 2, 2 * number : 2 * number + 2] = block
        stamp_s = np.concatenate([np.repeat(self.lines.stamp_s, 2), self.points.stamp_s, self.edges.stamp_s])
        instant_s, instant = np.unique(self.times_s(stamp_s), return_inverse=True)
        view = RingSamples(
            rays=rays,
            light_normal=planes.normal[laser],
            light_distance_m=planes.distance_m[laser],
            ends=ends,
            visible_rays=self.edges.ray,
            visible_step=self.edges.step,
            edge_sign=2.0 * np.concatenate([self.points.edge, self.edges.edge]) - 1.0,
            instant_s=instant_s,
            instant=instant,
            camera=None if self.camera is None else self.camera.displacements(self.reference_s, instant_s),
        )
        of_lines = self.lines.wrt_camera
        of_rays = of_lines.reshape(ends, *of_lines.shape[2:]), self.points.wrt_camera, self.edges.wrt_camera
        opposite = self.points.opposite
        return Observations(
            measured=self,
            view=view,
            laser=laser,
            wrt_camera=np.concatenate(of_rays),
            whitening=whitening,
            isolated=int(np.count_nonzero(self.points.isolated)),
            stripe_numbers=self.stripe_numbers,
            described=np.ones_like(opposite) if opposite.all() else ~opposite,
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
        """Mid exposure of the frame that each residual of `ringpose.estimate.residuals` comes from; NaN if unknown."""
        isolated = self.points.stamp_s[self.points.isolated]
        return np.concatenate([np.repeat(self.lines.stamp_s, 2), self.points.stamp_s, isolated, self.edges.stamp_s])

    @cached_property
    def of_first_arc(self) -> Bool[Array, "row"]:
        """Whether each residual of `ringpose.estimate.residuals` is not of the opposite arc."""
        points = self.points.opposite
        lines, edges = np.repeat(self.lines.opposite, 2), np.zeros(len(self.edges.edge), dtype=bool)
        return ~np.concatenate([lines, points, points[self.points.isolated], edges])

    @cached_property
    def stripe_numbers(self) -> int:
        """Number of measured values of stripes and break points; a value that was measured twice counts once."""
        ends = self.points.ends
        distinct = len(set(ends.tolist())) + len(set(ends[self.points.isolated].tolist()))
        of_arc = [set(self.lines.laser[self.lines.opposite == arc].tolist()) for arc in (False, True)]
        return 2 * (len(self.stripes) + len(of_arc[0] & of_arc[1])) + distinct

    @property
    def pieces(self) -> Int64[Array, "line"]:
        """A number for each piece of a stripe on an arc, the same where it was measured again."""
        numbers: Int64[Array, "line"] = 2 * self.lines.laser + self.lines.opposite
        return numbers

    @cached_property
    def stripes(self) -> list[int]:
        """The lasers with a line, in ascending order."""
        return sorted(set(self.lines.laser.tolist()))

    def once(self) -> "Measurements":
        """The measurements with each stripe and break point once; repeated measurements in later frames are dropped."""
        first = np.unique(self.points.ends, return_index=True)[1]
        return self._selected(np.unique(self.pieces, return_index=True)[1], first)

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
        every_line = Lines(*map(np.concatenate, zip(lines, lines_beyond, strict=True)))
        points_beyond, have_covariances = _points(break_points.opposite, every_line, rig.camera, opposite=True)
        lines, points = every_line, Points(*map(np.concatenate, zip(points, points_beyond, strict=True)))
        has_covariances = has_covariances and have_covariances
    stamps, edges = np.concatenate([lines.stamp_s, points.stamp_s]), _edges(ring_edges, rig.camera)
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
    joined = Lines(*map(np.concatenate, zip(first, again, strict=True)))
    twice = np.isin(joined.laser, first.laser) & np.isin(joined.laser, again.laser)
    return joined._replace(whitening=joined.whitening / np.sqrt(np.where(twice, REPEATED, 1.0))[:, None, None])


def _repeated_points(first: Points, again: Points) -> Points:
    joined = Points(*map(np.concatenate, zip(first, again, strict=True)))
    of_first, of_again, of_joined = (each.ends for each in (first, again, joined))
    variances = np.where(np.isin(of_joined, of_first) & np.isin(of_joined, of_again), REPEATED, 1.0)
    return joined._replace(
        covariance=joined.covariance * variances[:, None, None], sigma_x=joined.sigma_x * np.sqrt(variances)
    )


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


def _edges(ring_edges: RingEdgePoints | None, camera: Camera) -> Edges:
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


def common_errors_px(edges: RingEdgePoints) -> Float64[Array, "visible error"]:
    """Displacement of each point along its normal by common errors of unit variance; 0 for errors of the other edge."""
    errors = np.zeros((len(edges.edge), 2, ERRORS // 2))
    frame = np.zeros(len(edges.edge), dtype=np.int64)
    if edges.stamp_s is not None:
        frame = np.minimum(np.unique(edges.stamp_s, return_inverse=True)[1], FRAMES - 1)
    for edge in (0, 1):
        members = np.flatnonzero(edges.edge == edge)
        if len(members):
            errors[members, edge, 0] = ROUNDED_PX
            along_px = _along_px(edges.position_px[members], edges.normal[members])
            if frame.any():
                errors[members, edge, 1 + TERMS + frame[members]] = FRAME_PX
            errors[members, edge, 1 : 1 + TERMS] = (
                CORRELATED_SHARE * edges.sigma_px[members, None] * karhunen_loeve_terms(along_px)
            )
    return errors.reshape(len(errors), ERRORS)


def karhunen_loeve_terms(along_px: Float64[Array, "n"]) -> Float64[Array, "n term"]:
    """Square root of the covariance exp(-distance / `CORRELATION_LENGTH_PX`): its largest eigenfunctions.

    sqrt(variance) cos(phase t) and sin(phase t) in turn, t from -1 to 1 along the edge (Ghanem and Spanos 1991, 2.3).
    """
    first, last = float(along_px.min()), float(along_px.max())
    half_px = max(0.5 * (last - first), 1.0)
    lengths = half_px / CORRELATION_LENGTH_PX
    # phase p of each term at the end of the edge: p = k pi/2 + atan(lengths / p), by Newton's method from above
    quarter = 0.5 * np.pi * np.arange(TERMS)
    phase: Float64[Array, "term"] = np.maximum(quarter, math.sqrt(lengths / (1.0 + lengths)))
    for _ in range(6):
        error = phase - quarter - np.arctan(lengths / phase)
        phase = phase - error / (1.0 + lengths / (phase**2 + lengths**2))
    sign = np.where(np.arange(TERMS) % 2, -1.0, 1.0)
    amplitude = np.sqrt(2.0 * lengths / (lengths**2 + phase**2))
    amplitude /= np.sqrt(1.0 + sign * np.sin(2.0 * phase) / (2.0 * phase))
    angle = ((along_px - 0.5 * (first + last)) / half_px)[:, None] * phase
    terms: Float64[Array, "n term"] = amplitude * np.where(sign > 0, np.cos(angle), np.sin(angle))
    return terms


def _along_px(position_px: Float64[Array, "n xy=2"], normal: Float64[Array, "n xy=2"]) -> Float64[Array, "n"]:
    """Positions along the edge: perpendicular to the mean normal of its points."""
    normal_x, normal_y = normal.sum(axis=0)
    length = math.hypot(normal_x, normal_y) or 1.0
    along_px: Float64[Array, "n"] = (position_px[:, 1] * normal_x - position_px[:, 0] * normal_y) / length
    return along_px


def inflate_sigma(edges: Edges, residual: Float64[Array, "visible"]) -> Edges:
    """The edges with standard deviations raised by the root of their integrated autocorrelation time in each frame.

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
    return replace(edges, step=edges.step * factor[:, None], common=edges.common / factor[:, None])


def integrated_autocorrelation_time(series: Float64[Array, "n"]) -> float:
    """Variance of the mean of a series, relative to that of as many independent standard normal numbers; at least 1.

    It is the variance plus twice the autocovariances up to the first one that is not positive (Geyer's initial
    sequence).
    """
    clipped = np.clip(series, -3.0, 3.0)
    variance = total = float(clipped @ clipped) / len(clipped)
    for lag in range(1, len(clipped) // MAX_SHARE_OF_LENGTH):
        autocovariance = float(clipped[lag:] @ clipped[:-lag]) / len(clipped)
        if autocovariance <= 0:
            break
        total += 2.0 * autocovariance
    return max(1.0, SHORT_SERIES * total if total > variance else variance)
