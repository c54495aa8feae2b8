"""The ring: two concentric circular edges in a plane, and what a camera sees of it, with derivatives.

The one model of the ring, for prediction and for estimation (ringpose-method(7), sections 5 and 8). A ring is described
about a point on the middle of its face near which it is seen, by seven increments (`STEP`): tilts and offset of its
plane, position and direction of the face, curvature and half width. Unlike centre and radii these stay regular where
the visible arc is nearly straight, and a few stripes determine most of them. `public_wrt_step` converts to the
parameters of the records.

A signed distance is positive outside the edge. `x_wrt_y` is the derivative of x with respect to y.
"""

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from ringpose.geometry.rotations import cross, skew, tilt_basis
from ringpose.types.arrays import Array, Float64, Int64

STEP = ("tilt_inward", "tilt_along", "lift_m", "shift_m", "turn_rad", "curvature", "half_band_m")
"""Increments of `RingArcs`.

The normal becomes n + tilt_inward inward + tilt_along along. The origin moves by lift_m along the normal and by shift_m
inward, and the axes turn by turn_rad about the normal. A motion of the origin along the face would not change the ring.
"""

TILT_INWARD, TILT_ALONG, LIFT, SHIFT, TURN, CURVATURE, HALF_BAND = range(7)
"""Indices of the increments `STEP`."""

EDGE_SIGN = (-1.0, 1.0)
"""Side of the middle of the face on which the inner and the outer edge lie, outward positive."""

MIN_CURVATURE = 1e-4
"""Bound in 1/m below which centre and radii are those of a ring with a radius of ten kilometres."""

MAX_LEVER_M = 5.0
"""Upper bound of the distance between a ring's face and the point that its velocity refers to, its centre.

Larger rings do not exist; where the visible arc looks straight, the centre would be kilometres away.
"""

TINY = float(np.finfo(float).tiny)
"""Smallest positive number of full precision, instead of a division by 0."""

