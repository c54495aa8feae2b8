"""A track at one time: the explanations of what was measured, and what one more measurement makes of it.

Explanations differ in the side of the face on which the ring's centre lies, which a short arc may leave open. Their
weights are their evidence. Measurements are taken in the order of their stamps (`ringpose.track.pipeline`).
"""

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import NamedTuple

import numpy as np

from ringpose.geometry.ring import CURVATURE, STEP, TILT_ALONG, TILT_INWARD
from ringpose.track.filters import Bank, Innovation, initialize, predict_and_update, predict_and_update_pushed
from ringpose.track.observation import Observation
from ringpose.track.states import local_coordinates, retract, step_rates
from ringpose.types.arrays import Array, Float64
from ringpose.types.assumptions import MotionPrior, motion_prior
from ringpose.types.pose import RadiusPrior
from ringpose.types.track import FusionStatus

GATE = 0.999
"""Probability with which an undisturbed measurement passes the gate."""

MIN_WEIGHT = 1e-6
"""Weight below which an explanation is dropped."""

MIN_TESTED_SHARE, MIN_TESTED_MODEL_SHARE = 0.1, 0.7
"""Shares of the largest weight from which an explanation and a motion model take part in the test of an innovation.

Less probable models with more process noise would let outliers pass.
"""

MIN_PROBABILITY = 1e-12
"""Probability below which a test ratio is that of the model that fits best."""

MAX_BIAS_SIGMAS = 1.0
"""Bias of a measurement at the track's state, because it was linearised elsewhere, from which it is not used."""

_IMPOSSIBLE = -1e9
"""Log evidence of a filter that has lost the ring."""

MIN_CURVATURE = 0.2
"""Curvature of the largest ring, 5 m, in 1/m: an explanation's evidence includes the probability of a larger one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Gripper:
    """Largest errors of the ring's pose with which a gripper still closes on it."""

    radial_m: float
    """Distance of the true middle of the band from the grasp point."""
    tilt_rad: float
    """Angle between the true normal and the reported one."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TrackOptions:
    """What the user states about a track."""

    predict_for_s: float = 2.0
    """Time without a measurement after which two that agree may start the track anew."""
    lost_after_s: float = 3.0
    """Time without a measurement after which the track is given up."""
    motion: MotionPrior = motion_prior()
    """Motion prior of a new track."""
    gripper: Gripper | None = None
    """The gripper whose capture of the ring is predicted."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Track:
    """Explanations of the measurements so far, which differ in the side of the ring's centre; none before the first."""

    banks: tuple[Bank, ...] = ()
    """The filters of each explanation."""
    interval_s: float = 0.0
    """Time between the last two measurements that were used."""
    resets: int = 0
    rejections: int = 0
    """Number of measurements that contradicted the track since the last one that was used."""
    pending: "Track | None" = None
    """The track after the newest measurement, if only this one contradicts it: of a target that was pushed since the
    measurement before, or, after a gap, one that begins with it. A second measurement that agrees confirms it."""

    @property
    def stamp_s(self) -> float:
        """Stamp of the newest measurement that was used; NaN before the first."""
        return self.banks[0].stamp_s if self.banks else float("nan")

    @property
    def likeliest(self) -> Bank:
        """The filters of the explanation with the largest weight."""
        return self.banks[int(np.argmax(self.weights))]

    @property
    def weights(self) -> Float64[Array, "explanation"]:
        """Probabilities of the explanations."""
        if len(self.banks) == 1:
            return np.ones(1)
        evidence = np.array([_evidence(bank) for bank in self.banks])
        weights = np.exp(evidence - evidence.max())
        normalized: Float64[Array, "explanation"] = weights / weights.sum()
        return normalized


class Fusion(NamedTuple):
    """How a measurement was used, its test ratio, and why it was not used."""

    status: FusionStatus
    test_ratio: float = float("nan")
    reason: str = ""


def new_track(observed: Observation, motion: MotionPrior, radius: RadiusPrior | None, resets: int) -> Track:
    """The track that begins with a measurement: an explanation for each side on which the ring's centre may lie."""
    banks = tuple(initialize(observed, side, motion, radius) for side in (1, -1))
    return _pruned(Track(banks=banks, resets=resets))


def track_after(
    track: Track, observed: Observation, radius: RadiusPrior | None, options: TrackOptions
) -> tuple[Track, Fusion]:
    """The track after a measurement that is not older than the track, and how the measurement was used."""
    gap_s, ratio = observed.stamp_s - track.stamp_s, float("nan")
    if not observed.determines_plane and not gap_s <= options.predict_for_s:  # nor without a track
        return track, Fusion(FusionStatus.REJECTED_COVARIANCE)
    if not track.banks:
        return new_track(observed, options.motion, radius, track.resets), Fusion(FusionStatus.FUSED)
    if gap_s < options.lost_after_s:
        after, ratio = _predict_and_update(track, observed)
        if ratio <= 1.0:
            return _used(track, after, observed, ratio)
    return _contradicted(track, observed, radius, options, ratio)


