"""A bank of error-state Kalman filters for one explanation of a track: motion models that compete by their evidence.

Errors that all shots have in common are considered, not estimated (Schmidt 1966): the error of a state is
e = e_0 + B q, where q ~ N(0, 1) are the common errors, which stay what they are, and e_0 ~ N(0, P) is independent of
them. B and P are carried on exactly for any gain, so that common errors never average out.
"""

from dataclasses import dataclass, replace
from functools import cached_property
from math import pi
from typing import NamedTuple

import numpy as np

from ringpose.geometry.ring import CURVATURE, HALF_BAND, STEP
from ringpose.track.motion_models import LEVER_M, LEVER_SD_M, MODELS, MotionModels, process_noise
from ringpose.track.observation import Observation
from ringpose.track.states import (
    ERRORS,
    LEVER,
    MOTION,
    RATE,
    RATE_ALONG,
    RATE_INWARD,
    RATE_NORMAL,
    VELOCITY,
    LocalCoordinates,
    RingStates,
    jacobians,
    local_coordinates,
    perturbed,
    predict_states,
    retract,
    step_rates,
)
from ringpose.types.arrays import Array, Float64, Int64
from ringpose.types.assumptions import MotionPrior
from ringpose.types.pose import RadiusPrior

CURVATURE_PRIOR, CURVATURE_SD = 1.4, 0.7
"""Curvature of an unknown ring in 1/m: radii from 0.36 m to any length lie within two standard deviations."""

HALF_BAND_SD_M = 0.05

SMOOTHED = 4
"""How often the motion before a measurement is linearised again for the first ones; twice may end between solutions."""

ITERATIONS, ITERATED_UNTIL = 2, 6
"""How often, and until which number of measurements, an update is linearised again."""

MAX_LOG_ODDS = 9.0
"""Largest difference of the evidence of two motion models: a target that looked steady for long may begin to move.

Within this bound the evidence for the models that describe it then takes over within a few shots; the weights that it
leaves to the others are below `NEGLIGIBLE_WEIGHT`.
"""

NEGLIGIBLE_WEIGHT = 1e-3
"""Weight below which a model does not contribute to the reported state."""

PUSH_LOG_ODDS = -4.0
"""Logarithm of the odds that a target is pushed between two measurements."""

MIN_INTERVAL_S = 1e-3
"""Shortest time between two measurements in which a target is assumed to be pushed."""

LOST = -1e6
"""Log likelihood of a measurement for a filter whose ring misses the place where one was seen."""

SAME_WITHIN = 1e-9
"""Relative difference, by rounding, up to which two roots of covariances are the same."""

_PLACE_SD = 1.0
"""Standard deviation in metres and radians of the place of a ring before it is measured."""


