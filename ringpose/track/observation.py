"""A record's measurement as the filters use it (ringpose-method(7), section 9).

The measurement is linear in the records' twelve parameters only near its linearisation point. Expressed in the
increments of arcs about the place where the ring was seen, it remains valid much farther from it.
"""

from dataclasses import dataclass, replace
from math import sqrt

import numpy as np

from ringpose.estimate.information import POSE, RATES
from ringpose.geometry import ring
from ringpose.geometry.camera_motion import CameraState
from ringpose.geometry.rotations import tilt_basis
from ringpose.track.common_errors import CommonErrors
from ringpose.track.states import (
    ERRORS,
    MOTION,
    MOVING,
    RATE_ALONG,
    RATE_INWARD,
    RATE_NORMAL,
    STEPS,
    VELOCITY,
    LocalCoordinates,
    RingStates,
    jacobians,
    retract,
    step_rates,
)
from ringpose.types.arrays import Array, Float64
from ringpose.types.pose import MEASURED_PARAMETERS, LinearizationPoint, PoseFlag, PoseLine, RingMeasurement
from ringpose.types.rig import MOUNT_PARAMETERS

BROAD = np.array([1.0, 1.0, 1.0, 1.0, 1.0, 0.3, 0.3, 0.3, 0.3, 0.3, 1.0, 1.0])
"""Standard deviations that stand for no knowledge of the twelve parameters."""

_OPPOSITE = np.array([-1.0, -1.0, 1.0, -1.0, 1.0, -1.0, 1.0])
"""Signs of the increments for arcs that are described with the centre on the other side."""

_PLACES_RAD = np.linspace(0.0, 2.0 * np.pi, 72, endpoint=False)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Observation:
    """A measurement as linear equations with errors of unit variance, one a row.

    `target` = `wrt_step` s + `wrt_step_rates` (ds/dt - `step_rates`) + `wrt_common` q + N(0, 1), where the increments s
    (`STEP`) lead from the arcs to the true ring, and q are the errors that all shots have in common, N(0, 1) too.
    """

    shot: str
    stamp_s: float
    arcs: ring.RingArcs
    """The linearisation point, described about the place where the ring was seen."""
    step_rates: Float64[Array, "5"]
    """Rates of the increments `MOVING` at the linearisation point."""
    wrt_step: Float64[Array, "row step=7"]
    wrt_step_rates: Float64[Array, "row 5"]
    wrt_common: Float64[Array, "row error"]
    common_root: Float64[Array, "parameter rig_error"]
    """Root of the prior covariance by which the independent common errors are defined."""
    target: Float64[Array, "row"]
    of_ring: int
    """Number of rows that depend on the ring; the others depend on common errors alone."""
    determines_plane: bool
    """Whether the shot alone determines the normal; about another normal the rows do not hold, so no track begins."""

    @property
    def chart(self) -> RingStates:
        """The linearisation point as a chart, about which states are described."""
        return _chart(self.arcs)

    def towards(self, inward: Float64[Array, "xyz=3"]) -> "Observation":
        """The observation, described for a ring whose centre lies in the direction `inward`.

        If `inward` is opposite to the present direction, inner and outer edge are exchanged
        (`RingArcs.with_center_opposite`).
        """
        if float(inward @ self.arcs.axes[0]) >= 0.0:
            return self
        return replace(
            self,
            arcs=self.arcs.with_center_opposite(),
            step_rates=self.step_rates * _OPPOSITE[list(MOVING)],
            wrt_step=self.wrt_step * _OPPOSITE,
            wrt_step_rates=self.wrt_step_rates * _OPPOSITE[list(MOVING)],
        )


def observation(
    line: PoseLine,
    measurement: RingMeasurement,
    common: CommonErrors,
    inflation: float,
    camera: CameraState | None = None,
) -> Observation:
    """The measurement of a record as linear equations; `inflation` is a factor on its variances.

    In the frame of the camera, which counts as inertial, or in the base frame if its motion is given.
    """
    at, root = measurement.linearized_at, measurement.square_root / sqrt(inflation)
    near_m = at.center_m + _place_seen(measurement)
    arcs = ring.ring_arcs(at.center_m, at.normal, np.array([at.radius_inner_m, at.radius_outer_m]), near_m)
    count = len(MEASURED_PARAMETERS)
    rows = root[: root.shape[1] - 1]  # what follows is the residual of the shot alone
    # features move with the rates of the increments, which depend on velocity and angular velocity linearly only here
    basis = tilt_basis(at.normal)
    wrt_step = ring.public_wrt_step(arcs, basis)
    rates_wrt_motion = np.linalg.solve(wrt_step, ring.public_wrt_rates(at.normal, at.center_m, basis))[list(MOVING)]
    wrt_step_rates = np.linalg.solve(rates_wrt_motion.T, rows[:, RATES].T).T
    # rows[:, POSE] are derivatives at a given motion of the centre, wrt_step those at given rates of the increments
    step_rates, rates_wrt_step = _rates_near(arcs, at, camera if measurement.camera_motion == "none" else None)
    observed = Observation(
        shot=line.shot,
        stamp_s=line.pose_stamp_s,
        arcs=arcs,
        step_rates=step_rates,
        wrt_step=rows[:, POSE] @ wrt_step - wrt_step_rates @ rates_wrt_step,
        wrt_step_rates=wrt_step_rates,
        wrt_common=rows[:, count:-1] @ common.root_of(measurement.nuisance_parameters),
        common_root=common.root,
        target=rows[:, -1],
        of_ring=min(len(rows), count),
        determines_plane=PoseFlag.NORMAL_WEAK not in line.flags,
    )
    return observed if camera is None else _in_base(observed, camera, common.of_mount)


