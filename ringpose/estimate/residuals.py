"""Residuals of one shot and their analytic Jacobian with respect to the ring (ringpose-method(7), section 5).

All residuals are in units of their standard deviations, in this order: the lines of the stripes (residual a), the
break points along their lines (b), the ordinates of break points without a line, the visible edges (c), and the prior
(d).

The state is chosen such that nothing degenerates when the ring looks straight: the plane as q with q . P = 1 (on it
the inverse depth q . r is linear in the image), the distance s from the mean of the break points to the middle of the
band along the outward direction u, the curvature k = 1/R of the mid-band circle, and the width of the band. A ring
whose centre is not determined then still has a well-defined curvature.

`x_wrt_y` is the derivative of x with respect to y.
"""

from math import hypot, nan, sqrt
from typing import NamedTuple

import numpy as np

from ringpose.estimate.measurements import Edges, Measurements, Observations, Points
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.ring import KnownRadii

PARAMETERS = 7
"""Of a step: plane 3, shift_m, rotation of `outward` about the normal, curvature, band_m."""

PLANE, SHIFT, TURN, CURVATURE, BAND = slice(0, 3), 3, 4, 5, 6
"""Their indices."""

EXPECTED_CURVATURE, CURVATURE_SD = 1.5, 1.5
"""Weak prior in 1/m (a radius of 0.3 m has 3.3; the largest ring in launcher manuals has 0.76)."""

TURN_SD_RAD = 0.5
"""Weak prior on the angle between the stripes and the radius, if a single stripe has to determine it."""

TILT_SD_RAD = 0.6
"""Weak prior on the angle between the ring's normal and the line of sight, if a single stripe leaves it open."""

EXPECTED_BAND_M, BAND_SD_M = 0.03, 0.03
"""Prior on the width of the band if only one edge was seen: bands in launcher manuals have 0.03 m."""

MIN_RATE = 1e-12
"""Lower bound of the derivative of a point's distance from its circle with respect to the abscissa."""

_XY = np.eye(3, 2)


class RingState(NamedTuple):
    """A ring, parametrised about the point of its plane near which it was measured."""

    plane: Float64[Array, "3"]
    """q in 1/m: the ring's plane is q . P = 1."""
    outward: Float64[Array, "3"]
    """Unit vector u in the plane, from the centre to the mean of the break points."""
    shift_m: float
    """From that mean to the middle of the band, along `outward`."""
    curvature: float
    """1 / mean radius, in 1/m."""
    band_m: float
    """Outer minus inner radius."""

    @property
    def normal(self) -> Float64[Array, "3"]:
        """Unit normal, towards the camera."""
        x, y, z = self.plane.tolist()
        length = -(hypot(x, y, z) or nan)
        return np.array([x / length, y / length, z / length])

    @property
    def tangent(self) -> Float64[Array, "3"]:
        """Unit vector v in the plane along the band, perpendicular to `outward`."""
        return cross(self.normal, self.outward)

    def retract(self, step: Float64[Array, "7"]) -> "RingState":
        """The state after a step; `outward` is turned about the normal and projected onto the new plane."""
        plane = self.plane + step[PLANE]
        outward = self.outward + step[TURN] * self.tangent
        outward = outward - (outward @ plane) / (plane @ plane) * plane
        return RingState(
            plane=plane,
            outward=outward / sqrt(outward @ outward),
            shift_m=self.shift_m + float(step[SHIFT]),
            curvature=self.curvature + float(step[CURVATURE]),
            band_m=self.band_m + float(step[BAND]),
        )


class Prior(NamedTuple):
    """What is known about the ring before the measurement."""

    radii: KnownRadii | None = None
    regularize_about: RingState | None = None
    """The state about which curvature, turn and tilt have weak priors; None to estimate from the shot alone."""
    single_edge: bool = False
    """Whether only one edge was seen, so that the width of the band needs a prior."""

    @property
    def is_empty(self) -> bool:
        """Whether it adds no residuals."""
        return self.radii is None and self.regularize_about is None and not self.single_edge


