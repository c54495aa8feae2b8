"""The record of a track at one instant: pose, velocity, grasp point, and how far they may be trusted."""

from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from math import nan, sqrt

import numpy as np

from ringpose.estimate.covariance import (
    GRASP_UNKNOWN_FROM_M,
    UNKNOWN_FROM,
    WEAK_SD,
    standard_deviation,
)
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.geometry.ring import CURVATURE, plane_and_center
from ringpose.geometry.rotations import tilt_basis
from ringpose.measure.status import flags_of
from ringpose.track.explanations import Track, TrackOptions
from ringpose.track.filters import Bank, mixed, predict
from ringpose.track.protection import ShotLevels, track_protection
from ringpose.track.states import RingStates, center_velocity, jacobians, perturbed, retract
from ringpose.types.arrays import Array, Float64
from ringpose.types.finding import NOTHING, Finding
from ringpose.types.pose import PoseFlag, RingPose, RingVelocity
from ringpose.types.track import (
    Attempt,
    GraspState,
    MotionModel,
    NextTick,
    ProcessNoise,
    SideHypothesis,
    TrackLine,
    Validity,
)

VALID_INTERVALS = 2.0
"""Intervals between the last two used measurements for which a prediction counts as valid ..."""

MIN_VALID_S = 0.1
"""... and the shortest time."""

VELOCITY_WEAK_SHARE = 0.5
"""Share of its prior's standard deviation from which the velocity counts as weak."""

RESOLVED_FROM = 0.999
"""Weight of an explanation from which the side of the ring's centre is known."""

_GAUSSIAN_POINTS = 4096

_CENTER, _NORMAL, _RADII, _VELOCITY, _RATES, _GRASP, _GRASP_VELOCITY = (
    slice(0, 3), slice(3, 6), slice(6, 8), slice(8, 11), slice(11, 14), slice(14, 17), slice(17, 20),
)  # fmt: skip


def track_line(
    track: Track,
    stamp_s: float,
    next_stamp_s: float | None,
    attempts: tuple[Attempt, ...],
    findings: Finding,
    flags: PoseFlag,
    rig: str,
    options: TrackOptions,
    camera: CameraMotion | None,
    shots: Sequence[ShotLevels] = (),
) -> TrackLine:
    """The record at `stamp_s`, with the prediction for `next_stamp_s` (default: one interval later).

    `findings`: what the newest measurement shows about the track. `flags`: those of the newest measurement that was
    used, as far as they concern the track. `camera`: its motion, if that is known; the track is then in the robot's
    base frame. `shots`: the levels of the last measurements that were used.
    """
    stamp_s = max(track.stamp_s, stamp_s) if track.banks else stamp_s  # that of the track if the instant is unknown
    lost = TrackLine(
        stamp_s=stamp_s,
        attempts=attempts,
        measurement_stamp_s=track.stamp_s,
        validity=validity(track, stamp_s, options),
        frame="camera" if camera is None else "base",
        log_evidence=log_evidence(track.likeliest) if track.banks else dict.fromkeys(MotionModel, nan),
        camera="inertial_assumed" if camera is None else "at_rest" if camera.is_at_rest else "robot_poses",
        resets=track.resets,
        rig=rig,
    )
    if lost.validity is Validity.LOST:
        return lost
    bank, weights = track.likeliest, track.weights
    reported = _Reported(bank, stamp_s)
    next_s = next_stamp_s or stamp_s + (track.interval_s or MIN_VALID_S)
    following = _Reported(bank, next_s)
    findings |= _open(reported, options)
    if weights.max() < RESOLVED_FROM:
        findings |= Finding.SIDE_OPEN
    if track.rejections:
        findings |= Finding.TRACK_CONTRADICTED
    flags |= flags_of(findings)
    models, chosen, gripper = bank.models, bank.best, options.gripper
    pose = _pose(reported, flags)
    return replace(
        lost,
        pose=pose,
        protection=track_protection(pose, shots, flags, side_known_to=1.0 - float(weights.max())),
        velocity=RingVelocity(
            center_m_s=reported.value[_VELOCITY],
            rate_rad_s=reported.value[_RATES],
            covariance=reported.velocity_covariance(),
        ),
        grasp=GraspState(
            point_m=reported.value[_GRASP],
            velocity_m_s=reported.value[_GRASP_VELOCITY],
            covariance=reported.covariance(_GRASP, _GRASP_VELOCITY),
        ),
        next_tick=NextTick(
            stamp_s=next_s,
            grasp_m=following.value[_GRASP],
            normal=following.value[_NORMAL],
            covariance=following.grasp_and_tilts(),
        ),
        hypotheses=tuple(
            SideHypothesis(
                side=hypothesis.side,
                weight=weight,
                center_m=(reported if hypothesis is bank else _Reported(hypothesis, stamp_s)).value[_CENTER],
            )
            for hypothesis, weight in zip(track.banks, weights.tolist(), strict=True)
        ),
        flags=flags,
        model=MotionModel.PRECESSION if models.precession[chosen] else MotionModel.CONSTANT_VELOCITY,
        process_noise=ProcessNoise(
            velocity_m2_s3=float(models.velocity_noise[chosen]), rate_rad2_s3=float(models.rate_noise[chosen])
        ),
        capture_probability=None
        if gripper is None
        else capture_probability(reported.capture_covariance(), gripper.radial_m, gripper.tilt_rad),
    )


