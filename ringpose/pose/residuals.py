"""All residuals of a shot in one column, each divided by its standard deviation, with their derivatives.

Order: lines (a of ringpose-method(7), section 5), break points along their lines (b), break points across where no
line is known, visible edges (c), then what is known beforehand (d; and what rings are like, where a shot leaves that
open).

The ring and what it predicts: residuals of ringpose-method(7), section 5 with their analytic derivatives.

The state is kept where the measurement is, so that nothing degenerates when the ring looks straight: the plane as
q with q . P = 1 (on it the inverse depth q . r is linear in the image), the band's middle s beyond the mean of the
break points along the outward direction u, the curvature 1/R of the mid-band circle, and the band's width. A ring whose
centre is not determined has a curvature like any other.
"""

from math import hypot, nan, sqrt
from typing import NamedTuple

import numpy as np

from ringpose.pose.measurements import Edges, Measurements, Observations, Points
from ringpose.types.arrays import Array, Float64
from ringpose.types.ring import KnownRadii

LIKELY_CURVATURE, CURVATURE_SD = 1.5, 1.5
"""One over metres: what a ring that somebody builds may have (0.3 m: 3.3; the largest in launcher manuals: 0.76)."""

TURN_SD_RAD = 0.5
"""How far the stripes' direction may be from the radius, where one stripe alone has to tell it."""

TILT_SD_RAD = 0.6
"""How far a face that is seen may be turned from the line of sight, where one stripe leaves that open."""

LIKELY_BAND_M, BAND_SD_M = 0.03, 0.03
"""Where only one edge was seen: as wide as the bands in launcher manuals, or twice that, or very narrow."""

MIN_RATE = 1e-12
"""A distance from the circle that changes by less than this with the abscissa does not depend on it."""

_NONE = np.empty(0)


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


class Prior(NamedTuple):
    """What is known before the measurement."""

    radii: KnownRadii | None = None
    regularize_about: RingState | None = None
    """The start of a search in which what the shot leaves open is held to what rings are like."""
    one_edge: bool = False
    """Whether only one edge was seen."""

    @property
    def nothing(self) -> bool:
        """Whether that is all."""
        return self.radii is None and self.regularize_about is None and not self.one_edge


class Sights(NamedTuple):
    """Where stripes run as predicted: at the abscissae of the lines' ends, then of the break points."""

    rays: Float64[Array, "sight 3"]
    slope: Float64[Array, "sight"]
    denominator: Float64[Array, "sight"]
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


class EdgeParts(NamedTuple):
    """Visible edge points on the plane."""

    residual: Float64[Array, "visible"]
    by_state: Float64[Array, "visible 7"]
    by_ray: Float64[Array, "visible 2"]


class Rows(NamedTuple):
    """The column and what it was made of."""

    residual: Float64[Array, "row"]
    by_state: Float64[Array, "row 7"]
    ends: int
    """Number of the lines' ends: so many rows, and so many sights before those of the break points."""
    sights: Sights
    arcs: ArcParts
    origin: Origin
    edges: EdgeParts | None
    by_x: Float64[Array, "point"]
    """Derivative of a break point's distance from its circle by its abscissa, along the predicted line."""
    along_scale: Float64[Array, "point"]
    """One over the standard deviation of that distance."""
    across: "AcrossScale"

    @property
    def slope(self) -> Float64[Array, "point"]:
        """Of the predicted lines at the break points."""
        return self.sights.slope[self.ends :]

    @property
    def y(self) -> Float64[Array, "point"]:
        """Predicted ordinates of the break points."""
        return self.sights.rays[self.ends :, 1]


class AcrossScale(NamedTuple):
    """How ordinates of break points without a line enter: (y - y(x) - share * distance) * scale."""

    which: Array
    share: Float64[Array, "alone"]
    scale: Float64[Array, "alone"]


_NOTHING_ACROSS = AcrossScale(np.empty(0, dtype=np.int64), _NONE, _NONE)


def rows_of(state: RingState, measured: Measurements, sighted: Observations, before: Prior) -> Rows:
    """The residuals of a state; `sighted` are the same measurements with their light planes."""
    ends = len(sighted.whitening)
    sights = sights_of(state, sighted)
    y_by_plane = sights.y_by_plane[ends:]

    # a: whitened distances of the lines' ends from the predicted lines
    lines = np.zeros((ends, PARAMETERS))
    lines[:, PLANE] = -sighted.whitening @ sights.y_by_plane[:ends]
    parts = [(sighted.whitening @ (sighted.rays[:ends, 1] - sights.rays[:ends, 1]), lines)]

    # b: distances of the break points from their circles, along the predicted lines
    origin = origin_of(state, sights.rays[ends:], y_by_plane)
    arcs = arc_parts(state, sights.rays[ends:], sighted.edge_sign, origin)
    arcs.by_state[:, PLANE] += arcs.by_ray[:, 1:] * y_by_plane
    by_x = arcs.by_ray[:, 0] + sights.slope[ends:] * arcs.by_ray[:, 1]
    by_x = np.where(np.abs(by_x) < MIN_RATE, MIN_RATE, by_x)
    along_scale = 1.0 / (np.abs(by_x) * sighted.edge_sign_and_sigma[:, 1])
    parts.append((along_scale * arcs.distance_m, along_scale[:, None] * arcs.by_state))

    across = _across_scale(measured.points, sights.slope[ends:], by_x)
    if len(across.which):
        above = measured.points.y - sights.rays[ends:, 1]
        parts.append(_across_rows(across, above, y_by_plane, arcs))
    visible = edge_parts(state, measured.edges, origin) if len(measured.edges.edge) else None
    if visible is not None:
        parts.append((visible.residual, visible.by_state))
    if not before.nothing:
        parts.append(_known(state, before))
    residual, by_state = (np.concatenate(each) for each in zip(*parts, strict=True))
    return Rows(residual, by_state, ends, sights, arcs, origin, visible, by_x, along_scale, across)