class StripePrediction(NamedTuple):
    """Predicted stripes, at the abscissae of the lines' ends, then of the break points."""

    rays: Float64[Array, "sample 3"]
    slope: Float64[Array, "sample"]
    denominator: Float64[Array, "sample"]
    """(m - d q)_y, which divides all derivatives of the ordinates."""
    y_wrt_plane: Float64[Array, "sample 3"]


class Origin(NamedTuple):
    """The point of the ring's plane on the mean ray of the break points."""

    position_m: Float64[Array, "3"]
    wrt_plane: Float64[Array, "3 3"]
    wrt_ray: Float64[Array, "3 2"]
    """With respect to x and y of the mean ray."""


class CircleDistances(NamedTuple):
    """Signed distances of points from the circles of their edges (outward positive), and their derivatives."""

    distance: Float64[Array, "n"]
    """In metres; of visible edges in standard deviations."""
    jacobian: Float64[Array, "n 7"]
    wrt_ray: Float64[Array, "n 2"]
    """With respect to x and y of the point's ray."""


class OrdinateScale(NamedTuple):
    """Weights of the ordinates of isolated break points: residual (y - y(x) - share * distance) * scale."""

    which: Int64[Array, "isolated"]
    share: Float64[Array, "isolated"]
    scale: Float64[Array, "isolated"]


class Residuals(NamedTuple):
    """The whitened residuals, their Jacobian, and the intermediate results that error propagation needs."""

    residual: Float64[Array, "row"]
    jacobian: Float64[Array, "row 7"]
    ends: int
    """Number of the lines' ends: their residuals and predictions come before those of the break points."""
    stripes: StripePrediction
    circles: CircleDistances
    """Of the break points."""
    origin: Origin
    edges: CircleDistances | None
    """Of the visible edges, in standard deviations."""
    distance_wrt_x: Float64[Array, "point"]
    """Derivative of a break point's distance from its circle along the predicted line."""
    distance_scale: Float64[Array, "point"]
    """1 / standard deviation of that distance."""
    ordinates: OrdinateScale

    @property
    def slope(self) -> Float64[Array, "point"]:
        """Of the predicted lines at the break points."""
        return self.stripes.slope[self.ends :]

    @property
    def y(self) -> Float64[Array, "point"]:
        """Predicted ordinates of the break points."""
        return self.stripes.rays[self.ends :, 1]


def ring_residuals(state: RingState, measured: Measurements, observations: Observations, prior: Prior) -> Residuals:
    """The residuals of a state; `observations` are the same measurements with their light planes."""
    ends = len(observations.whitening)
    stripes = predict_stripes(state, observations)
    point_rays, y_wrt_plane = stripes.rays[ends:], stripes.y_wrt_plane[ends:]

    # a: whitened distances of the lines' ends from the predicted lines
    lines = np.zeros((ends, PARAMETERS))
    lines[:, PLANE] = -observations.whitening @ stripes.y_wrt_plane[:ends]
    blocks = [(observations.whitening @ (observations.rays[:ends, 1] - stripes.rays[:ends, 1]), lines)]

    # b: distances of the break points from their circles, along the predicted lines
    origin = mean_point(state, point_rays, y_wrt_plane)
    circles = circle_distances(state, point_rays, observations.edge_sign, origin)
    circles.jacobian[:, PLANE] += circles.wrt_ray[:, 1:] * y_wrt_plane  # the point moves with the predicted line
    distance_wrt_x = circles.wrt_ray[:, 0] + stripes.slope[ends:] * circles.wrt_ray[:, 1]
    distance_wrt_x = np.where(np.abs(distance_wrt_x) < MIN_RATE, MIN_RATE, distance_wrt_x)
    scale = 1.0 / (np.abs(distance_wrt_x) * observations.sigma_x)
    blocks.append((scale * circles.distance, scale[:, None] * circles.jacobian))

    ordinates = _ordinate_scale(measured.points, stripes.slope[ends:], distance_wrt_x)
    if len(ordinates.which):
        above = measured.points.y - point_rays[:, 1]
        blocks.append(_ordinate_residuals(ordinates, above, y_wrt_plane, circles))
    edges = _edge_distances(state, measured.edges, origin) if len(measured.edges.edge) else None  # c
    if edges is not None:
        blocks.append((edges.distance, edges.jacobian))
    if not prior.is_empty:
        blocks.append(_prior_residuals(state, prior))  # d
    residual, jacobian = (np.concatenate(each) for each in zip(*blocks, strict=True))
    return Residuals(residual, jacobian, ends, stripes, circles, origin, edges, distance_wrt_x, scale, ordinates)


