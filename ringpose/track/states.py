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

from ringpose.geometry.ring import CURVATURE, HALF_BAND, LIFT, MIN_CURVATURE, SHIFT, STEP, TILT_ALONG, TILT_INWARD, TURN
from ringpose.types.arrays import Array, Float64

MOTION = (
    "velocity_inward_m_s", "velocity_along_m_s", "velocity_normal_m_s",
    "rate_inward_rad_s", "rate_along_rad_s", "rate_normal_rad_s", "lever_m",
)  # fmt: skip
"""Motion of a state, along its own axes: of the body's point at the origin, without the rotation about the normal;
angular velocity; distance of the centre of mass behind the ring."""

ERRORS = (*STEP, *MOTION)
"""Components of the error of a state: increments that `moved` applies."""

VELOCITY, RATE, LEVER = slice(7, 10), slice(10, 13), 13
RATE_INWARD, RATE_ALONG, RATE_NORMAL = 10, 11, 12
"""Their indices."""

DIFFERENCE = np.array([1e-6, 1e-6, 1e-6, 1e-6, 1e-6, 1e-5, 1e-6, *[1e-5] * 7])
"""Steps of the central differences by which Jacobians are computed: their error is 1e-9 and less."""


class RingStates(NamedTuple):
    """A batch of states."""

    origin: Float64[Array, "state xyz=3"]
    """On the middle of the face, in metres."""
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
        return 1.0 / np.maximum(self.curvature, MIN_CURVATURE)

    @property
    def center_m(self) -> Float64[Array, "state xyz=3"]:
        """Centres of the rings."""
        center_m: Float64[Array, "state xyz=3"] = self.origin + self.mean_radius_m[:, None] * self.axes[:, 0]
        return center_m

    def at(self, index: Array | slice) -> "RingStates":
        """Some of the states."""
        return RingStates(*(part[index] for part in self))

    def repeated(self, count: int) -> "RingStates":
        """Each state `count` times."""
        return RingStates(*(np.repeat(part, count, axis=0) for part in self))


def moved(states: RingStates, errors: Float64[Array, "state error=14"]) -> RingStates:
    """The states after increments (`ERRORS`); those of the ring as in `RingArcs.moved`."""
    k_x, k_y, k_z = errors[:, TILT_ALONG], -errors[:, TILT_INWARD], -errors[:, TURN]
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
        origin=states.origin + errors[:, [LIFT]] * states.axes[:, 2] + errors[:, [SHIFT]] * states.axes[:, 0],
        axes=rotation @ states.axes,
        curvature=states.curvature + errors[:, CURVATURE],
        half_band_m=states.half_band_m + errors[:, HALF_BAND],
        motion=states.motion + errors[:, len(STEP) :],
    )


def after(states: RingStates, time_s: float) -> RingStates:
    """The states after torque-free motion, Eq. (10.1): C + v_C t, and axes rotated by exp([Omega] t)."""
    if time_s == 0.0:
        return states
    radius_m, motion = states.mean_radius_m, states.motion
    rate_in, rate_al, lever_m = motion[:, 3], motion[:, 4], motion[:, 6]
    mass_velocity = mass_center_velocity(states)
    rotation = rotations(motion[:, 3:6] * time_s)
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
    """Velocity of the ring's centre, along the ring's axes: u + R w x inward."""
    velocity: Float64[Array, "state local=3"] = states.motion[:, :3].copy()
    velocity[:, 2] -= states.mean_radius_m * states.motion[:, 4]
    return velocity


def mass_center_velocity(states: RingStates) -> Float64[Array, "state local=3"]:
    """Velocity of the centre of mass, along the ring's axes: that of the ring's centre - l w x n."""
    velocity, lever_m = center_velocity(states), states.motion[:, 6]
    velocity[:, 0] -= lever_m * states.motion[:, 4]
    velocity[:, 1] += lever_m * states.motion[:, 3]
    return velocity