def _contradicted(
    track: Track, observed: Observation, radius: RadiusPrior | None, options: TrackOptions, ratio: float
) -> tuple[Track, Fusion]:
    """The track after a measurement with a test ratio above 1: an outlier unless a second measurement agrees with it.

    Returns the same as `track_after`.
    """
    gap_s = observed.stamp_s - track.stamp_s
    if gap_s <= options.predict_for_s:
        anew, its_ratio = _predict_and_update(track, observed, pushed_with=options.motion)
        status = FusionStatus.REJECTED_GATE
    else:
        anew, its_ratio = new_track(observed, options.motion, radius, track.resets + 1), 0.0
        status = FusionStatus.PENDING
    pending = track.pending
    if pending is not None and observed.stamp_s - pending.stamp_s <= options.lost_after_s:
        confirmed, agreement = _predict_and_update(pending, observed)
        if agreement <= 1.0:
            # A push during the first of the two shots makes that one wrong: it is left out where there is a track.
            after = anew if status is FusionStatus.REJECTED_GATE and its_ratio <= 1.0 else confirmed
            return _used(track, after, observed, agreement)
    rejected = replace(track, rejections=track.rejections + 1, pending=anew if its_ratio <= 1.0 else None)
    return rejected, Fusion(status, ratio)


def _used(track: Track, after: Track, observed: Observation, ratio: float) -> tuple[Track, Fusion]:
    """The track after a measurement that agrees with it, unless the measurement was linearised too far from it."""
    if _bias_sigmas(after.likeliest, observed) > MAX_BIAS_SIGMAS:
        return track, Fusion(FusionStatus.REJECTED_COVARIANCE, ratio)
    return after, Fusion(FusionStatus.FUSED, ratio)


def _bias_sigmas(bank: Bank, observed: Observation) -> float:
    """Approximate linearisation error of a measurement at the updated state, in standard deviations.

    Between the linearisation point and the state, the derivatives of the rows change by about the angle between the
    two normals (rad), relative to themselves; the change of the rows is wrong by this share. A single stripe is often
    linearised far from the state.
    """
    observed, best = observed.towards(bank.chart.axes[0, 0]), slice(bank.best, bank.best + 1)
    coordinates = local_coordinates(bank.chart, retract(bank.chart, bank.coordinates[best]))
    changed = observed.wrt_step @ coordinates.coordinates[0, : len(STEP)]
    changed += observed.wrt_step_rates @ (step_rates(bank.chart, coordinates)[0] - observed.step_rates)
    tilt_rad = np.linalg.norm(coordinates.coordinates[0, [TILT_INWARD, TILT_ALONG]])
    return float(tilt_rad * np.linalg.norm(changed))


def _predict_and_update(
    track: Track, observed: Observation, pushed_with: MotionPrior | None = None
) -> tuple[Track, float]:
    """The track with the measurement, and the test ratio of the explanation that it fits best.

    `pushed_with`: the target was pushed since the measurement before; its motion has this prior.
    """
    banks, ratios, weights = [], [], track.weights
    for bank, weight in zip(track.banks, weights.tolist(), strict=True):
        seen = observed.towards(bank.chart.axes[0, 0])
        after, innovations = (
            predict_and_update(bank, seen)
            if pushed_with is None
            else predict_and_update_pushed(bank, seen, pushed_with)
        )
        ratios.append(test_ratio(bank, innovations) if weight >= MIN_TESTED_SHARE * weights.max() else np.inf)
        banks.append(after)
    interval_s = observed.stamp_s - track.stamp_s
    after_all = replace(track, banks=tuple(banks), interval_s=interval_s, rejections=0, pending=None)
    return _pruned(after_all), min(ratios)


def test_ratio(bank: Bank, innovations: Innovation) -> float:
    """Chi-squared of an innovation over the limit of the gate; above 1 the measurement is rejected.

    The p-value is the weighted mean over the probable motion models, and the ratio is that of the chi-squared with this
    p-value. Improbable models are left out, because those with much process noise would let outliers pass the gate.
    """
    from scipy.special import chdtrc, chdtri

    dof, weights = max(innovations.degrees_of_freedom, 1), bank.weights
    tested = weights >= MIN_TESTED_MODEL_SHARE * weights.max()
    probability = float(weights[tested] @ chdtrc(dof, innovations.chi2[tested]) / weights[tested].sum())
    if probability < MIN_PROBABILITY:
        return float(innovations.chi2[tested].min()) / gate(dof)
    return float(chdtri(dof, min(probability, 1.0))) / gate(dof)


@lru_cache(maxsize=64)
def gate(degrees_of_freedom: int) -> float:
    """Quantile `GATE` of chi-squared."""
    from scipy.special import chdtri  # imported late: it is slow

    return float(chdtri(max(degrees_of_freedom, 1), 1.0 - GATE))


def _pruned(track: Track) -> Track:
    """The track without explanations that have become improbable."""
    weighted = zip(track.banks, track.weights.tolist(), strict=True)
    return replace(track, banks=tuple(bank for bank, weight in weighted if weight > MIN_WEIGHT))


def _evidence(bank: Bank) -> float:
    """Log evidence over all models, including the probability that the curvature is one that a ring can have."""
    from scipy.special import log_ndtr

    scores = bank.scores
    curvature = bank.chart.curvature + bank.coordinates[:, CURVATURE] - MIN_CURVATURE
    own, common = bank.own[:, CURVATURE, CURVATURE], bank.common[:, CURVATURE]
    sd = np.sqrt(own + (common * common).sum(axis=1))
    of_models = scores + log_ndtr(curvature / sd)
    of_models = np.where(np.isfinite(of_models), of_models, _IMPOSSIBLE)
    highest = float(of_models.max())
    return highest + float(np.log(np.exp(of_models - highest).sum()))