def predict_stripes(state: RingState, observations: Observations) -> StripePrediction:
    """The stripes' lines in the image: a ray r that meets ring and light plane at one depth has (m - d q) . r = 0."""
    image_line = observations.light_normal - observations.light_distance_m[:, None] * state.plane
    denominator = image_line[:, 1]
    slope = image_line[:, 0] / -denominator
    rays = observations.rays.copy()
    rays[:, 1] = slope * observations.rays[:, 0] - image_line[:, 2] / denominator
    return StripePrediction(rays, slope, denominator, (observations.light_distance_m / denominator)[:, None] * rays)


def mean_point(state: RingState, rays: Float64[Array, "point 3"], y_wrt_plane: Float64[Array, "point 3"]) -> Origin:
    """The origin o of the plane's coordinates: P = r / (q . r) for the mean ray r of the break points."""
    share = 1.0 / len(rays)
    ray = share * rays.sum(axis=0)
    depth_m = 1.0 / float(ray @ state.plane)
    wrt_ray = depth_m * (_XY - depth_m * ray[:, None] * state.plane[:2])
    mean_y_wrt_plane = share * y_wrt_plane.sum(axis=0)
    wrt_plane = wrt_ray[:, 1:] * mean_y_wrt_plane - (depth_m**2 * ray)[:, None] * ray
    return Origin(depth_m * ray, wrt_plane, wrt_ray)


def circle_distances(
    state: RingState, rays: Float64[Array, "n 3"], edge_sign: Float64[Array, "n"], origin: Origin
) -> CircleDistances:
    """Distances e = |P - c| - R from the mid-band circle, less -+ band/2, in a form that is regular at curvature 0.

    With x, y along `outward` and `tangent` from the band's middle: e = (2 x + k (x^2 + y^2)) / (h + 1),
    h = hypot(1 + k x, k y) = 1 + k e. The derivatives are for fixed rays.
    """
    axes = np.array([state.outward, state.tangent])
    depth_m = 1.0 / (rays @ state.plane)
    point_u, point_v = depth_m * (axes @ rays.T)
    origin_u, origin_v = (axes @ origin.position_m).tolist()
    x, y = point_u - (origin_u + state.shift_m), point_v - origin_v
    k = state.curvature
    square = x * x + y * y
    h_cosine, h_sine = 1.0 + k * x, k * y
    h = np.sqrt(h_cosine * h_cosine + h_sine * h_sine)
    distance_m = (2.0 * x + k * square) / (h + 1.0)
    cosine, sine = h_cosine / h, h_sine / h  # direction from the centre to the point
    radial = np.array([cosine, sine])
    radial_m = cosine * point_u + sine * point_v

    jacobian = np.empty((len(rays), PARAMETERS))
    # the point moves along its ray, and the origin with the plane
    jacobian[:, PLANE] = (radial_m * depth_m)[:, None] * -rays - radial.T @ (axes @ origin.wrt_plane)
    jacobian[:, SHIFT] = -cosine
    jacobian[:, TURN] = cosine * y - sine * (x + state.shift_m)
    jacobian[:, CURVATURE] = (square - distance_m * distance_m) / (h + h)
    jacobian[:, BAND] = -0.5 * edge_sign
    wrt_ray = depth_m[:, None] * (radial.T @ axes[:, :2] - radial_m[:, None] * state.plane[:2])
    return CircleDistances(distance_m - (0.5 * state.band_m) * edge_sign, jacobian, wrt_ray)


