"""The ring and what it predicts: residuals of ringpose-method(7), section 5 with their analytic derivatives.

The state is kept where the measurement is, so that nothing degenerates when the ring looks straight: the plane as
q with q . P = 1 (on it the inverse depth q . r is linear in the image), the band's middle s beyond the mean of the
break points along the outward direction u, the curvature 1/R of the mid-band circle, and the band's width. A ring whose
centre is not determined has a curvature like any other.
"""

from math import hypot, nan, sqrt
from typing import NamedTuple

import numpy as np

from ringpose.pose.measurements import Edges, Sighted
from ringpose.types.arrays import Array, Float64

PARAMETERS = 7
"""Of the state: plane 3, shift_m, turn of `outward` about the normal, curvature, band_m."""

PLANE, SHIFT, TURN, CURVATURE, BAND = slice(0, 3), 3, 4, 5, 6
"""Where they stand."""

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
    def numbers(self) -> Float64[Array, "9"]:
        """All of it in a row."""
        return np.array([*self.plane.tolist(), *self.outward.tolist(), self.shift_m, self.curvature, self.band_m])

    @property
    def normal(self) -> Float64[Array, "3"]:
        """Unit normal, towards the camera."""
        x, y, z = self.plane.tolist()
        towards = -(hypot(x, y, z) or nan)
        return np.array([x / towards, y / towards, z / towards])

    @property
    def along(self) -> Float64[Array, "3"]:
        """Unit vector along the band, across `outward`."""
        return cross(self.normal, self.outward)


class Sights(NamedTuple):
    """Where stripes run as predicted: at the abscissae of the lines' ends, then of the break points."""

    rays: Float64[Array, "sight 3"]
    slope: Float64[Array, "sight"]
    steepness: Float64[Array, "sight"]
    """(m - d q)_y, by which all derivatives of the ordinates are divided."""
    y_by_plane: Float64[Array, "sight 3"]
    """Derivative of the predicted ordinate by the ring's plane."""


class Origin(NamedTuple):
    """The mean of the break points, as a point of the plane on a ray."""

    position_m: Float64[Array, "3"]
    by_plane: Float64[Array, "3 3"]
    by_ray: Float64[Array, "3 2"]
    """By x and y of the mean ray, in the plane."""


class ArcParts(NamedTuple):
    """Distances of points in the plane from their edges' circles, outward positive, and their derivatives."""

    distance_m: Float64[Array, "n"]
    by_state: Float64[Array, "n 7"]
    by_ray: Float64[Array, "n 2"]
    """By x and y of the ray."""


def cross(a: Float64[Array, "3"], b: Float64[Array, "3"]) -> Float64[Array, "3"]:
    """np.cross for two vectors, at a tenth of its time."""
    ax, ay, az = a.tolist()
    bx, by, bz = b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])


def moved(state: RingState, step: Float64[Array, "7"]) -> RingState:
    """The state after a step; `outward` goes with the plane and is turned about its normal."""
    plane = state.plane + step[PLANE]
    outward = state.outward + step[TURN] * state.along
    outward = outward - (outward @ plane) / (plane @ plane) * plane
    return RingState(
        plane=plane,
        outward=outward / sqrt(outward @ outward),
        shift_m=state.shift_m + float(step[SHIFT]),
        curvature=state.curvature + float(step[CURVATURE]),
        band_m=state.band_m + float(step[BAND]),
    )


def sights_of(state: RingState, sighted: Sighted) -> Sights:
    """Residual a: a ray that meets ring and light plane at one depth has (m - d q) . r = 0, the stripe's line there."""
    image_line = sighted.light_normal - sighted.light_distance_m[:, None] * state.plane
    steepness = image_line[:, 1]
    slope = image_line[:, 0] / -steepness
    rays = sighted.rays.copy()
    rays[:, 1] = slope * sighted.rays[:, 0] - image_line[:, 2] / steepness
    return Sights(rays, slope, steepness, (sighted.light_distance_m / steepness)[:, None] * rays)


def origin_of(state: RingState, rays: Float64[Array, "point 3"], y_by_plane: Float64[Array, "point 3"]) -> Origin:
    """The point of the plane on the mean ray of the break points."""
    share = 1.0 / len(rays)
    ray = share * rays.sum(axis=0)
    depth_m = 1.0 / float(ray @ state.plane)
    by_ray = depth_m * (_E_XY - depth_m * ray[:, None] * state.plane[:2])
    mean_y_by_plane = share * y_by_plane.sum(axis=0)
    by_plane = by_ray[:, 1:] * mean_y_by_plane - (depth_m**2 * ray)[:, None] * ray
    return Origin(depth_m * ray, by_plane, by_ray)


def arc_parts(
    state: RingState, rays: Float64[Array, "n 3"], edge_sign: Float64[Array, "n"], origin: Origin
) -> ArcParts:
    """Residual b: distances e = |P - c| - R from the mid-band circle, in a form that is regular at curvature 0.

    With x, y along and across `outward` from the band's middle: e = (2 x + k (x^2 + y^2)) / (h + 1),
    h = hypot(1 + k x, k y) = 1 + k e. The derivatives are for fixed rays.
    """
    axes = np.array([state.outward, state.along])
    depth_m = 1.0 / (rays @ state.plane)
    over_u, over_v = depth_m * (axes @ rays.T)
    to_u, to_v = (axes @ origin.position_m).tolist()
    x, y = over_u - (to_u + state.shift_m), over_v - to_v
    k = state.curvature
    square = x * x + y * y
    stretch, turn = 1.0 + k * x, k * y
    h = np.sqrt(stretch * stretch + turn * turn)
    distance_m = (2.0 * x + k * square) / (h + 1.0)
    cosine, sine = stretch / h, turn / h
    radial = np.array([cosine, sine])
    reach_m = cosine * over_u + sine * over_v

    by_state = np.empty((len(rays), PARAMETERS))
    by_state[:, PLANE] = (reach_m * depth_m)[:, None] * -rays - radial.T @ (axes @ origin.by_plane)
    by_state[:, SHIFT] = -cosine
    by_state[:, TURN] = cosine * y - sine * (x + state.shift_m)
    by_state[:, CURVATURE] = (square - distance_m * distance_m) / (h + h)
    by_state[:, BAND] = -0.5 * edge_sign
    in_image = radial.T @ axes[:, :2] - reach_m[:, None] * state.plane[:2]
    return ArcParts(distance_m - (0.5 * state.band_m) * edge_sign, by_state, depth_m[:, None] * in_image)


class EdgeParts(NamedTuple):
    """Visible edge points on the plane."""

    residual: Float64[Array, "visible"]
    by_state: Float64[Array, "visible 7"]
    by_ray: Float64[Array, "visible 2"]


def edge_parts(state: RingState, edges: Edges, origin: Origin) -> EdgeParts:
    """Residual c: distance of visible edge points from their circle, in standard deviations, with its derivatives."""
    arcs = arc_parts(state, edges.ray, 2.0 * edges.edge - 1.0, origin)
    scale = 1.0 / np.maximum(np.abs((arcs.by_ray * edges.step).sum(axis=1)), np.finfo(float).tiny)
    return EdgeParts(scale * arcs.distance_m, scale[:, None] * arcs.by_state, scale[:, None] * arcs.by_ray)