def validity(track: Track, stamp_s: float, options: TrackOptions) -> Validity:
    """Validity of a track at an instant, by the age of the newest measurement that was used."""
    if not track.banks:
        return Validity.LOST
    age_s = stamp_s - track.stamp_s
    if age_s >= options.lost_after_s:
        return Validity.LOST
    if age_s > options.predict_for_s:
        return Validity.STALE
    return Validity.VALID if age_s <= max(MIN_VALID_S, VALID_INTERVALS * track.interval_s) else Validity.PREDICTED


def log_evidence(bank: Bank) -> dict[MotionModel, float]:
    """Highest score among the filters of each motion model."""
    scores = bank.scores
    return {
        MotionModel.CONSTANT_VELOCITY: float(scores[~bank.models.precession].max()),
        MotionModel.PRECESSION: float(scores[bank.models.precession].max()),
    }


class _Reported:
    """The reported quantities of an explanation at an instant, with their joint covariance."""

    def __init__(self, bank: Bank, stamp_s: float) -> None:
        at = predict(bank.probable, stamp_s)
        mean, self.errors = mixed(at)
        states = retract(at.chart, np.concatenate([mean[None], perturbed(mean[None])]))
        values = _quantities(states)
        self.value, self._jacobian = values[0], jacobians(values[1:])[0]
        self.axes, curvature = states.axes[0], float(states.curvature[0])
        self.is_curved = sqrt(float(self.errors[CURVATURE, CURVATURE])) < UNKNOWN_FROM * curvature
        """Whether the curvature is determined well enough for the centre to have a finite error."""
        self.basis = tilt_basis(self.value[_NORMAL])

    def covariance(self, *parts: slice) -> Float64[Array, "n n"]:
        """Covariance of some of the quantities."""
        return self._of(np.concatenate([self._jacobian[part] for part in parts]))

    def _of(self, rows: Float64[Array, "n error"]) -> Float64[Array, "n n"]:
        covariance: Float64[Array, "n n"] = rows @ self.errors @ rows.T
        return 0.5 * (covariance + covariance.T)

    def grasp_and_tilts(self) -> Float64[Array, "5 5"]:
        """Covariance of the grasp point and the tilts of the normal."""
        return self._of(np.concatenate([self._jacobian[_GRASP], self.basis @ self._jacobian[_NORMAL]]))

    def capture_covariance(self) -> Float64[Array, "4 4"]:
        """Covariance of the grasp point's errors inward and along the normal, and of the tilts."""
        across = self.axes[[0, 2]]
        return self._of(np.concatenate([across @ self._jacobian[_GRASP], self.basis @ self._jacobian[_NORMAL]]))

    def velocity_covariance(self) -> Float64[Array, "5 5"]:
        """Covariance of the velocity (x, y, z) and of the two angular velocities across the normal."""
        return self._of(np.concatenate([self._jacobian[_VELOCITY], self.basis @ self._jacobian[_RATES]]))

    def pose_covariance(self) -> Float64[Array, "7 7"]:
        """Covariance in the parameters of the records: tilts, offset, centre in the plane, radii."""
        normal_wrt, center_wrt = self._jacobian[_NORMAL], self._jacobian[_CENTER]
        normal, center_m = self.value[_NORMAL], self.value[_CENTER]
        plane = plane_and_center(normal, center_m, normal_wrt, center_wrt, tilt_basis(normal))
        return self._of(np.concatenate([plane, self._jacobian[_RADII]]))


