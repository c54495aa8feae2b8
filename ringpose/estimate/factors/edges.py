"""Visible points of the ring's edges, and the errors that they have in common.

Errors of neighbouring points of a visible edge are correlated, as they come from what lies beside the edge: the foil
behind it, a wall, a shadow. The correlation exp(-distance / length) is represented by the first terms of its
Karhunen-Loeve series (`common_errors_px`).
"""

import math
from dataclasses import dataclass, replace
from itertools import product
from typing import ClassVar

import numpy as np

from ringpose.estimate.linearization import MIN_SIGMA_PX, Derivatives, ImageFactor
from ringpose.geometry.rays import rays_wrt_pixel_and_camera, undistort
from ringpose.geometry.ring import EDGE_SIGN, HALF_BAND, LIFT, TINY, RingPrediction
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.detection import RingEdgePoints
from ringpose.types.rig import Camera

ROUNDED_M, ROUNDED_TOLERANCES = 5e-4, 5.0
"""Standard deviation of the displacement of a visible edge by a chamfer or rounding, and its limit as a multiple of the
ring's tolerance: machined edges are broken by up to half a millimetre, those of a perfect ring are sharp."""

WALL_SD_M = 0.03
"""Standard deviation of the depth of a wall's foot below the face: interface rings are 10 to 60 mm high."""


@dataclass(frozen=True, kw_only=True, eq=False)
class EdgeFactor(ImageFactor):
    """Visible points of the ring's edges."""

    robust: ClassVar[bool] = True
    many: ClassVar[bool] = True

    step: Float64[Array, "row xy=2"]
    """Displacement by one standard deviation, along the edge's normal in the image."""
    common: Float64[Array, "row error"]
    """Derivatives by the errors of neighbouring points (unit variance), in the points' standard deviations."""
    walls: bool
    """Whether the edges may be the feet of the ring's walls."""

    def residuals(self, at: RingPrediction) -> tuple[Float64[Array, "row"], Derivatives]:
        """Eq. (5.6): the distance (5.2), divided by its change over one standard deviation along the edge's normal."""
        scale = self.scale(at)
        return scale * at.edges.distance_m[self.beside], Derivatives(distance=scale[:, None])

    def scale(self, at: RingPrediction) -> Float64[Array, "row"]:
        """1 / standard deviation of the distance from the edge."""
        wrt_sd = (at.edges.wrt_ray[self.beside] * self.step).sum(axis=1)
        scale: Float64[Array, "row"] = 1.0 / np.maximum(np.abs(wrt_sd), TINY)
        return scale

    def wrt_ray(self, at: RingPrediction) -> Float64[Array, "row xy=2"]:
        """By the derivatives of the distance."""
        wrt_ray: Float64[Array, "row xy=2"] = self.scale(at)[:, None] * at.edges.wrt_ray[self.beside]
        return wrt_ray

    def own_errors(self, jacobian: Float64[Array, "row step=7"], tolerance_m: float) -> Float64[Array, "row error"]:
        """By errors of neighbouring points, by displacements of whole edges, and by the depth of the feet of walls.

        A chamfer or a rounding reflects laser light and ambient light in different directions, so that the edge in
        ambient light lies beside the ends of the stripes by up to its width.

        What looks like an edge may be the foot of the ring's wall where the camera sees the wall and it is as bright as
        the face: the depth of the foot below the face is an error of each edge. Beside several stripes it mainly
        changes the curvature, as the wall's width in the image changes along the edge; a single one leaves the tilt
        about it to the edges, and a tilt has the same effect.
        """
        assert self.edge is not None
        columns, of_edge = [self.common], self.edge[:, None] == range(len(EDGE_SIGN))
        rounded_m = min(ROUNDED_M, ROUNDED_TOLERANCES * tolerance_m)
        if rounded_m > 0.0:
            columns.append(rounded_m * np.abs(jacobian[:, HALF_BAND, None]) * of_edge)
        if self.walls:
            outward = jacobian[:, LIFT, None]
            columns.append(WALL_SD_M * (of_edge & (outward * EDGE_SIGN > 0.0)) * outward)
        return np.concatenate(columns, axis=1)


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


def no_edges(camera: Camera) -> Edges:
    """No visible edge points."""
    return Edges(
        edge=np.empty(0, dtype=np.int64),
        ray=np.empty((0, 3)),
        step=np.empty((0, 2)),
        wrt_camera=np.empty((0, 2, 4 + len(camera.distortion_coefficients))),
        common=np.empty((0, 0)),
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


ROUNDED_PX = 0.05
"""Standard deviation of the common displacement of an edge: half the brightness on a rounded corner."""

CORRELATED_SHARE = 0.4
"""Share of a point's standard deviation that is correlated with its neighbours; maximum-likelihood estimate from 60
edges of rendered rings before foil, walls and shadows, which a constant error in pixels explains far worse."""

CORRELATION_LENGTH_PX = 150.0
"""Correlation length along the edge, estimated from the same edges (100 and 200 are nearly as likely)."""

TERMS = 8
"""Terms of the series; further ones have less variance than the points' independent errors. So many independent numbers
the visible edges count as when explanations are compared."""

FRAME_PX = 0.03
"""Standard deviation of the displacement of an edge in one frame against another, by what shades or passes behind it
and differs between them; measured on rendered rings with gaps, in the sun, 6 ms apart."""


def common_errors_px(edges: RingEdgePoints) -> Float64[Array, "visible error"]:
    """Displacement of each point along its normal by common errors of unit variance; 0 for errors of the other edge."""
    frame = np.zeros(len(edges.edge), dtype=np.int64)
    if edges.stamp_s is not None:
        frame = np.unique(edges.stamp_s, return_inverse=True)[1]
    # one displacement, the terms of the series, and one in each frame
    errors = np.zeros((len(edges.edge), len(EDGE_SIGN), 1 + TERMS + 1 + int(frame.max(initial=0))))
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
    return errors.reshape(len(errors), -1)


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


SHORT_SERIES = 1.5
"""Factor on the autocorrelation time: a circle fitted to a short series removes part of the correlation."""

MAX_SHARE_OF_LENGTH = 3
"""Largest lag as a fraction 1 / 3 of the number of points; longer lags have too few pairs."""


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