MIN_RATE = 1e-12
"""Smallest rate at which a distance changes along a line or a ray; a smaller one counts as grazing."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RingArcs:
    """The edges of a ring's face as two arcs about one centre, in the camera frame.

    A moving ring has an origin and axes for each of several instants; `at_rows` selects that of each row of an array.
    """

    origin: Float64[Array, "*instant xyz=3"]
    """Point on the middle of the face, in metres."""
    axes: Float64[Array, "*instant 3 xyz=3"]
    """Unit vectors: inward (towards the centre), along the face, and the normal towards the camera."""
    curvature: float
    """Inverse of the mean radius in 1/m; negative if the centre is on the other side."""
    half_band_m: float
    """Half of the outer minus the inner radius."""

    @property
    def normal(self) -> Float64[Array, "*instant xyz=3"]:
        """Unit normal of the ring's plane, towards the camera."""
        normal: Float64[Array, "*instant xyz=3"] = self.axes[..., 2, :]
        return normal

    @property
    def mean_radius_m(self) -> float:
        """Radius of the middle of the face; bounded by 1 / `MIN_CURVATURE`."""
        return 1.0 / (self.curvature if abs(self.curvature) > MIN_CURVATURE else MIN_CURVATURE)

    @property
    def lever_m(self) -> float:
        """Signed distance from the origin to the point that a velocity refers to: the radius, up to `MAX_LEVER_M`."""
        return min(max(self.mean_radius_m, -MAX_LEVER_M), MAX_LEVER_M)

    @property
    def center(self) -> Float64[Array, "xyz=3"]:
        """Centre in metres."""
        center: Float64[Array, "xyz=3"] = self.origin + self.mean_radius_m * self.axes[0]
        return center

    @property
    def radius_m(self) -> Float64[Array, "edge=2"]:
        """Radii of the inner and the outer edge."""
        return self.mean_radius_m + self.half_band_m * np.array(EDGE_SIGN)

    def retract(self, step: Float64[Array, "step=7"]) -> "RingArcs":
        """The arcs after a step (`STEP`); Cayley's transform keeps the axes orthonormal."""
        tilt_inward, tilt_along, lift_m, shift_m, turn_rad, curvature, half_band_m = step.tolist()
        skew = np.array([[0.0, turn_rad, -tilt_inward], [-turn_rad, 0.0, -tilt_along], [tilt_inward, tilt_along, 0.0]])
        square = tilt_inward * tilt_inward + tilt_along * tilt_along + turn_rad * turn_rad
        # (1 - skew/2)^-1 (1 + skew/2), as skew^3 = -square skew
        rotation: Float64[Array, "3 3"] = IDENTITY + (skew + 0.5 * (skew @ skew)) / (1.0 + 0.25 * square)
        return RingArcs(
            origin=self.origin + lift_m * self.axes[2] + shift_m * self.axes[0],
            axes=rotation @ self.axes,
            curvature=self.curvature + curvature,
            half_band_m=self.half_band_m + half_band_m,
        )

    def with_center_opposite(self) -> "RingArcs":
        """These arcs, described with the centre on the other side: inner and outer edge are exchanged."""
        return RingArcs(
            origin=self.origin,
            axes=np.array([-self.axes[0], -self.axes[1], self.axes[2]]),
            curvature=-self.curvature,
            half_band_m=self.half_band_m,
        )

    def at_opposite_arc(self) -> "RingArcs":
        """The same ring, described about the point of its face's middle that is opposite to the origin."""
        return RingArcs(
            origin=self.origin + 2.0 * self.mean_radius_m * self.axes[0],
            axes=np.array([-self.axes[0], -self.axes[1], self.axes[2]]),
            curvature=self.curvature,
            half_band_m=self.half_band_m,
        )

    def predict(
        self,
        time_s: float | Float64[Array, "*instant"],
        velocity_m_s: Float64[Array, "xyz=3"],
        rate_rad_s: Float64[Array, "xyz=3"],
    ) -> "RingArcs":
        """The ring after a rigid motion at constant rates: c + v t, and rotated by exp([w] t) about its centre.

        Eq. (8.1) of ringpose-method(7); a rotation about the normal leaves the ring as it is.
        """
        time = np.asarray(time_s)[..., None]
        axes = self.axes @ rotation_by(rate_rad_s * time).swapaxes(-1, -2)
        return RingArcs(
            origin=self.origin + velocity_m_s * time + self.lever_m * (self.axes[0] - axes[..., 0, :]),
            axes=axes,
            curvature=self.curvature,
            half_band_m=self.half_band_m,
        )

    def at_rows(self, instant: Int64[Array, "row"]) -> "RingArcs":
        """The ring at the instant of each row."""
        return RingArcs(
            origin=self.origin[instant],
            axes=self.axes[instant],
            curvature=self.curvature,
            half_band_m=self.half_band_m,
        )


GENERATORS = np.array(
    [[0, 0, 0, 0, 0, -1, 0, 1, 0], [0, 0, 1, 0, 0, 0, -1, 0, 0], [0, -1, 0, 1, 0, 0, 0, 0, 0]], dtype=np.float64
)
"""The skew matrices, row after row, of the rotation vectors (1, 0, 0), (0, 1, 0) and (0, 0, 1)."""

IDENTITY = np.eye(3)


def rotation_by(vector_rad: Float64[Array, "*shape 3"]) -> Float64[Array, "*shape 3 3"]:
    """Rotation matrices of rotation vectors (Rodrigues)."""
    half = np.maximum(0.5 * np.sqrt((vector_rad * vector_rad).sum(axis=-1)), TINY)[..., None, None]
    skew = (vector_rad @ GENERATORS).reshape(*vector_rad.shape, 3)
    sinc = np.sin(half) / half  # sin(a)/a = sinc(a/2) cos(a/2), (1 - cos(a))/a^2 = sinc(a/2)^2 / 2: regular at 0
    rotation: Float64[Array, "*shape 3 3"] = IDENTITY + sinc * (np.cos(half) * skew + 0.5 * sinc * (skew @ skew))
    return rotation