def rotations(vectors_rad: Float64[Array, "n 3"]) -> Float64[Array, "n 3 3"]:
    """Rotation matrices of rotation vectors (Rodrigues)."""
    angle = np.sqrt((vectors_rad * vectors_rad).sum(axis=1))
    skew = np.zeros((len(angle), 3, 3))
    x, y, z = vectors_rad.T
    skew[:, 0, 1], skew[:, 0, 2], skew[:, 1, 2] = -z, y, -x
    skew[:, 1, 0], skew[:, 2, 0], skew[:, 2, 1] = z, -y, x
    first = np.sinc(angle / np.pi)[:, None, None]
    second = 0.5 * np.sinc(angle / (2 * np.pi))[:, None, None] ** 2
    rotation: Float64[Array, "n 3 3"] = np.eye(3) + first * skew + second * (skew @ skew)
    return rotation


class Relative(NamedTuple):
    """Rings as seen from a reference, with the same rings described about the reference's place."""

    errors: Float64[Array, "state step=7"]
    """Increments (`STEP`) that lead from the reference to each ring; NaN for a ring that misses the place."""
    states: RingStates
    """The same states with their origins in the reference's plane across the face."""
    axes: Float64[Array, "state 3 local=3"]
    """Inward, along, normal (those of the side's description), along the axes of the reference."""
    side: Float64[Array, "state"]
    """-1 for a ring whose centre is on the other side."""


def relative(
    origin: Float64[Array, "#state xyz=3"],
    axes: Float64[Array, "#state 3 xyz=3"],
    curvature: Float64[Array, "#state"],
    half_band_m: Float64[Array, "#state"],
    states: RingStates,
) -> Relative:
    """The inverse of `moved`, for rings whose origin may be anywhere on their face.

    A ring's new origin is where the middle of its face crosses the plane through the reference's origin that is
    perpendicular to `along`. If its centre is on the other side than the reference's, it is described with inner and
    outer edge exchanged and a negative curvature, as in `RingArcs.with_center_opposite`.
    """
    radius_m = states.mean_radius_m
    local = states.axes @ axes.swapaxes(1, 2)  # the states' axes along those of the reference
    center = ((states.origin - origin)[:, None] @ axes.swapaxes(1, 2))[:, 0] + radius_m[:, None] * local[:, 0]
    n_x, n_y, n_z = local[:, 2].T
    # the line where the ring's plane crosses the plane y = 0: direction (d_x, 0, d_z), at -c_y / h from the centre
    across = np.sqrt(n_x * n_x + n_z * n_z)
    d_x, d_z = n_z / across, -n_x / across
    distance = -center[:, 1] / across
    with np.errstate(invalid="ignore"):
        side = np.where(local[:, 0, 0] < 0.0, -1.0, 1.0)
        root = side * np.sqrt(radius_m * radius_m - distance * distance)
    inward = np.stack(
        [
            (root * d_x - distance * n_y * d_z) / radius_m,
            -distance * across / radius_m,
            (root * d_z + distance * n_y * d_x) / radius_m,
        ],
        axis=1,
    )
    place = center - radius_m[:, None] * inward
    i_x, i_y, i_z = inward.T
    along = np.stack([n_y * i_z - n_z * i_y, n_z * i_x - n_x * i_z, n_x * i_y - n_y * i_x], axis=1)

    # Cayley's inverse, K = 2 (Q - Q^T) / (1 + trace Q), Q = rows inward, along, normal of the side's description
    described_axes = np.stack([side[:, None] * inward, side[:, None] * along, local[:, 2]], axis=1)
    factor = 2.0 / (1.0 + described_axes.trace(axis1=1, axis2=2))
    errors = np.empty((len(radius_m), len(STEP)))
    errors[:, _TURNS] = factor[:, None] * _turns(described_axes)
    errors[:, LIFT], errors[:, SHIFT] = place[:, 2], place[:, 0]
    errors[:, CURVATURE] = side * states.curvature - curvature
    errors[:, HALF_BAND] = states.half_band_m - half_band_m

    # motion along the new axes: they are turned about the normal, and the origin is another point of the body
    cosine, sine = (inward * local[:, 0]).sum(axis=1), (inward * local[:, 1]).sum(axis=1)
    motion = states.motion.copy()
    velocity = center_velocity(states)
    motion[:, 0] = cosine * velocity[:, 0] + sine * velocity[:, 1]
    motion[:, 1] = cosine * velocity[:, 1] - sine * velocity[:, 0]
    motion[:, 3] = cosine * states.motion[:, 3] + sine * states.motion[:, 4]
    motion[:, 4] = cosine * states.motion[:, 4] - sine * states.motion[:, 3]
    motion[:, 2] = velocity[:, 2] + radius_m * motion[:, 4]
    described = RingStates(
        origin=origin + (place[:, None] @ axes)[:, 0],
        axes=np.stack([inward, along, local[:, 2]], axis=1) @ axes,
        curvature=states.curvature,
        half_band_m=states.half_band_m,
        motion=motion,
    )
    return Relative(errors, described, described_axes, side)