@dataclass(frozen=True, kw_only=True, eq=False)  # without slots: `cached_property` needs a place for what it keeps
class Bank:
    """Kalman filters of one explanation, one for each motion model, at one time."""

    stamp_s: float
    models: MotionModels
    chart: RingStates
    """The state about which the others are described: the place where the ring was seen last."""
    coordinates: Float64[Array, "filter error=14"]
    """Increments that lead from the chart to the filters' states."""
    own: Float64[Array, "filter error=14 error=14"]
    """Covariance P of the part of the errors that is independent of the common errors."""
    common: Float64[Array, "filter error=14 source"]
    """Sensitivity B to the common errors, which have unit variance."""
    common_root: Float64[Array, "parameter rig_error"]
    """Root of the prior covariance that defines the common errors."""
    log_evidence: Float64[Array, "filter"]
    measurements: int
    side: int
    """1: the ring's centre is on the side that the first record gave; -1: on the other one."""

    @property
    def states(self) -> RingStates:
        """The filters' states."""
        return retract(self.chart, self.coordinates)

    @property
    def penalized_evidence(self) -> Float64[Array, "filter"]:
        """Log evidence, less the penalty of BIC for the two additional parameters of precession."""
        penalty = np.log(max(self.measurements, 1)) * self.models.precession
        penalized: Float64[Array, "filter"] = self.log_evidence + self.models.log_prior - penalty
        return penalized

    @cached_property
    def scores(self) -> Float64[Array, "filter"]:
        """Penalized evidence, including the probability that the centre of mass is behind the ring, not in front of it.

        Measurements determine the product of lever and precession first: a filter may find the wrong sign of both.
        """
        from scipy.special import log_ndtr

        scores, with_lever = self.penalized_evidence, self.models.precession
        own, common = self.own[with_lever, LEVER, LEVER], self.common[with_lever, LEVER]
        behind = log_ndtr(self.coordinates[with_lever, LEVER] / np.sqrt(own + (common**2).sum(axis=1)))
        scores[with_lever] += np.where(np.isfinite(behind), behind, LOST)  # NaN if the ring is not where one was seen
        return scores

    @property
    def best(self) -> int:
        """The filter with the highest score."""
        return int(np.argmax(self.scores))

    @cached_property
    def weights(self) -> Float64[Array, "filter"]:
        """Probabilities of the models."""
        scores = self.scores
        weights = np.exp(scores - scores.max())
        normalized: Float64[Array, "filter"] = weights / weights.sum()
        return normalized

    @cached_property
    def probable(self) -> "Bank":
        """The bank without filters whose weight is negligible."""
        kept = self.weights > NEGLIGIBLE_WEIGHT
        return replace(
            self,
            models=MotionModels(*(part[kept] for part in self.models)),
            coordinates=self.coordinates[kept],
            own=self.own[kept],
            common=self.common[kept],
            log_evidence=self.log_evidence[kept],
        )

    @property
    def covariance(self) -> Float64[Array, "filter error=14 error=14"]:
        """Covariance of the states' errors, with the common errors included."""
        covariance: Float64[Array, "filter error error"] = self.own + self.common @ self.common.swapaxes(1, 2)
        return covariance


def mixed(bank: Bank) -> tuple[Float64[Array, "error=14"], Float64[Array, "error=14 error=14"]]:
    """Mean and covariance of the states of all filters, weighted by the probabilities of their motion models.

    While the evidence does not decide between models, the covariance includes their disagreement.
    """
    weights = bank.weights
    mean: Float64[Array, "error"] = weights @ bank.coordinates
    apart = bank.coordinates - mean
    covariance: Float64[Array, "error error"] = np.tensordot(weights, bank.covariance, axes=1)
    return mean, covariance + (weights[:, None] * apart).T @ apart


class Innovation(NamedTuple):
    """The difference between a measurement and its prediction by each filter of a bank (innovation)."""

    remaining: Float64[Array, "filter row"]
    jacobian: Float64[Array, "filter row error=14"]
    wrt_common: Float64[Array, "filter row source"]
    covariance: Float64[Array, "filter row row"]
    precision: Float64[Array, "filter row row"]
    """Inverse of the covariance."""
    chi2: Float64[Array, "filter"]
    """Squared Mahalanobis length of the rows that depend on the ring; infinite for a ring that is not there."""
    degrees_of_freedom: int