def _quantities(states: RingStates) -> Float64[Array, "state quantity=20"]:
    """Centre, normal, radii, velocity of the centre, rates across the normal, grasp point and its velocity."""
    radii = states.mean_radius_m[:, None] + states.half_band_m[:, None] * np.array([-1.0, 1.0])
    velocity = (center_velocity(states)[:, None] @ states.axes)[:, 0]
    rates = (states.motion[:, None, 3:5] @ states.axes[:, :2])[:, 0]
    at_grasp = (states.motion[:, None, :3] @ states.axes)[:, 0]
    return np.concatenate([states.center_m, states.axes[:, 2], radii, velocity, rates, states.origin, at_grasp], axis=1)


def _open(reported: _Reported, options: TrackOptions) -> Finding:
    """The quantities whose standard deviations exceed the limits of single shots."""
    findings = NOTHING
    limit_m = WEAK_SD * float(np.abs(reported.value[_RADII]).min())
    if standard_deviation(reported.capture_covariance()[2:, 2:]) > UNKNOWN_FROM:
        findings |= Finding.NORMAL_OPEN
    if not reported.is_curved or standard_deviation(reported.covariance(_CENTER)) > limit_m:
        findings |= Finding.CENTER_OPEN
    if not reported.is_curved or sqrt(float(reported.covariance(_RADII).diagonal().max())) > limit_m:
        findings |= Finding.RADIUS_OPEN
    if standard_deviation(reported.covariance(_GRASP)) > GRASP_UNKNOWN_FROM_M:
        findings |= Finding.GRASP_OPEN
    if standard_deviation(reported.covariance(_VELOCITY)) > VELOCITY_WEAK_SHARE * options.motion.speed_sd_m_s:
        findings |= Finding.VELOCITY_OPEN
    return findings


def _pose(reported: _Reported, flags: PoseFlag) -> RingPose:
    """The pose, with NaN for what is not determined."""
    value, curved = reported.value, reported.is_curved
    normal_known = PoseFlag.NORMAL_WEAK not in flags
    covariance = reported.pose_covariance()
    known = np.array([normal_known] * 3 + [curved and normal_known] * 2 + [curved] * 2)
    masked = np.where(known[:, None] & known, covariance, nan)
    grasp_known = PoseFlag.GRASP_WEAK not in flags
    return RingPose(
        center_m=value[_CENTER] if curved and normal_known else np.full(3, nan),
        normal=value[_NORMAL] if normal_known else np.full(3, nan),
        radius_inner_m=float(value[6]) if curved else nan,
        radius_outer_m=float(value[7]) if curved else nan,
        grasp_m=value[_GRASP] if grasp_known else np.full(3, nan),
        method="track",
        condition_number=nan,
        residual_rms_px=nan,
        covariance=masked if known.any() else None,
        covariance_center_m2=reported.covariance(_CENTER) if curved and normal_known else None,
        covariance_grasp_m2=reported.covariance(_GRASP) if grasp_known else None,
        flags=flags,
    )


def capture_probability(
    covariance: Float64[Array, "4 4"], radial_m: float, tilt_rad: float, offset: Float64[Array, "4"] | None = None
) -> float:
    """Probability that errors of the grasp point and of the normal are both within a gripper's limits.

    `covariance`: of the errors of the grasp point inward and along the normal (m), and of the normal's two tilts (rad).
    `offset`: how far the gripper is from grasp point and normal, in the same coordinates; nothing without it.
    Captured: the middle of the band is within `radial_m` of the grasp point, and the normal within `tilt_rad`. The
    integral of the Gaussian is a mean over evenly distributed points, accurate to 0.003.
    """
    scale = np.sqrt(np.maximum(covariance.diagonal(), np.finfo(float).tiny))
    variance, axes = np.linalg.eigh(covariance / scale / scale[:, None])
    root = scale[:, None] * axes * np.sqrt(np.maximum(variance, 0.0))
    errors = _gaussian_points() @ root.T + (0.0 if offset is None else offset)
    captured = (np.hypot(errors[:, 0], errors[:, 1]) <= radial_m) & (np.hypot(errors[:, 2], errors[:, 3]) <= tilt_rad)
    return float(captured.mean())


@lru_cache(maxsize=1)
def _gaussian_points() -> Float64[Array, "point 4"]:
    """Points that are evenly distributed as four independent normal numbers.

    Fractional parts of multiples of 1/g, ..., 1/g^4, where g^5 = g + 1 (the additive recurrence of Roberts 2018).
    """
    from scipy.special import ndtri

    ratio = 1.0
    for _ in range(50):
        ratio = (1.0 + ratio) ** 0.2
    uniform = (0.5 + np.arange(1, _GAUSSIAN_POINTS + 1)[:, None] * ratio ** -np.arange(1.0, 5.0)) % 1.0
    points: Float64[Array, "point 4"] = ndtri(uniform)
    return points