DISPLACED = np.array([2, 0, 1])
"""The axes along which a displacement of the origin changes `LIFT`, `SHIFT` and `TURN`."""

AT_REST = np.eye(len(STEP), len(STEP) + 5)
"""`motion_derivatives` at the reference time."""


def motion_derivatives(
    before: RingArcs, moved: RingArcs, time_s: float | Float64[Array, "*instant"]
) -> Float64[Array, "*instant step=7 parameter=12"]:
    """Derivatives of the increments (`STEP`) of `moved`, which is `before.predict(time_s, ...)`, Eq. (8.2).

    They are taken with respect to the increments of the ring before (7), the velocity x, y, z of the centre, and the
    angular velocities about the inward axis and the axis along the face. The origin moves by o_k = o + v t + l (i -
    i_k), with the lever l and the inward axes i and i_k before and after. A displacement s along the face turns the
    ring by s / R, as it does not change the ring otherwise.
    """
    lever_m, curvature, time = before.lever_m, before.curvature, np.asarray(time_s)[..., None]
    turned = before.axes - moved.axes  # i - i_k, and the same of the other axes
    components = moved.axes[..., DISPLACED, :]
    components[..., 2, :] *= curvature
    derivatives = np.empty((*time.shape[:-1], *AT_REST.shape))
    derivatives[:] = AT_REST

    displaced = derivatives[..., LIFT : TURN + 1, :]
    displaced[..., LIFT : SHIFT + 1] = components @ before.axes[::-2].T
    along_turned = lever_m * (components @ turned.swapaxes(-1, -2))
    displaced[..., TURN] += along_turned[..., 1]
    displaced[..., TILT_INWARD] = -along_turned[..., 2]
    if abs(before.mean_radius_m) < MAX_LEVER_M:
        displaced[..., CURVATURE] = -lever_m * along_turned[..., 0]

    displaced[..., 7:10] = time[..., None] * components
    # about an axis a the normal n turns by a x n, the inward axis i by a x i; along = n x i
    about = time[..., None] * (moved.axes @ before.axes[:2].T)
    inward, along, normal = about[..., 0, :], about[..., 1, :], about[..., 2, :]
    derivatives[..., TILT_INWARD, 10:], derivatives[..., TILT_ALONG, 10:] = along, -inward
    displaced[..., 0, 10:], displaced[..., 2, 10:] = lever_m * along, (1.0 - lever_m * curvature) * normal
    return derivatives


def ring_arcs(
    center_m: Float64[Array, "xyz=3"],
    normal: Float64[Array, "xyz=3"],
    radius_m: Float64[Array, "edge=2"],
    near_m: Float64[Array, "xyz=3"],
) -> RingArcs:
    """The arcs of a ring of known pose, described about the point of its face's middle that is nearest to `near_m`."""
    outward = near_m - center_m
    outward = outward - (outward @ normal) * normal
    length = float(np.sqrt(outward @ outward))
    outward = tilt_basis(normal)[0] if length == 0.0 else outward / length
    mean_m = float(radius_m.mean())
    return RingArcs(
        origin=center_m + mean_m * outward,
        axes=np.array([-outward, cross(normal, -outward), normal]),
        curvature=1.0 / mean_m,
        half_band_m=0.5 * float(radius_m[1] - radius_m[0]),
    )


def _on_plane(
    arcs: RingArcs, rays: Float64[Array, "n xyz=3"]
) -> tuple[Float64[Array, "axis=3 n"], Float64[Array, "n"], Float64[Array, "axis=3 n"]]:
    """Components of rays along the arcs' axes, the depths at which they meet the ring's plane, and the places there.

    The places are measured from the origin: inward, along the face, and 0. The arcs are the same for all rays, or one
    for each.
    """
    along = rays @ arcs.axes.T if arcs.axes.ndim == 2 else (arcs.axes @ rays[..., None])[..., 0]
    origin = (arcs.axes @ arcs.origin[..., None])[..., 0]
    depth = origin[..., 2] / along[:, 2]
    return along.T, depth, (depth[:, None] * along - origin).T