def initialize(observed: Observation, side: int, motion: MotionPrior, radius: RadiusPrior | None) -> Bank:
    """The bank after its first measurement, for an explanation with the ring's centre on side `side` (`Bank.side`)."""
    if side < 0:
        observed = observed.towards(-observed.arcs.axes[0])
    chart, count = observed.chart, len(MODELS.precession)
    curvature, half_band_m, size_covariance = _size_prior(chart.half_band_m[0], radius)
    coordinates = np.zeros((count, len(ERRORS)))
    coordinates[:, CURVATURE] = curvature - chart.curvature
    coordinates[:, HALF_BAND] = half_band_m - chart.half_band_m
    coordinates[MODELS.precession, LEVER] = LEVER_M
    prior = np.zeros((count, len(ERRORS), len(ERRORS)))
    prior[:, range(len(STEP)), range(len(STEP))] = _PLACE_SD**2
    prior[:, CURVATURE : HALF_BAND + 1, CURVATURE : HALF_BAND + 1] = size_covariance
    # u = v_C + l w x n - R w x inward, with independent velocity of the centre and angular velocity
    of_rates = np.zeros((3, 3))
    of_rates[2, 1] = 1.0 / curvature
    prior[:, VELOCITY, VELOCITY] = motion.speed_sd_m_s**2 * np.eye(3) + motion.rate_sd_rad_s**2 * of_rates @ of_rates.T
    prior[:, VELOCITY, RATE] = motion.rate_sd_rad_s**2 * of_rates
    prior[:, RATE, VELOCITY] = motion.rate_sd_rad_s**2 * of_rates.T
    prior[:, [RATE_INWARD, RATE_ALONG], [RATE_INWARD, RATE_ALONG]] = motion.rate_sd_rad_s**2
    prior[MODELS.precession, RATE_NORMAL, RATE_NORMAL] = motion.rate_sd_rad_s**2
    prior[MODELS.precession, LEVER, LEVER] = LEVER_SD_M**2
    bank = Bank(
        stamp_s=observed.stamp_s,
        models=MODELS,
        chart=chart,
        coordinates=coordinates,
        own=prior,
        common=np.zeros((count, len(ERRORS), observed.wrt_common.shape[1])),
        common_root=observed.common_root,
        log_evidence=np.zeros(count),
        measurements=0,
        side=side,
    )
    return update(bank, observed, innovation(bank, observed, *rates_near(bank, bank.coordinates)))


def _size_prior(half_band_m: float, radius: RadiusPrior | None) -> tuple[float, float, Float64[Array, "2 2"]]:
    """Curvature and half width of the ring with their covariance, from the radii that the record assumes.

    The radius of an edge for which none is assumed follows from the half width in the first shot, with a wide prior.
    """
    if radius is None:
        return CURVATURE_PRIOR, half_band_m, np.diag([CURVATURE_SD**2, HALF_BAND_SD_M**2])
    edges_m, sds_m = np.array([radius.inner_m, radius.outer_m]), np.array([radius.inner_sd_m, radius.outer_sd_m])
    if np.isfinite(edges_m).all():
        mean_m, half_band_m = float(edges_m.mean()), 0.5 * float(edges_m[1] - edges_m[0])
        wrt_edges = 0.5 * np.array([[-1.0, -1.0], [-1.0, 1.0]]) / np.array([[mean_m**2], [1.0]])
        return 1.0 / mean_m, half_band_m, (wrt_edges * sds_m**2) @ wrt_edges.T
    edge = int(np.isfinite(edges_m[1]))
    side = 2.0 * edge - 1.0  # R = outer - b, or inner + b
    mean_m = float(edges_m[edge]) - side * half_band_m
    wrt_both = np.array([[-1.0 / mean_m**2, side / mean_m**2], [0.0, 1.0]])
    return 1.0 / mean_m, half_band_m, (wrt_both * np.array([sds_m[edge], HALF_BAND_SD_M]) ** 2) @ wrt_both.T


def predict_and_update(bank: Bank, observed: Observation) -> tuple[Bank, Innovation]:
    """The bank after a further measurement, and the innovation of the measurement by the bank's prediction.

    The first measurements move a state far, and its motion since the last one is not linear in so large a step: the
    turn of an edge is curvature times velocity. The motion is therefore linearised again about the previous states as
    corrected by the measurement (iterated smoothing over one interval, Jazwinski 1970, section 8.3).
    """
    bank = _with_common_errors_of(bank, observed)
    at, transition, innovations = _linearize(bank, observed, None)
    first = innovations
    for _ in range(SMOOTHED if bank.measurements < ITERATED_UNTIL else 0):
        innovations = _relinearize(at, observed, innovations)
        gain = schmidt_gain(bank.own, bank.common, innovations._replace(jacobian=innovations.jacobian @ transition))
        about = bank.coordinates + (gain @ innovations.remaining[..., None])[..., 0]
        at, transition, innovations = _linearize(bank, observed, about)
    return update(at, observed, innovations), first


