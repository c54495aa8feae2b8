"""States of a moving ring, many at a time: the manifold of the filters, and rigid motion on it.

A ring is described as in `ringpose.geometry.ring`: by arcs about a point of its face near which it is seen, because
there the measurements are nearly linear and the filter's covariance does not gain false information from
relinearisation; centre and radii follow from it. Velocities are components along the ring's own axes, for the same
reason. One motion serves both models (ringpose-method(7), section 10): a body whose centre of mass lies `lever_m`
behind the ring, moves at a constant velocity and precesses at a constant angular velocity. Constant velocity of the
ring is the case of no lever and no precession about the normal.
"""

from typing import NamedTuple

import numpy as np

from ringpose.geometry import ring
from ringpose.types.arrays import Array, Float64

MOTION = (
    "velocity_inward_m_s", "velocity_along_m_s", "velocity_normal_m_s",
    "rate_inward_rad_s", "rate_along_rad_s", "rate_normal_rad_s", "lever_m",
)  # fmt: skip
"""Motion of a state, along its own axes: of the body's point at the origin, without the rotation about the normal;
angular velocity; distance of the centre of mass behind the ring."""

ERRORS = (*ring.STEP, *MOTION)
"""Components of the error of a state: increments that `retract` applies."""

VELOCITY, RATE, LEVER = slice(7, 10), slice(10, 13), 13
RATE_INWARD, RATE_ALONG, RATE_NORMAL = 10, 11, 12
"""Indices of these components in `ERRORS`."""

DIFFERENCE = np.array([1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 1e-5, 1e-6, *[1e-5] * 7])
"""Steps of the central differences by which Jacobians are computed: their error is 1e-9 and less."""


class RingStates(NamedTuple):
    """A batch of states."""

    origin: Float64[Array, "state xyz=3"]
    """Points on the middle of the faces, in metres."""
    axes: Float64[Array, "state 3 xyz=3"]
    """Unit vectors: inward (towards the centre), along the face, and the normal towards the camera."""
    curvature: Float64[Array, "state"]
    """Inverse of the mean radius in 1/m."""
    half_band_m: Float64[Array, "state"]
    motion: Float64[Array, "state motion=7"]
    """See `MOTION`."""

    @property
    def mean_radius_m(self) -> Float64[Array, "state"]:
        """Radius of the middle of the face; bounded by 1 / `MIN_CURVATURE`."""
        return 1.0 / np.maximum(self.curvature, ring.MIN_CURVATURE)

    @property
    def center_m(self) -> Float64[Array, "state xyz=3"]:
        """Centres of the rings."""
        center_m: Float64[Array, "state xyz=3"] = self.origin + self.mean_radius_m[:, None] * self.axes[:, 0]
        return center_m


def retract(states: RingStates, errors: Float64[Array, "state error=14"]) -> RingStates:
    """The states, or one state, after increments (`ERRORS`); those of the ring as in `RingArcs.retract`."""
    k_x, k_y, k_z = errors[:, ring.TILT_ALONG], -errors[:, ring.TILT_INWARD], -errors[:, ring.TURN]
    # Cayley's transform I + (K + K^2 / 2) / (1 + k^2 / 4)
    share = 1.0 / (1.0 + 0.25 * (k_x * k_x + k_y * k_y + k_z * k_z))
    half = 0.5 * share
    rotation = np.empty((len(errors), 3, 3))
    rotation[:, 0, 0] = 1.0 - half * (k_y * k_y + k_z * k_z)
    rotation[:, 1, 1] = 1.0 - half * (k_x * k_x + k_z * k_z)
    rotation[:, 2, 2] = 1.0 - half * (k_x * k_x + k_y * k_y)
    for row, column, symmetric, skew in ((0, 1, k_x * k_y, -k_z), (0, 2, k_x * k_z, k_y), (1, 2, k_y * k_z, -k_x)):
        rotation[:, row, column] = half * symmetric + share * skew
        rotation[:, column, row] = half * symmetric - share * skew
    return RingStates(
        origin=states.origin
        + errors[:, ring.LIFT, None] * states.axes[:, 2]
        + errors[:, ring.SHIFT, None] * states.axes[:, 0],
        axes=rotation @ states.axes,
        curvature=states.curvature + errors[:, ring.CURVATURE],
        half_band_m=states.half_band_m + errors[:, ring.HALF_BAND],
        motion=states.motion + errors[:, len(ring.STEP) :],
    )