def _ordinate_scale(
    points: Points, slope: Float64[Array, "point"], distance_wrt_x: Float64[Array, "point"]
) -> OrdinateScale:
    """Weights of the ordinates of points without a line.

    The height above the predicted line is correlated with the error of the abscissa, which residual b uses; the
    remainder after regression on the abscissa (`share`) is independent of it and has the standard deviation 1 / scale.
    """
    which = np.flatnonzero(points.isolated)
    if not len(which):
        return OrdinateScale(which, np.empty(0), np.empty(0))
    covariance, slope = points.covariance[which], slope[which]
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    cross_covariance = xy - slope * xx
    remainder = yy - 2.0 * slope * xy + slope**2 * xx - cross_covariance**2 / xx
    scale = 1.0 / np.sqrt(np.maximum(remainder, 1e-12 * xx))
    return OrdinateScale(which, cross_covariance / xx / distance_wrt_x[which], scale)


def _ordinate_residuals(
    ordinates: OrdinateScale,
    above: Float64[Array, "point"],
    y_wrt_plane: Float64[Array, "point 3"],
    circles: CircleDistances,
) -> tuple[Float64[Array, "isolated"], Float64[Array, "isolated 7"]]:
    which, share, scale = ordinates
    jacobian = -share[:, None] * circles.jacobian[which]
    jacobian[:, PLANE] -= y_wrt_plane[which]
    return scale * (above[which] - share * circles.distance[which]), scale[:, None] * jacobian


def _edge_distances(state: RingState, edges: Edges, origin: Origin) -> CircleDistances:
    """Residual c: distances of the visible edge points from their circles, in standard deviations."""
    circles = circle_distances(state, edges.ray, 2.0 * edges.edge - 1.0, origin)
    scale = 1.0 / np.maximum(np.abs((circles.wrt_ray * edges.step).sum(axis=1)), np.finfo(float).tiny)
    return CircleDistances(
        scale * circles.distance, scale[:, None] * circles.jacobian, scale[:, None] * circles.wrt_ray
    )


def _prior_residuals(state: RingState, prior: Prior) -> tuple[Float64[Array, "row"], Float64[Array, "row 7"]]:
    """Residuals d: each row is a value and its nonzero derivatives by parameter."""
    rows: list[tuple[float, dict[int, float]]] = []
    if prior.radii is not None:
        # (1/k -+ band/2 - radius) / sd, multiplied by k radius: regular at curvature 0
        for sign, radius_m, sd_m in zip(
            (-1.0, 1.0), prior.radii.radius_m.tolist(), prior.radii.sd_m.tolist(), strict=True
        ):
            if radius_m == radius_m:
                mean_radius_m, weight = radius_m - 0.5 * sign * state.band_m, radius_m / sd_m
                derivatives = {CURVATURE: -weight * mean_radius_m, BAND: weight * 0.5 * sign * state.curvature}
                rows.append((weight * (1.0 - state.curvature * mean_radius_m), derivatives))
    if prior.regularize_about is not None:
        about = prior.regularize_about
        tilt_scale = TILT_SD_RAD * float(about.plane[2])
        rows += [
            ((state.curvature - EXPECTED_CURVATURE) / CURVATURE_SD, {CURVATURE: 1.0 / CURVATURE_SD}),
            (float(state.outward @ about.tangent) / TURN_SD_RAD, {TURN: 1.0 / TURN_SD_RAD}),
            (float(state.plane[0]) / tilt_scale, {0: 1.0 / tilt_scale}),
            (float(state.plane[1]) / tilt_scale, {1: 1.0 / tilt_scale}),
        ]
    if prior.single_edge:
        rows.append(((state.band_m - EXPECTED_BAND_M) / BAND_SD_M, {BAND: 1.0 / BAND_SD_M}))
    jacobian = np.zeros((len(rows), PARAMETERS))
    for row, (_, derivatives) in zip(jacobian, rows, strict=True):
        row[list(derivatives)] = list(derivatives.values())
    return np.array([value for value, _ in rows], dtype=np.float64), jacobian


def cross(a: Float64[Array, "3"], b: Float64[Array, "3"]) -> Float64[Array, "3"]:
    """np.cross of two vectors, in a tenth of its time."""
    ax, ay, az = a.tolist()
    bx, by, bz = b.tolist()
    return np.array([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx])