def predict_and_update_pushed(bank: Bank, observed: Observation, motion: MotionPrior) -> tuple[Bank, Innovation]:
    """As `predict_and_update`, for a target that may have been pushed at any time since the last measurement.

    Velocities before and after have the prior variance s^2 per axis, so that the change has 2 s^2. At a time that is
    evenly distributed over an interval T, it has the covariance of white acceleration with the density 2 s^2 / T.
    Filters whose own process noise explains the measurement better, at the odds of a push, go on without one.
    """
    interval_s = max(observed.stamp_s - bank.stamp_s, MIN_INTERVAL_S)
    models = bank.models._replace(
        velocity_noise=bank.models.velocity_noise + 2.0 * motion.speed_sd_m_s**2 / interval_s,
        rate_noise=bank.models.rate_noise + 2.0 * motion.rate_sd_rad_s**2 / interval_s,
    )
    steady, _ = predict_and_update(bank, observed)
    after, innovations = predict_and_update(replace(bank, models=models), observed)
    evidence = after.log_evidence + PUSH_LOG_ODDS
    keep = steady.log_evidence > evidence
    either = replace(
        steady,
        coordinates=np.where(keep[:, None], steady.coordinates, after.coordinates),
        own=np.where(keep[:, None, None], steady.own, after.own),
        common=np.where(keep[:, None, None], steady.common, after.common),
        log_evidence=np.maximum(steady.log_evidence, evidence),
    )
    return either, innovations


def _linearize(
    bank: Bank, observed: Observation, about: Float64[Array, "filter error=14"] | None
) -> tuple[Bank, Float64[Array, "filter error=14 error=14"], Innovation]:
    """The bank predicted to the time and chart of a measurement, the transition to it, and the innovation.

    Motion and rates are linearised about the coordinates `about` of the bank before; None for the bank's own
    coordinates.
    """
    prediction = _predict(bank, observed.stamp_s, observed.chart, about)
    count, local, leader_of = len(bank.coordinates), prediction.local, prediction.leader_of
    rates = step_rates(observed.chart, local)
    rates_wrt = jacobians(rates[count:])
    rates_wrt = np.linalg.solve(prediction.transition.swapaxes(1, 2), rates_wrt.swapaxes(1, 2)).swapaxes(1, 2)
    step = None if about is None else local.coordinates[:count] - prediction.bank.coordinates
    predicted_by = innovation(prediction.bank, observed, rates[:count], rates_wrt[leader_of], step)
    return prediction.bank, prediction.transition[leader_of], predicted_by


def predict(bank: Bank, stamp_s: float) -> Bank:
    """The bank predicted to another time, in the chart of its best filter's state."""
    return bank if stamp_s == bank.stamp_s else _predict(bank, stamp_s, None, None).bank


def _with_common_errors_of(bank: Bank, observed: Observation) -> Bank:
    """The bank for a measurement whose common errors have another prior.

    Errors that only are larger or smaller than was assumed, as those of the ring's form, have changed the states as
    they are: B holds for any size. After a correction of the rig, the effect of the previous common errors on the
    states counts as an error that is independent of the new ones.
    """
    root, before = observed.common_root, bank.common_root
    if before is root or np.array_equal(before, root):
        return bank
    if before.shape == root.shape:
        factor = np.linalg.norm(root, axis=0) / np.linalg.norm(before, axis=0)
        if np.allclose(before * factor, root, rtol=SAME_WITHIN, atol=0.0):  # not if one is NaN: an error from none
            of_mount = np.ones(bank.common.shape[2] - len(factor))
            return replace(bank, common=bank.common * np.append(factor, of_mount), common_root=root)
    common = np.zeros((*bank.common.shape[:2], observed.wrt_common.shape[1]))
    return replace(bank, own=bank.covariance, common=common, common_root=root)


class _Prediction(NamedTuple):
    bank: Bank
    local: LocalCoordinates
    """The filters' states, and those perturbed by `perturbed` of the leaders."""
    transition: Float64[Array, "leader error=14 error=14"]
    leader_of: Int64[Array, "filter"]