# Stripes and break points


class StripePrediction(NamedTuple):
    """The lines of laser stripes on the ring's plane, at given abscissae of the normalised image."""

    rays: Float64[Array, "n xyz=3"]
    """(x, y, 1) on the predicted lines."""
    slope: Float64[Array, "n"]
    """dy/dx of the lines."""
    y_wrt_step: Float64[Array, "n step=7"]
    y_wrt_cosine: Float64[Array, "n"]
    """Derivatives by the product of ray and normal of the light plane."""
    depth: Float64[Array, "n"]
    """Depth at which the rays meet the ring's plane."""


def predicted_stripes(
    arcs: RingArcs,
    x: Float64[Array, "n"],
    light_normal: Float64[Array, "n xyz=3"],
    light_distance_m: Float64[Array, "n"],
) -> StripePrediction:
    """Ordinates of the stripes of light planes m . P = d: rays r with (m - d q) . r = 0, Eq. (5.1).

    q . P = 1 is the ring's plane, so that ring and light plane are met at the same depth.
    """
    normal = arcs.axes[..., 2, :]
    distance_m = (normal * arcs.origin).sum(axis=-1)
    line_x, line_y, line_1 = (light_normal - light_distance_m[:, None] * (normal / distance_m[..., None])).T
    y_wrt_cosine = -1.0 / line_y
    slope = line_x * y_wrt_cosine
    rays = np.ones((len(x), 3))
    rays[:, 0], rays[:, 1] = x, slope * x + line_1 * y_wrt_cosine
    _, depth, (inward_m, along_m, _) = _on_plane(arcs, rays)
    # q = n / (n . origin): a lift changes q . r = 1 / depth by -1 / (depth n . origin), a tilt by that times the lever
    y_wrt_step = np.zeros((len(STEP), len(x)))
    y_wrt_step[LIFT] = wrt_lift = light_distance_m * y_wrt_cosine / (depth * distance_m)
    y_wrt_step[TILT_INWARD], y_wrt_step[TILT_ALONG] = -wrt_lift * inward_m, -wrt_lift * along_m
    return StripePrediction(rays, slope, y_wrt_step.T, y_wrt_cosine, depth)


def predicted_break_points(
    arcs: RingArcs, light_normal: Float64[Array, "laser xyz=3"], light_distance_m: Float64[Array, "laser"]
) -> Float64[Array, "laser edge=2 xyz=3"]:
    """Where the light planes cross the inner and the outer edge, in space; NaN where a plane misses an edge.

    A plane crosses each circle twice; the crossing on the side of the arcs' origin is returned.
    """
    inward, _, normal = arcs.axes
    direction = light_normal @ skew(normal)  # m x n
    length = np.sqrt((direction * direction).sum(axis=1))
    direction = direction / np.where(length > MIN_RATE, length, np.nan)[:, None]
    # the point of each line (ring plane and light plane) that is nearest to the origin
    across = direction @ skew(normal).T  # n x direction
    foot_m = ((light_distance_m - light_normal @ arcs.origin) / (light_normal * across).sum(axis=1))[:, None] * across

    # distance e from the middle of the face: k (x^2 + y^2) - 2 x = 2 e + k e^2 along foot + t direction, Eq. (5.3)
    k = arcs.curvature
    distance_m = arcs.half_band_m * np.array(EDGE_SIGN)
    foot_x, direction_x = (foot_m @ inward)[:, None], (direction @ inward)[:, None]
    linear = 2.0 * k * (foot_m * direction).sum(axis=1)[:, None] - 2.0 * direction_x
    constant = k * (foot_m * foot_m).sum(axis=1)[:, None] - 2.0 * foot_x - (2.0 + k * distance_m) * distance_m
    discriminant = linear * linear - 4.0 * k * constant
    root = np.sqrt(np.where(discriminant >= 0.0, discriminant, np.nan))
    t = -2.0 * constant / (linear + np.copysign(root, linear))  # the smaller root, regular at curvature 0
    crossings: Float64[Array, "laser edge=2 xyz=3"] = arcs.origin + foot_m[:, None] + t[:, :, None] * direction[:, None]
    return crossings