def _across_rows(
    across: AcrossScale, above: Float64[Array, "point"], y_by_plane: Float64[Array, "point 3"], arcs: ArcParts
) -> tuple[Float64[Array, "alone"], Float64[Array, "alone 7"]]:
    which = across.which
    derivative = -across.share[:, None] * arcs.by_state[which]
    derivative[:, PLANE] -= y_by_plane[which]
    return across.scale * (above[which] - across.share * arcs.distance_m[which]), across.scale[:, None] * derivative


def _across_scale(points: Points, slope: Float64[Array, "point"], by_x: Float64[Array, "point"]) -> AcrossScale:
    """The ordinate above the predicted line errs with the abscissa too; what is left of it does not."""
    which = np.flatnonzero(points.alone)
    if not len(which):
        return _NOTHING_ACROSS
    covariance, slope = points.covariance[which], slope[which]
    xx, xy, yy = covariance[:, 0, 0], covariance[:, 0, 1], covariance[:, 1, 1]
    with_x = xy - slope * xx
    left = yy - 2.0 * slope * xy + slope**2 * xx - with_x**2 / xx
    return AcrossScale(which, with_x / xx / by_x[which], 1.0 / np.sqrt(np.maximum(left, 1e-12 * xx)))


def _known(state: RingState, before: Prior) -> tuple[Float64[Array, "row"], Float64[Array, "row 7"]]:
    residual: list[float] = []
    rows: list[tuple[dict[int, float], float]] = []
    if before.radii is not None:
        rows += _radius_rows(state, before.radii)
    if before.regularize_about is not None:
        rows += _weak_rows(state, before.regularize_about)
    if before.one_edge:
        rows.append(({BAND: 1.0 / BAND_SD_M}, (state.band_m - LIKELY_BAND_M) / BAND_SD_M))
    derivative = np.zeros((len(rows), PARAMETERS))
    for number, (entries, value) in enumerate(rows):
        residual.append(value)
        for column, entry in entries.items():
            derivative[number, column] = entry
    return np.array(residual, dtype=np.float64), derivative


def _radius_rows(state: RingState, radii: KnownRadii) -> list[tuple[dict[int, float], float]]:
    """(1/k -+ band/2 - radius) / sd, written as 1 - k (radius -+ band/2) so that no curvature is forbidden."""
    rows = []
    for sign, radius_m, sd_m in zip((-1.0, 1.0), radii.radius_m.tolist(), radii.sd_m.tolist(), strict=True):
        if radius_m == radius_m:
            middle_m, weight = radius_m - 0.5 * sign * state.band_m, radius_m / sd_m
            entries = {CURVATURE: -weight * middle_m, BAND: weight * 0.5 * sign * state.curvature}
            rows.append((entries, weight * (1.0 - state.curvature * middle_m)))
    return rows


def _weak_rows(state: RingState, about: RingState) -> list[tuple[dict[int, float], float]]:
    tilt_scale = TILT_SD_RAD * float(about.plane[2])
    turn = float(state.outward @ about.along)
    return [
        ({CURVATURE: 1.0 / CURVATURE_SD}, (state.curvature - LIKELY_CURVATURE) / CURVATURE_SD),
        ({TURN: 1.0 / TURN_SD_RAD}, turn / TURN_SD_RAD),
        ({0: 1.0 / tilt_scale}, float(state.plane[0]) / tilt_scale),
        ({1: 1.0 / tilt_scale}, float(state.plane[1]) / tilt_scale),
    ]


PARAMETERS = 7
"""Of the state: plane 3, shift_m, turn of `outward` about the normal, curvature, band_m."""

PLANE, SHIFT, TURN, CURVATURE, BAND = slice(0, 3), 3, 4, 5, 6
"""Where they stand."""

_E_XY = np.eye(3, 2)


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


def sights_of(state: RingState, sighted: Observations) -> Sights:
    """Residual a: a ray that meets ring and light plane at one depth has (m - d q) . r = 0, the stripe's line there."""
    image_line = sighted.light_normal - sighted.light_distance_m[:, None] * state.plane
    denominator = image_line[:, 1]
    slope = image_line[:, 0] / -denominator
    rays = sighted.rays.copy()
    rays[:, 1] = slope * sighted.rays[:, 0] - image_line[:, 2] / denominator
    return Sights(rays, slope, denominator, (sighted.light_distance_m / denominator)[:, None] * rays)


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


def edge_parts(state: RingState, edges: Edges, origin: Origin) -> EdgeParts:
    """Residual c: distance of visible edge points from their circle, in standard deviations, with its derivatives."""
    arcs = arc_parts(state, edges.ray, 2.0 * edges.edge - 1.0, origin)
    scale = 1.0 / np.maximum(np.abs((arcs.by_ray * edges.step).sum(axis=1)), np.finfo(float).tiny)
    return EdgeParts(scale * arcs.distance_m, scale[:, None] * arcs.by_state, scale[:, None] * arcs.by_ray)
