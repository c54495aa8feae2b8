"""The ring and what it predicts: residuals of MATH.md section 5 with their analytic derivatives.

The state is kept where the measurement is, so that nothing degenerates when the ring looks straight: the plane as
q with q . P = 1 (on it the inverse depth q . r is linear in the image), the band's middle s beyond the mean of the
break points along the outward direction u, the curvature 1/R of the mid-band circle, and the band's width. A ring whose
centre is not determined has a curvature like any other.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float64

from ringpose.pose.measurements import Edges, Lines, Points
from ringpose.types.arrays import Array
from ringpose.types.laser_planes import LaserPlanes

PARAMETERS = 7
"""Of the state: plane 3, shift_m, turn of `outward` about the normal, curvature, band_m."""

PLANE, SHIFT, TURN, CURVATURE, BAND = slice(0, 3), 3, 4, 5, 6
"""Where they stand."""

_E_Y = np.array([0.0, 1.0, 0.0])
_E_XY = np.eye(3, 2)


class RingState(NamedTuple):
    """A ring, and the point on its plane near which it was measured."""

    plane: Float64[Array, "3"]
    """q: the ring's plane is q . P = 1."""
    outward: Float64[Array, "3"]
    """Unit vector in the plane, from the centre to the mean of the break points."""
    shift_m: float
    """From that mean to the middle of the band, along `outward`."""
    curvature: float
    """One over the mean radius."""
    band_m: float

    @property
    def normal(self) -> Float64[Array, "3"]:
        """Unit normal, towards the camera."""
        normal: Float64[Array, "3"] = -self.plane / np.sqrt(self.plane @ self.plane)
        return normal

    @property
    def along(self) -> Float64[Array, "3"]:
        """Unit vector along the band, across `outward`."""
        return cross(self.normal, self.outward)


class LineParts(NamedTuple):
    """Measured minus predicted ordinates of the lines, whitened, and their derivatives."""

    residual: Float64[Array, "line 2"]
    by_state: Float64[Array, "line 2 7"]
    rays: Float64[Array, "line 2 3"]
    """Through the predicted line."""
    slope: Float64[Array, "line"]
    steepness: Float64[Array, "line"]
    """(m - d q)_y, by which all derivatives of the ordinates are divided."""


class PointParts(NamedTuple):
    """Break points on the predicted line at their measured abscissa."""

    rays: Float64[Array, "point 3"]
    position_m: Float64[Array, "point 3"]
    by_x: Float64[Array, "point 3"]
    """Derivative of the position by the abscissa, along the line."""
    by_y: Float64[Array, "point 3"]
    """By the ordinate, at constant abscissa, in the plane."""
    y_by_plane: Float64[Array, "point 3"]
    slope: Float64[Array, "point"]
    steepness: Float64[Array, "point"]


class Origin(NamedTuple):
    """The mean of the break points, as a point of the plane on a ray."""

    position_m: Float64[Array, "3"]
    by_plane: Float64[Array, "3 3"]
    by_ray: Float64[Array, "3 2"]
    """By x and y of the mean ray, in the plane."""


class ArcParts(NamedTuple):
    """Distances of points from the mid-band circle, outward positive, and their derivatives."""

    distance_m: Float64[Array, "n"]
    radial: Float64[Array, "n 3"]
    """Unit vectors from the centre: derivatives by the points."""
    by_arc: Float64[Array, "n 3"]
    """By shift, turn and curvature."""


def cross(a: Float64[Array, "3"], b: Float64[Array, "3"]) -> Float64[Array, "3"]:
    """np.cross for two vectors, at a tenth of its time."""
    ax, ay, az = a.tolist()
    bx, by, bz = b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def moved(state: RingState, step: Float64[Array, "7"]) -> RingState:
    """The state after a step; `outward` goes with the plane and is turned about its normal."""
    plane = state.plane + step[PLANE]
    normal = plane / np.sqrt(plane @ plane)
    outward = state.outward + step[TURN] * state.along
    outward = outward - (outward @ normal) * normal
    return RingState(
        plane=plane,
        outward=outward / np.sqrt(outward @ outward),
        shift_m=state.shift_m + float(step[SHIFT]),
        curvature=state.curvature + float(step[CURVATURE]),
        band_m=state.band_m + float(step[BAND]),
    )


def line_parts(state: RingState, lines: Lines, planes: LaserPlanes) -> LineParts:
    """A ray that meets ring and light plane at one depth has (m - d q) . r = 0: the stripe's line in the image."""
    distance = planes.distance_m[lines.laser]
    image_line = planes.normal[lines.laser] - distance[:, None] * state.plane
    steepness = image_line[:, 1]
    slope = -image_line[:, 0] / steepness
    y = slope[:, None] * lines.x - (image_line[:, 2] / steepness)[:, None]
    rays = np.stack([lines.x, y, np.ones_like(y)], axis=-1)
    by_state = np.zeros((len(distance), 2, PARAMETERS))
    by_state[:, :, PLANE] = -(lines.whitening @ rays) * (distance / steepness)[:, None, None]
    residual = (lines.whitening @ (lines.y - y)[:, :, None])[:, :, 0]
    return LineParts(residual, by_state, rays, slope, steepness)