# Edges


class EdgeDistances(NamedTuple):
    """Signed distances in metres, in the ring's plane, of rays from the edges; positive outside the edge."""

    distance_m: Float64[Array, "n"]
    wrt_step: Float64[Array, "n step=7"]
    """Derivatives by the ring's step, for fixed rays."""
    wrt_ray: Float64[Array, "n xy=2"]
    """Derivatives with respect to x and y of the rays (x, y, 1)."""


def edge_distances(arcs: RingArcs, rays: Float64[Array, "n xyz=3"], edge_sign: Float64[Array, "n"]) -> EdgeDistances:
    """Distances |P - c| - R of the rays' points on the ring's plane from the inner (`edge_sign` -1) or outer (+1) edge.

    Eq. (5.2), with x inward and y along the face from the origin, in the form that is regular at curvature 0:
    |P - c| - 1/k = (k (x^2 + y^2) - 2 x) / (1 + h), h = k |P - c| = hypot(1 - k x, k y).
    """
    (ray_inward, ray_along, ray_normal), depth, (x, y, _) = _on_plane(arcs, rays)
    k = arcs.curvature
    square = x * x + y * y
    h_x, h_y = 1.0 - k * x, k * y
    h = np.sqrt(h_x * h_x + h_y * h_y)
    outside_m = (k * square - 2.0 * x) / (1.0 + h)
    # derivatives of the distance by x and y: the outward direction
    wrt_x, wrt_y = -h_x / h, h_y / h
    wrt_lift = (wrt_x * ray_inward + wrt_y * ray_along) / ray_normal

    wrt_step = np.empty((len(STEP), len(rays)))
    wrt_step[TILT_INWARD] = -x * wrt_lift
    wrt_step[TILT_ALONG] = -y * wrt_lift
    wrt_step[LIFT] = wrt_lift
    wrt_step[SHIFT] = -wrt_x
    wrt_step[TURN] = wrt_x * y - wrt_y * x
    wrt_step[CURVATURE] = (square - outside_m * outside_m) / (2.0 * h)
    wrt_step[HALF_BAND] = -edge_sign
    # P = depth r: dP/dr = depth (1 - r n^T / (n . r))
    wrt_axes = np.array([wrt_x, wrt_y, -wrt_lift]) * depth
    wrt_ray = wrt_axes.T @ arcs.axes[:, :2] if arcs.axes.ndim == 2 else (wrt_axes.T[:, None] @ arcs.axes)[:, 0, :2]
    return EdgeDistances(outside_m - edge_sign * arcs.half_band_m, wrt_step.T, wrt_ray)


def polar_angles(arcs: RingArcs, rays: Float64[Array, "n xyz=3"]) -> Float64[Array, "n"]:
    """Angles about the ring's centre of the rays' points on its plane, in radians from the arcs' origin."""
    _, _, (x, y, _) = _on_plane(arcs, rays)
    angles: Float64[Array, "n"] = np.arctan2(arcs.curvature * y, 1.0 - arcs.curvature * x)
    return angles


def edge_points(
    arcs: RingArcs, along_m: Float64[Array, "n"], edge_sign: Float64[Array, "n"]
) -> tuple[Float64[Array, "n xyz=3"], Float64[Array, "n xyz=3"]]:
    """Points on the edges, and the unit vectors there that point away from the centre.

    `along_m` is the distance from the origin along the middle of the face. The arcs are the same for all points, or one
    for each.
    """
    half = (0.5 * arcs.curvature) * along_m  # of the angle about the centre
    sine, cosine = np.sin(half), np.cos(half)
    outward = np.stack([2.0 * sine * sine - 1.0, 2.0 * sine * cosine], axis=-1)
    chord_m = along_m * np.sinc(half / np.pi)
    flat = np.stack([chord_m * sine, chord_m * cosine], axis=-1) + (edge_sign * arcs.half_band_m)[:, None] * outward
    if arcs.axes.ndim == 2:
        in_space = np.stack([flat, outward]) @ arcs.axes[:2]
        return arcs.origin + in_space[0], in_space[1]
    in_space = np.stack([flat, outward], axis=1) @ arcs.axes[:, :2]
    return arcs.origin + in_space[:, 0], in_space[:, 1]