def _predict(
    bank: Bank, stamp_s: float, chart: RingStates | None, about: Float64[Array, "filter error=14"] | None
) -> _Prediction:
    time_s, count = stamp_s - bank.stamp_s, len(bank.coordinates)
    leaders, leader_of = _leaders(bank)
    linear_at = bank.coordinates if about is None else about
    around = np.concatenate([linear_at, perturbed(linear_at[leaders])])
    states = predict_states(retract(bank.chart, around), time_s)
    if chart is None:
        best = slice(bank.best, bank.best + 1)
        chart = RingStates(*(part[best] for part in states))._replace(motion=np.zeros((1, len(MOTION))))
    local = local_coordinates(chart, states)
    by_leader = jacobians(local.coordinates[count:])
    transition, coordinates = by_leader[leader_of], local.coordinates[:count]
    if about is not None:
        coordinates = coordinates + (transition @ (bank.coordinates - about)[..., None])[..., 0]
    noise = process_noise(bank.models, chart, coordinates, transition, time_s)
    moved_bank = replace(
        bank,
        stamp_s=stamp_s,
        chart=chart,
        coordinates=coordinates,
        own=transition @ bank.own @ transition.swapaxes(1, 2) + noise,
        common=transition @ bank.common,
    )
    return _Prediction(moved_bank, local, by_leader, leader_of)


def _leaders(bank: Bank) -> tuple[Int64[Array, "leader"], Int64[Array, "filter"]]:
    """The best filter of each motion model, and the leader of each filter.

    Jacobians are computed at the leaders: filters that differ in their process noise only have nearly the same state.
    """
    scores, precession = bank.scores, bank.models.precession
    if precession.all() or not precession.any():
        return np.array([np.argmax(scores)]), np.zeros(len(scores), dtype=np.int64)
    leaders = [np.argmax(np.where(precession, -np.inf, scores)), np.argmax(np.where(precession, scores, -np.inf))]
    return np.array(leaders), precession.astype(np.int64)


def rates_near(
    bank: Bank, coordinates: Float64[Array, "filter error=14"]
) -> tuple[Float64[Array, "filter 5"], Float64[Array, "filter 5 error=14"]]:
    """The rates of the chart's coordinates and their derivatives, for other states of the filters."""
    count = len(coordinates)
    leaders, leader_of = _leaders(bank)
    around = np.concatenate([coordinates, perturbed(coordinates[leaders])])
    rates = step_rates(bank.chart, local_coordinates(bank.chart, retract(bank.chart, around)))
    return rates[:count], jacobians(rates[count:])[leader_of]


def innovation(
    bank: Bank,
    observed: Observation,
    rates: Float64[Array, "filter 5"],
    rates_wrt: Float64[Array, "filter 5 error=14"],
    step: Float64[Array, "filter error=14"] | None = None,
) -> Innovation:
    """The measurement less its prediction by each filter of a bank, which is in the chart of the measurement.

    With a `step`, the rates are those of the states after that step, and are linearised about these states.
    """
    remaining = observed.target - bank.coordinates[:, : len(STEP)] @ observed.wrt_step.T
    remaining -= (rates - observed.step_rates) @ observed.wrt_step_rates.T
    jacobian = observed.wrt_step_rates @ rates_wrt
    if step is not None:
        remaining += (jacobian @ step[..., None])[..., 0]
    jacobian[:, :, : len(STEP)] += observed.wrt_step
    lost = ~np.isfinite(remaining).all(axis=1) | ~np.isfinite(jacobian).all(axis=(1, 2))
    remaining[lost], jacobian[lost] = 0.0, 0.0
    wrt_common = jacobian @ bank.common + observed.wrt_common
    covariance = innovation_covariance(bank.own, jacobian, wrt_common)
    precision, ring, of_ring = np.linalg.inv(covariance), observed.of_ring, remaining[..., None]
    if ring == len(observed.target):
        chi2 = (of_ring * (precision @ of_ring)).sum(axis=(1, 2))
    else:
        of_ring = of_ring[:, :ring]
        chi2 = (of_ring * np.linalg.solve(covariance[:, :ring, :ring], of_ring)).sum(axis=(1, 2))
    return Innovation(remaining, jacobian, wrt_common, covariance, precision, np.where(lost, np.inf, chi2), ring)