def point_parts(state: RingState, points: Points, planes: LaserPlanes) -> PointParts:
    """Where the break points are if their stripes are as predicted."""
    distance = planes.distance_m[points.laser]
    image_line = planes.normal[points.laser] - distance[:, None] * state.plane
    steepness = image_line[:, 1]
    slope = -image_line[:, 0] / steepness
    rays = np.stack([points.x, slope * points.x - image_line[:, 2] / steepness, np.ones_like(points.x)], axis=-1)
    depth_m = 1.0 / (rays @ state.plane)
    along = np.stack([np.ones_like(slope), slope, np.zeros_like(slope)], axis=-1)
    return PointParts(
        rays=rays,
        position_m=depth_m[:, None] * rays,
        by_x=depth_m[:, None] * (along - (depth_m * (along @ state.plane))[:, None] * rays),
        by_y=depth_m[:, None] * (_E_Y - (depth_m * state.plane[1])[:, None] * rays),
        y_by_plane=(distance / steepness)[:, None] * rays,
        slope=slope,
        steepness=steepness,
    )


def origin_of(state: RingState, points: PointParts) -> Origin:
    """The point of the plane on the mean ray of the break points."""
    ray = points.rays.mean(axis=0)
    depth_m = 1.0 / float(ray @ state.plane)
    by_ray = depth_m * (_E_XY - depth_m * np.outer(ray, state.plane[:2]))
    by_plane = np.outer(by_ray[:, 1], points.y_by_plane.mean(axis=0)) - depth_m**2 * np.outer(ray, ray)
    return Origin(depth_m * ray, by_plane, by_ray)


def arc_parts(state: RingState, position_m: Float64[Array, "n 3"], origin: Origin) -> ArcParts:
    """Distance e = |P - c| - R from the mid-band circle, in a form that is regular at curvature 0 (a straight band).

    With x, y along and across `outward` from the band's middle: e = (2 x + k (x^2 + y^2)) / (h + 1),
    h = hypot(1 + k x, k y) = 1 + k e.
    """
    offset = position_m - origin.position_m
    along = state.along
    x, y = offset @ state.outward - state.shift_m, offset @ along
    k = state.curvature
    square = x * x + y * y
    h = np.sqrt((1.0 + k * x) ** 2 + (k * y) ** 2)
    distance_m = (2.0 * x + k * square) / (h + 1.0)
    cosine, sine = (1.0 + k * x) / h, k * y / h
    return ArcParts(
        distance_m=distance_m,
        radial=cosine[:, None] * state.outward + sine[:, None] * along,
        by_arc=np.stack(
            [-cosine, cosine * y - sine * (x + state.shift_m), (square - distance_m * distance_m) / (2.0 * h)], axis=-1
        ),
    )


def point_derivatives(points: PointParts, arcs: ArcParts, edge_sign: Float64[Array, "point"], origin: Origin) -> Array:
    """Derivatives (point, 7) of e -+ band/2 by the state, at constant abscissae."""
    by_state = np.empty((len(edge_sign), PARAMETERS))
    along_ray = (points.position_m * arcs.radial).sum(axis=1)
    depth_m = points.position_m[:, 2]
    by_state[:, PLANE] = (
        (points.by_y * arcs.radial).sum(axis=1)[:, None] * points.y_by_plane
        - (along_ray * depth_m)[:, None] * points.rays
        - arcs.radial @ origin.by_plane
    )
    by_state[:, SHIFT:BAND] = arcs.by_arc
    by_state[:, BAND] = -0.5 * edge_sign
    return by_state


class EdgeParts(NamedTuple):
    """Visible edge points on the plane."""

    residual: Float64[Array, "visible"]
    by_state: Float64[Array, "visible 7"]
    by_ray: Float64[Array, "visible 2"]


def edge_parts(state: RingState, edges: Edges, origin: Origin) -> EdgeParts:
    """Distance of visible edge points from their circle, in standard deviations, with its derivatives."""
    depth_m = 1.0 / (edges.ray @ state.plane)
    position_m = depth_m[:, None] * edges.ray
    arcs = arc_parts(state, position_m, origin)
    sign = 2.0 * edges.edge - 1.0
    along_ray = (position_m * arcs.radial).sum(axis=1)
    by_ray = depth_m[:, None] * (arcs.radial[:, :2] - along_ray[:, None] * state.plane[:2])
    scale = 1.0 / np.maximum(np.abs((by_ray * edges.step).sum(axis=1)), np.finfo(float).tiny)
    by_state = np.empty((len(sign), PARAMETERS))
    by_state[:, PLANE] = -(along_ray * depth_m)[:, None] * edges.ray - arcs.radial @ origin.by_plane
    by_state[:, SHIFT:BAND] = arcs.by_arc
    by_state[:, BAND] = -0.5 * sign
    return EdgeParts(
        residual=scale * (arcs.distance_m - 0.5 * sign * state.band_m),
        by_state=scale[:, None] * by_state,
        by_ray=scale[:, None] * by_ray,
    )