# All that one shot sees of a moving ring


class Rates(NamedTuple):
    """Motion of the ring: constant rates within a shot, Eq. (8.1)."""

    velocity_m_s: Float64[Array, "xyz=3"]
    """Velocity of the ring's centre."""
    rate_rad_s: Float64[Array, "xyz=3"]
    """Angular velocity across the normal."""


STILL = Rates(np.zeros(3), np.zeros(3))


class MovingRing(NamedTuple):
    """A ring at one instant, and its rates."""

    arcs: RingArcs
    rates: Rates


class CameraDisplacements(NamedTuple):
    """Motion of the camera itself: P = rotation P_0 + translation_m at each instant, P_0 in the camera frame at t_0."""

    rotation: Float64[Array, "instant 3 3"]
    translation_m: Float64[Array, "instant xyz=3"]
    wrt_errors: Float64[Array, "instant 6 error"]
    """Rotation vector (rad) and translation (m) by which errors displace what is seen; zero at t_0."""


class RingSamples(NamedTuple):
    """What a shot sees of a ring: samples on stripes (ends of lines, then break points) and visible edge points."""

    rays: Float64[Array, "sample xyz=3"]
    light_normal: Float64[Array, "sample xyz=3"]
    light_distance_m: Float64[Array, "sample"]
    ends: int
    """Number of the samples that are ends of lines."""
    visible_rays: Float64[Array, "visible xyz=3"]
    visible_step: Float64[Array, "visible xy=2"]
    """Displacement of the visible edge points by one standard deviation, along the edge's normal in the image."""
    edge_sign: Float64[Array, "point"]
    """-1 for a point on the inner edge, +1 for one on the outer edge: of break points, then of visible points."""
    instant_s: Float64[Array, "instant"]
    """Mid exposures of the frames, from the reference time."""
    instant: Int64[Array, "row"]
    """Index of the instant of each sample, and of each visible point."""
    camera: CameraDisplacements | None = None
    """None for a camera that counts as inertial."""


class RingPrediction(NamedTuple):
    """What a view shows of a ring, with derivatives by the ring's step at t_0 (`wrt_step`).

    These are followed by derivatives with respect to the rates, as in `motion_derivatives`, and to the errors of the
    camera's motion; there are no such columns for a ring and a camera at rest.
    """

    arcs: RingArcs
    """The ring at the reference time."""
    stripes: StripePrediction
    edges: EdgeDistances
    """Distances of the predicted stripes at the abscissae of the break points, then of the visible edge points."""


def predicted_view(arcs: RingArcs, view: RingSamples, rates: Rates | None) -> RingPrediction:
    """The prediction of a view of a ring that is `arcs` at the reference time and moves at `rates` (None: still)."""
    moves = rates is not None or view.camera is not None
    of_samples = of_edges = arcs
    if moves:
        rings, derivatives = _at_instants(arcs, view, rates)
        of_samples = rings.at_rows(view.instant[: len(view.rays)])
        of_edges = rings.at_rows(view.instant[view.ends :])
    stripes = predicted_stripes(of_samples, view.rays[:, 0], view.light_normal, view.light_distance_m)
    rays = stripes.rays[view.ends :]
    if len(view.visible_rays):
        rays = np.concatenate([rays, view.visible_rays])
    edges = edge_distances(of_edges, rays, view.edge_sign)
    if len(view.visible_rays):
        edges = _linearized_on_edges(edges, of_edges, rays, view)
    if moves:
        wrt_step = np.concatenate([stripes.y_wrt_step, edges.wrt_step])
        instant = np.concatenate([view.instant[: len(view.rays)], view.instant[view.ends :]])
        wrt_all = (wrt_step[:, None] @ derivatives[instant])[:, 0]
        stripes = stripes._replace(y_wrt_step=wrt_all[: len(view.rays)])
        edges = edges._replace(wrt_step=wrt_all[len(view.rays) :])
    return RingPrediction(arcs, stripes, edges)