def predict_states(states: RingStates, time_s: float) -> RingStates:
    """The states after torque-free motion, Eq. (10.1): C + v_C t, and axes rotated by exp([Omega] t)."""
    if time_s == 0.0:
        return states
    radius_m, motion = states.mean_radius_m, states.motion
    rate_in, rate_al, lever_m = motion[:, 3], motion[:, 4], motion[:, 6]
    mass_velocity = mass_center_velocity(states)
    rotation = ring.rotation_by(motion[:, 3:6] * time_s)
    # the origin's displacement along the axes at the start: C = (R, 0, -l), o = C + l n - R inward
    displacement = mass_velocity * time_s
    displacement[:, 0] += radius_m
    displacement[:, 2] -= lever_m
    displacement += lever_m[:, None] * rotation[:, :, 2] - radius_m[:, None] * rotation[:, :, 0]
    velocity = (mass_velocity[:, None] @ rotation)[:, 0]
    velocity[:, 0] += lever_m * rate_al
    velocity[:, 1] -= lever_m * rate_in
    velocity[:, 2] += radius_m * rate_al
    return states._replace(
        origin=states.origin + (displacement[:, None] @ states.axes)[:, 0],
        axes=rotation.swapaxes(1, 2) @ states.axes,
        motion=np.concatenate([velocity, motion[:, 3:]], axis=1),
    )


def center_velocity(states: RingStates) -> Float64[Array, "state local=3"]:
    """Velocity of the ring's centre, along the ring's axes: that of the origin + R w x inward (radius R, rate w)."""
    velocity: Float64[Array, "state local=3"] = states.motion[:, :3].copy()
    velocity[:, 2] -= states.mean_radius_m * states.motion[:, 4]
    return velocity


def mass_center_velocity(states: RingStates) -> Float64[Array, "state local=3"]:
    """Velocity of the centre of mass, along the ring's axes: that of the ring's centre - l w x n (lever l, rate w)."""
    velocity, lever_m = center_velocity(states), states.motion[:, 6]
    velocity[:, 0] -= lever_m * states.motion[:, 4]
    velocity[:, 1] += lever_m * states.motion[:, 3]
    return velocity


class LocalCoordinates(NamedTuple):
    """States described relative to another state, the chart: `retract(chart, coordinates)` gives the states back."""

    coordinates: Float64[Array, "state error=14"]
    """NaN for a ring that misses the chart's place."""
    axes: Float64[Array, "state 3 local=3"]
    """Inward, along, normal, along the axes of the chart."""


def local_coordinates(chart: RingStates, states: RingStates) -> LocalCoordinates:
    """The inverse of `retract(chart, ...)` for one chart, whose motion is 0, and rings with an origin anywhere.

    A ring's origin moves along its face to the plane through the chart's origin that is perpendicular to `along`.
    """
    radius_m, to_chart = states.mean_radius_m, chart.axes[0].T
    local = states.axes @ to_chart
    center = (states.origin - chart.origin) @ to_chart + radius_m[:, None] * local[:, 0]
    n_x, n_y, n_z = local[:, 2].T
    # the line where the ring's plane crosses the plane y = 0: direction (d_x, 0, d_z), at -c_y / h from the centre
    across = np.sqrt(n_x * n_x + n_z * n_z)
    d_x, d_z = n_z / across, -n_x / across
    distance = -center[:, 1] / (across * radius_m)
    with np.errstate(invalid="ignore"):
        root = np.sqrt(1.0 - distance * distance)
    axes = np.empty_like(local)
    axes[:, 0, 0] = i_x = root * d_x - distance * n_y * d_z
    axes[:, 0, 1] = i_y = -distance * across
    axes[:, 0, 2] = i_z = root * d_z + distance * n_y * d_x
    axes[:, 1, 0], axes[:, 1, 1], axes[:, 1, 2] = n_y * i_z - n_z * i_y, n_z * i_x - n_x * i_z, n_x * i_y - n_y * i_x
    axes[:, 2] = local[:, 2]

    coordinates = np.empty((len(radius_m), len(ERRORS)))
    # Cayley's inverse, K = 2 (Q - Q^T) / (1 + trace Q)
    factor = 2.0 / (1.0 + i_x + axes[:, 1, 1] + n_z)
    coordinates[:, ring.TILT_INWARD] = factor * (n_x - i_z)
    coordinates[:, ring.TILT_ALONG] = factor * (n_y - axes[:, 1, 2])
    coordinates[:, ring.TURN] = factor * (i_y - axes[:, 1, 0])
    coordinates[:, ring.SHIFT], coordinates[:, ring.LIFT] = center[:, 0] - radius_m * i_x, center[:, 2] - radius_m * i_z
    coordinates[:, ring.CURVATURE] = states.curvature - chart.curvature
    coordinates[:, ring.HALF_BAND] = states.half_band_m - chart.half_band_m

    # motion along the new axes: they are turned about the normal, and the origin is another point of the body
    cosine, sine = (axes[:, 0] * local[:, 0]).sum(axis=1), (axes[:, 0] * local[:, 1]).sum(axis=1)
    velocity, rate = center_velocity(states), states.motion
    coordinates[:, 7] = cosine * velocity[:, 0] + sine * velocity[:, 1]
    coordinates[:, 8] = cosine * velocity[:, 1] - sine * velocity[:, 0]
    coordinates[:, RATE_INWARD] = cosine * rate[:, 3] + sine * rate[:, 4]
    coordinates[:, RATE_ALONG] = cosine * rate[:, 4] - sine * rate[:, 3]
    coordinates[:, 9] = velocity[:, 2] + radius_m * coordinates[:, RATE_ALONG]
    coordinates[:, RATE_NORMAL:] = rate[:, 5:]
    return LocalCoordinates(coordinates, axes)