def innovation_covariance(
    own: Float64[Array, "filter error error"],
    jacobian: Float64[Array, "filter row error"],
    wrt_common: Float64[Array, "filter row source"],
) -> Float64[Array, "filter row row"]:
    """S = 1 + H P H^T + (H B + H_q) (H B + H_q)^T: the rows of a measurement have unit variance."""
    covariance: Float64[Array, "filter row row"] = np.eye(jacobian.shape[1]) + jacobian @ own @ jacobian.swapaxes(1, 2)
    covariance += wrt_common @ wrt_common.swapaxes(1, 2)
    return covariance


def _relinearize(bank: Bank, observed: Observation, innovations: Innovation) -> Innovation:
    """The innovation linearised where the measurement moves the states to (iterated filter).

    Only the first measurements of a bank are iterated.
    """
    for _ in range(ITERATIONS if bank.measurements < ITERATED_UNTIL else 0):
        gain = schmidt_gain(bank.own, bank.common, innovations)
        step = (gain @ innovations.remaining[..., None])[..., 0]
        innovations = innovation(bank, observed, *rates_near(bank, bank.coordinates + step), step)
    return innovations


def update(bank: Bank, observed: Observation, innovations: Innovation) -> Bank:
    """The bank after a measurement; its evidence is multiplied by the likelihood of the innovation."""
    innovations = _relinearize(bank, observed, innovations)
    gain = schmidt_gain(bank.own, bank.common, innovations)
    own, common = covariances_after(bank.own, bank.common, gain, innovations)
    _, log_determinant = np.linalg.slogdet(innovations.covariance)
    chi2 = (innovations.remaining[:, None] @ innovations.precision @ innovations.remaining[..., None])[:, 0, 0]
    log_likelihood = -0.5 * (chi2 + log_determinant + innovations.remaining.shape[1] * np.log(2.0 * pi))
    after = replace(
        bank,
        coordinates=bank.coordinates + (gain @ innovations.remaining[..., None])[..., 0],
        own=own,
        common=common,
        log_evidence=bank.log_evidence + np.where(np.isfinite(innovations.chi2), log_likelihood, LOST),
        measurements=bank.measurements + 1,
    )
    missing = after.penalized_evidence.max() - MAX_LOG_ODDS - after.penalized_evidence
    return replace(after, log_evidence=after.log_evidence + np.maximum(missing, 0.0))


def schmidt_gain(
    own: Float64[Array, "filter error error"], common: Float64[Array, "filter error source"], innovations: Innovation
) -> Float64[Array, "filter error row"]:
    """The gain with the least covariance: K = (P H^T + B (H B + H_q)^T) S^-1, Eq. (10.4)."""
    cross = own @ innovations.jacobian.swapaxes(1, 2) + common @ innovations.wrt_common.swapaxes(1, 2)
    gain: Float64[Array, "filter error row"] = cross @ innovations.precision
    return gain


def covariances_after(
    own: Float64[Array, "filter error error"],
    common: Float64[Array, "filter error source"],
    gain: Float64[Array, "filter error row"],
    innovations: Innovation,
) -> tuple[Float64[Array, "filter error error"], Float64[Array, "filter error source"]]:
    """P and B after an update with any gain: (1 - K H) P (1 - K H)^T + K K^T, and B - K (H B + H_q), Eq. (10.5)."""
    kept = np.eye(own.shape[1]) - gain @ innovations.jacobian
    updated_own = kept @ own @ kept.swapaxes(1, 2) + gain @ gain.swapaxes(1, 2)
    return 0.5 * (updated_own + updated_own.swapaxes(1, 2)), common - gain @ innovations.wrt_common