def _linearized_on_edges(
    measured: EdgeDistances, arcs: RingArcs, rays: Float64[Array, "n xyz=3"], view: RingSamples
) -> EdgeDistances:
    """The distances of visible points, linearised at the predicted edge along the direction of the points' errors.

    Derivatives at the measured points would be correlated with the points' errors, which biases what many shots have in
    common.
    """
    step = np.zeros((len(rays), 2))
    step[-len(view.visible_step) :] = view.visible_step
    rate = (measured.wrt_ray * step).sum(axis=1)
    offset = np.divide(measured.distance_m, rate, out=np.zeros(len(rays)), where=np.abs(rate) > TINY)
    on_edge = rays.copy()
    on_edge[:, :2] -= offset[:, None] * step
    predicted = edge_distances(arcs, on_edge, view.edge_sign)
    along_step = offset * (predicted.wrt_ray * step).sum(axis=1)
    return predicted._replace(distance_m=predicted.distance_m + along_step)


def _at_instants(
    arcs: RingArcs, view: RingSamples, rates: Rates | None
) -> tuple[RingArcs, Float64[Array, "instant step=7 parameter"]]:
    """The ring at each instant in the camera frame of that instant, and the derivatives of its increments.

    They are increments along the ring's own axes, which a motion of the camera leaves as they are.
    """
    velocity_m_s, rate_rad_s = (np.zeros(3), np.zeros(3)) if rates is None else rates
    rings = arcs.predict(view.instant_s, velocity_m_s, rate_rad_s)
    derivatives = motion_derivatives(arcs, rings, view.instant_s)
    derivatives = derivatives[..., : len(STEP)] if rates is None else derivatives
    if view.camera is not None:
        rotation = view.camera.rotation
        rings = RingArcs(
            origin=(rotation @ rings.origin[..., None])[..., 0] + view.camera.translation_m,
            axes=rings.axes @ rotation.swapaxes(-1, -2),
            curvature=arcs.curvature,
            half_band_m=arcs.half_band_m,
        )
        wrt_errors = displacement_increments(rings) @ view.camera.wrt_errors
        derivatives = np.concatenate([derivatives, wrt_errors], axis=-1)
    return rings, derivatives


def displacement_increments(rings: RingArcs) -> Float64[Array, "*instant step=7 6"]:
    """Increments (`STEP`) by a small displacement of the camera frame: rotation vector (rad), translation (m).

    P becomes P + turn x P + shift. A displacement along the face is expressed as the turn that slides the origin back.
    """
    axes, origin = rings.axes, rings.origin
    jacobian = np.zeros((*origin.shape[:-1], len(STEP), 6))
    # a . (turn x n) = turn . (n x a), with along = n x inward
    jacobian[..., TILT_INWARD, :3], jacobian[..., TILT_ALONG, :3] = axes[..., 1, :], -axes[..., 0, :]
    jacobian[..., TURN, :3] = axes[..., 2, :]
    of_origin = np.concatenate([np.cross(origin[..., None, :], axes), axes], axis=-1)  # a . (turn x o + shift)
    jacobian[..., LIFT, :], jacobian[..., SHIFT, :] = of_origin[..., 2, :], of_origin[..., 0, :]
    jacobian[..., TURN, :] += rings.curvature * of_origin[..., 1, :]
    return jacobian


# Parameters of the records