MOVING = (ring.TILT_INWARD, ring.TILT_ALONG, ring.LIFT, ring.SHIFT, ring.TURN)
"""Increments (`STEP`) that change by motion."""


def step_rates(chart: RingStates, local: LocalCoordinates) -> Float64[Array, "state 5"]:
    """Derivatives of the coordinates `MOVING` by time, from the motion of the states.

    The place on the face slides along it, so as to stay in the chart's plane, which turns the axes.
    """
    motion, axes = local.coordinates[:, 7:], local.axes
    velocity = (motion[:, None, :3] @ axes)[:, 0]
    slide = -velocity[:, 1] / axes[:, 1, 1]
    velocity += slide[:, None] * axes[:, 1]
    about = slide * np.maximum(chart.curvature + local.coordinates[:, ring.CURVATURE], ring.MIN_CURVATURE)
    inward, along, normal = axes[:, 0], axes[:, 1], axes[:, 2]
    # derivatives of the axes: w x axis, and the turn of the slide
    rate_in, rate_al = motion[:, 3, None], motion[:, 4, None]
    d_inward = -about[:, None] * along - rate_al * normal
    d_along = about[:, None] * inward + rate_in * normal
    d_normal = rate_al * inward - rate_in * along
    scale = 1.0 / (1.0 + inward[:, 0] + along[:, 1] + normal[:, 2])
    trace = (d_inward[:, 0] + d_along[:, 1] + d_normal[:, 2]) * scale
    rates = np.empty((len(slide), len(MOVING)))
    rates[:, 0] = 2.0 * scale * (d_normal[:, 0] - d_inward[:, 2]) - trace * local.coordinates[:, ring.TILT_INWARD]
    rates[:, 1] = 2.0 * scale * (d_normal[:, 1] - d_along[:, 2]) - trace * local.coordinates[:, ring.TILT_ALONG]
    rates[:, 2], rates[:, 3] = velocity[:, 2], velocity[:, 0]
    rates[:, 4] = 2.0 * scale * (d_inward[:, 1] - d_along[:, 0]) - trace * local.coordinates[:, ring.TURN]
    return rates


STEPS = np.concatenate([np.diag(DIFFERENCE), -np.diag(DIFFERENCE)])
"""Positive and negative steps in each coordinate."""


def perturbed(coordinates: Float64[Array, "state error=14"]) -> Float64[Array, "perturbed error=14"]:
    """Each state's coordinates after each of the `STEPS`, for derivatives by central differences."""
    around: Float64[Array, "perturbed error"] = (coordinates[:, None] + STEPS).reshape(-1, len(ERRORS))
    return around


def jacobians(values: Float64[Array, "perturbed value"]) -> Float64[Array, "state value error=14"]:
    """Derivatives of values by coordinates, from the values at the `perturbed` coordinates."""
    both = values.reshape(-1, 2, len(ERRORS), values.shape[1])
    slopes: Float64[Array, "state error value"] = (both[:, 0] - both[:, 1]) / (2.0 * DIFFERENCE)[:, None]
    return slopes.swapaxes(1, 2)