def _rates_near(
    arcs: ring.RingArcs, at: LinearizationPoint, camera: CameraState | None
) -> tuple[Float64[Array, "5"], Float64[Array, "5 step=7"]]:
    """Rates of the increments `MOVING` at the record's velocities, and their derivatives by the increments.

    The record's velocity is that of the centre; the rates are those of the place seen, a radius away from it. They also
    depend on where the ring is if the motion of a `camera` is added, which the record counts as inertial.
    """
    chart, steps = _chart(arcs), np.concatenate([np.zeros((1, len(ERRORS))), STEPS])
    rings, velocity, rate = retract(chart, steps), at.velocity_m_s, at.rate_rad_s
    if camera is not None:
        center = camera.rotation @ rings.center_m[..., None]
        velocity = velocity + (camera.velocity_m_s + np.cross(camera.rate_rad_s, center[..., 0])) @ camera.rotation
        rate = rate + camera.rate_rad_s @ camera.rotation
    coordinates = steps.copy()
    coordinates[:, RATE_INWARD:RATE_NORMAL] = rings.axes[:, :2] @ rate
    coordinates[:, VELOCITY] = (rings.axes * np.expand_dims(velocity, -2)).sum(axis=-1)
    coordinates[:, VELOCITY.stop - 1] += rings.mean_radius_m * coordinates[:, RATE_ALONG]
    rates = step_rates(chart, LocalCoordinates(coordinates, rings.axes @ chart.axes[0].T))
    return rates[0], jacobians(rates[1:])[0, :, : len(ring.STEP)]


def _chart(arcs: ring.RingArcs) -> RingStates:
    return RingStates(
        origin=arcs.origin[None],
        axes=arcs.axes[None],
        curvature=np.array([arcs.curvature]),
        half_band_m=np.array([arcs.half_band_m]),
        motion=np.zeros((1, len(MOTION))),
    )


def _in_base(observed: Observation, camera: CameraState, of_mount: bool) -> Observation:
    """The observation in the base frame, with errors of the camera's pose, which move the ring with the camera.

    `of_mount`: whether the last common errors are already those of the mount, because they act within the shot, too;
    both effects are then added. Errors of the robot's poses do not: they are nearly the same within a shot, and count
    as the same in all, since poses of a robot that are near each other have nearly the same error.
    """
    origin, axes = camera.rotation @ observed.arcs.origin, observed.arcs.axes @ camera.rotation.T
    from_camera = replace(observed.arcs, origin=origin, axes=axes)  # errors of rotation turn the ring about the camera
    wrt_errors = -observed.wrt_step @ ring.displacement_increments(from_camera) @ camera.displacement_root
    wrt_common = observed.wrt_common
    if of_mount:
        others, within = np.split(wrt_common, [wrt_common.shape[1] - len(MOUNT_PARAMETERS)], axis=1)
        wrt_common, wrt_errors = (
            others,
            wrt_errors + np.pad(within, ((0, 0), (0, wrt_errors.shape[1] - within.shape[1]))),
        )
    arcs = replace(from_camera, origin=camera.origin_m + origin)
    return replace(observed, arcs=arcs, wrt_common=np.concatenate([wrt_common, wrt_errors], axis=1))


def _place_seen(measurement: RingMeasurement) -> Float64[Array, "xyz=3"]:
    """Vector from the centre to the middle of the places on the face where the shot shows how far the ring extends.

    Seen along the ray to a place P, the ring extends farther along e, outward, by e . (dc + offset dt) + dr, as the
    origin of the in-plane coordinates tilts with the plane, less (e . P) / (n . P) times the height doffset - P . dt by
    which the plane rises there. Places count by the inverse of the variance of this. Where edges are visible, it is
    nearly the same along the arc, so that the place of the least variance may be beside the stripes.
    """
    at, count = measurement.linearized_at, len(MEASURED_PARAMETERS)
    rows = measurement.square_root[:, :count] * BROAD
    covariance = np.linalg.inv(rows.T @ rows + np.eye(count)) * BROAD * BROAD[:, None]
    basis, offset_m = tilt_basis(at.normal), float(at.normal @ at.center_m)
    radius_m = 0.5 * (at.radius_inner_m + at.radius_outer_m)
    outward = np.stack([np.cos(_PLACES_RAD), np.sin(_PLACES_RAD)])
    place_m = (basis @ at.center_m)[:, None] + radius_m * outward
    slope = (outward * place_m).sum(axis=0) / offset_m
    wrt_tilt, half = offset_m * outward + slope * place_m, np.full((2, len(_PLACES_RAD)), 0.5)
    weights = np.concatenate([wrt_tilt, -slope[None], outward, half])
    variance = (weights * (covariance[: len(weights), : len(weights)] @ weights)).sum(axis=0)
    middle = outward @ (1.0 / variance)
    place: Float64[Array, "xyz=3"] = radius_m / np.linalg.norm(middle) * middle @ basis
    return place