def public_wrt_step(arcs: RingArcs, basis: Float64[Array, "2 xyz=3"]) -> Float64[Array, "parameter=7 step=7"]:
    """Derivatives of tilt_1, tilt_2, offset_m, center_1_m, center_2_m, radius_inner_m, radius_outer_m.

    They are increments: dn = tilt_1 e1 + tilt_2 e2 with the tilt basis of the normal, and centre
    c = offset n + center_1 e1 + center_2 e2, where e1 and e2 tilt with the normal, Eq. (8.3).
    """
    inward, along, normal = arcs.axes
    radius_m, center = arcs.mean_radius_m, arcs.center
    normal_wrt_step = np.zeros((3, len(STEP)))
    normal_wrt_step[:, TILT_INWARD], normal_wrt_step[:, TILT_ALONG] = inward, along
    jacobian = np.empty((7, len(STEP)))
    jacobian[:5] = plane_and_center(normal, center, normal_wrt_step, center_wrt_step(arcs), basis)
    jacobian[5:] = 0.0
    jacobian[5:, CURVATURE] = -(radius_m**2)
    jacobian[5:, HALF_BAND] = EDGE_SIGN
    return jacobian


def center_wrt_step(arcs: RingArcs) -> Float64[Array, "xyz=3 step=7"]:
    """Derivatives of the centre, origin + inward / curvature."""
    inward, along, normal = arcs.axes
    radius_m = arcs.mean_radius_m
    jacobian = np.zeros((3, len(STEP)))
    jacobian[:, TILT_INWARD] = -radius_m * normal
    jacobian[:, LIFT] = normal
    jacobian[:, SHIFT] = inward
    jacobian[:, TURN] = radius_m * along
    jacobian[:, CURVATURE] = -(radius_m**2) * inward
    return jacobian


def public_wrt_rates(
    normal: Float64[Array, "xyz=3"], center_m: Float64[Array, "xyz=3"], basis: Float64[Array, "2 xyz=3"]
) -> Float64[Array, "parameter=7 rate=5"]:
    """Change of the records' seven parameters (tilts, offset, centre in the plane, radii) per second of motion.

    Columns: velocity x, y, z, and the rates about the tilt basis e1, e2 of the normal; Eq. (8.2) of method(7).
    dc/dv = 1, dn/dw_1 = -e2, dn/dw_2 = e1; the ring turns about its own centre.
    """
    e1, e2 = basis
    normal_wrt_rates, center_wrt_rates = np.zeros((3, 5)), np.zeros((3, 5))
    normal_wrt_rates[:, 3], normal_wrt_rates[:, 4] = -e2, e1
    center_wrt_rates[:, :3] = np.eye(3)
    jacobian = np.zeros((7, 5))
    jacobian[:5] = plane_and_center(normal, center_m, normal_wrt_rates, center_wrt_rates, basis)
    return jacobian


def plane_and_center(
    normal: Float64[Array, "xyz=3"],
    center_m: Float64[Array, "xyz=3"],
    normal_wrt: Float64[Array, "xyz=3 n"],
    center_wrt: Float64[Array, "xyz=3 n"],
    basis: Float64[Array, "2 xyz=3"],
) -> Float64[Array, "parameter=5 n"]:
    """Derivatives of tilts, offset and in-plane centre from those of normal and centre, Eq. (8.3).

    `basis`: the tilt basis of the normal, as below.
    """
    tilts = basis @ normal_wrt
    offset = normal @ center_wrt + center_m @ normal_wrt
    in_plane = basis @ center_wrt - float(normal @ center_m) * tilts
    return np.concatenate([tilts, offset[None], in_plane])


def normal_and_center(
    normal: Float64[Array, "xyz=3"], center_m: Float64[Array, "xyz=3"]
) -> tuple[Float64[Array, "xyz=3 parameter=5"], Float64[Array, "xyz=3 parameter=5"]]:
    """Derivatives of normal and centre by tilts, offset and in-plane centre: the inverse of `plane_and_center`."""
    basis, offset_m = tilt_basis(normal), float(normal @ center_m)
    normal_wrt, center_wrt = np.zeros((3, 5)), np.zeros((3, 5))
    normal_wrt[:, :2] = basis.T
    center_wrt[:, :2] = offset_m * basis.T - np.outer(normal, basis @ center_m)
    center_wrt[:, 2], center_wrt[:, 3:] = normal, basis.T
    return normal_wrt, center_wrt