_TURNS = (TILT_INWARD, TILT_ALONG, TURN)

MOVING = (TILT_INWARD, TILT_ALONG, LIFT, SHIFT, TURN)
"""Increments (`STEP`) that change by motion."""


def _turns(matrix: Float64[Array, "state 3 3"]) -> Float64[Array, "state 3"]:
    """The components of Q - Q^T that belong to tilt_inward, tilt_along and turn."""
    skew = matrix - matrix.swapaxes(1, 2)
    return np.stack([skew[:, 2, 0], skew[:, 2, 1], skew[:, 0, 1]], axis=1)


def step_rates(found: Relative) -> Float64[Array, "state 5"]:
    """Derivatives of the increments `MOVING` by time, from the motion of the states.

    The place on the face slides along it, so as to stay in the reference's plane, which turns the axes.
    """
    states, axes = found.states, found.axes
    flip = np.ones((len(found.side), 3))
    flip[:, 0] = flip[:, 1] = found.side  # components along the axes of the side's description
    velocity = ((flip * states.motion[:, :3])[:, None] @ axes)[:, 0]
    slide = -velocity[:, 1] / axes[:, 1, 1]
    velocity += slide[:, None] * axes[:, 1]
    turn = np.zeros((len(slide), 3, 3))  # derivative of the axes, in rows: w x axis, and the slide's turn
    rate_in, rate_al = flip[:, 0] * states.motion[:, 3], flip[:, 0] * states.motion[:, 4]
    about = slide * found.side / states.mean_radius_m
    turn[:, 0, 1], turn[:, 1, 0] = -about, about
    turn[:, 0, 2], turn[:, 2, 0] = -rate_al, rate_al
    turn[:, 1, 2], turn[:, 2, 1] = rate_in, -rate_in
    change = turn @ axes
    scale = 1.0 + axes.trace(axis1=1, axis2=2)
    rates = np.empty((len(slide), len(MOVING)))
    turning = 2.0 * _turns(change) - found.errors[:, _TURNS] * change.trace(axis1=1, axis2=2)[:, None]
    rates[:, [0, 1, 4]] = turning / scale[:, None]
    rates[:, 2], rates[:, 3] = velocity[:, 2], velocity[:, 0]
    return rates


def difference(reference: RingStates, states: RingStates) -> Float64[Array, "state error=14"]:
    """Increments (`ERRORS`) that lead from the reference states to others: the inverse of `moved`."""
    found = relative(reference.origin, reference.axes, reference.curvature, reference.half_band_m, states)
    return np.concatenate([found.errors, found.states.motion - reference.motion], axis=1)


def perturbed(states: RingStates) -> RingStates:
    """Each state with a positive and a negative step (`DIFFERENCE`) in each of its components, in this order."""
    steps = np.concatenate([np.diag(DIFFERENCE), -np.diag(DIFFERENCE)])
    return moved(states.repeated(len(steps)), np.tile(steps, (len(states.curvature), 1)))


def jacobians(values: Float64[Array, "n value"]) -> Float64[Array, "state value error=14"]:
    """Derivatives of values by the errors of states, from the values at the `perturbed` states."""
    both = values.reshape(-1, 2, len(ERRORS), values.shape[1])
    slopes: Float64[Array, "state error value"] = (both[:, 0] - both[:, 1]) / (2.0 * DIFFERENCE)[:, None]
    return slopes.swapaxes(1, 2)
