"""The motion models of a bank: constant velocity and torque-free precession, with white accelerations."""

from typing import NamedTuple

import numpy as np

from ringpose.geometry.ring import CURVATURE, MIN_CURVATURE
from ringpose.track.states import ERRORS, LEVER, RATE, RATE_ALONG, RATE_INWARD, VELOCITY, RingStates
from ringpose.types.arrays import Array, Bool, Float64

PROCESS_NOISE = (1e-8, 1e-6, 1e-4)
"""Power spectral densities from which those of velocity (m^2/s^3) and angular velocity (rad^2/s^3) are chosen."""

TORQUE_FREE_SHARE = 0.1
"""Process noise of the angular velocity in the precession model, by that of the constant-velocity model."""

LEAST_NOISE_LOG_PRIOR = -2.0
"""Log prior weight of the models with the least acceleration, and of those with the least angular acceleration: within
seconds single shots hardly show that of the next value, so that half of its tracks would be predicted with too small
errors."""

LEVER_M, LEVER_SD_M = 1.0, 1.0
"""Prior of the distance of the centre of mass behind the ring."""

LEFT_OUT_S = 1.0
"""Constant-velocity models leave out precession: angular accelerations of the order of the rate squared, and those of
the centre, which is a lever away from the mass. Their process noise has the same effect over this time."""

ASYMMETRY = 0.03
"""Share of these accelerations that the precession models leave out: the body is not exactly symmetric."""


class MotionModels(NamedTuple):
    """The models of a bank, one filter each."""

    velocity_noise: Float64[Array, "filter"]
    """Power spectral density of the acceleration of the centre (of mass), m^2/s^3 per axis."""
    rate_noise: Float64[Array, "filter"]
    """Power spectral density of the angular acceleration, rad^2/s^3 per axis."""
    precession: Bool[Array, "filter"]
    log_prior: Float64[Array, "filter"]
    """Logarithms of their weights before the first measurement."""


def motion_models() -> MotionModels:
    """Nine constant-velocity models and three of torque-free precession."""
    pairs = [(q_v, q_w) for q_v in PROCESS_NOISE for q_w in PROCESS_NOISE]
    pairs += [(q_v, TORQUE_FREE_SHARE * q_v) for q_v in PROCESS_NOISE]
    precession = np.arange(len(pairs)) >= len(PROCESS_NOISE) ** 2
    is_counted = np.stack([~precession, np.full(len(pairs), True)], axis=1)
    return MotionModels(
        velocity_noise=np.array([q_v for q_v, _ in pairs]),
        rate_noise=np.array([q_w for _, q_w in pairs]),
        precession=precession,
        log_prior=LEAST_NOISE_LOG_PRIOR * ((np.array(pairs) <= PROCESS_NOISE[0]) * is_counted).sum(axis=1),
    )


MODELS = motion_models()


def process_noise(
    models: MotionModels,
    chart: RingStates,
    coordinates: Float64[Array, "filter error=14"],
    transition: Float64[Array, "filter error=14 error=14"],
    time_s: float,
) -> Float64[Array, "filter error=14 error=14"]:
    """Covariance of what white accelerations add within `time_s`: the integral of Phi(t) G q G^T Phi(t)^T.

    Phi(t) is taken as linear in t. Accelerations are those of the centre of mass and of the angular velocity; the
    latter moves the origin too.
    """
    gain = np.zeros((len(coordinates), len(ERRORS), 6))
    gain[:, VELOCITY, :3] = np.eye(3)
    gain[:, RATE, 3:] = np.eye(3)
    lever_m = coordinates[:, LEVER]
    gain[:, 7, 4], gain[:, 8, 3] = lever_m, -lever_m
    gain[:, 9, 4] = 1.0 / np.maximum(chart.curvature + coordinates[:, CURVATURE], MIN_CURVATURE)
    density = np.repeat(np.stack([models.velocity_noise, models.rate_noise], axis=1), 3, axis=1)
    share = np.where(models.precession, ASYMMETRY, 1.0)
    left_out = share * (coordinates[:, RATE_INWARD] ** 2 + coordinates[:, RATE_ALONG] ** 2)
    density[:, :3] += LEFT_OUT_S * (LEVER_M * left_out[:, None]) ** 2
    density[:, 3:] += LEFT_OUT_S * left_out[:, None] ** 2
    density[~models.precession, 5] = 0.0
    gain *= np.sqrt(density * time_s)[:, None]
    later = (transition @ gain) - gain
    both = later @ gain.swapaxes(1, 2)
    noise: Float64[Array, "filter error error"] = (
        gain @ gain.swapaxes(1, 2) + 0.5 * (both + both.swapaxes(1, 2)) + later @ later.swapaxes(1, 2) / 3.0
    )
    return noise
