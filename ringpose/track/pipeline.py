"""Pose records -> track records, the computation of `ringpose track`.

Records may arrive late. Those of the last second are kept with the track as it was after each of them, and used again
in the order of their stamps when an older one arrives: the result does not depend on the order of arrival. Records that
are not late, but stamped by a clock that was set back (`ringpose.track.stream_clock`), start the track anew.
"""

from bisect import bisect_left
from dataclasses import replace
from math import isfinite
from typing import NamedTuple

import numpy as np

from ringpose.errors import DataError
from ringpose.geometry.camera_motion import MAX_RATE_RAD_S, MAX_SPEED_M_S, CameraMotion
from ringpose.measure.status import LASTING_FLAGS
from ringpose.track.common_errors import CommonErrors, common_errors
from ringpose.track.explanations import Fusion, Track, TrackOptions, track_after
from ringpose.track.form_evidence import FormEvidence
from ringpose.track.lines import track_line
from ringpose.track.observation import Observation, observation
from ringpose.track.protection import ShotLevels, shot_levels
from ringpose.track.stream_clock import Arrival, StreamClock
from ringpose.types.finding import NOTHING, Finding
from ringpose.types.pose import PoseFlag, PoseLine, RadiusPrior, RingMeasurement
from ringpose.types.rig import Rig, reject_other_rig
from ringpose.types.track import Attempt, FusionStatus, TrackLine

BUFFER_S = 1.0
"""Age to which late records are used."""

FUTURE_S = 0.1
"""How far a stamp may be ahead of this computer's clock."""

MAX_ENTRIES = 500
"""Most records in the buffer, also if none of them is used."""

MAX_INFORMATION_ROOT = 1e10
"""Largest plausible number in the square root of a measurement: a standard deviation of 0.1 nm."""

SAME_PRIOR_WITHIN = 0.5
"""Difference of covariances of common errors, by their standard deviations, up to which they count as the same."""

REASONS = {
    FusionStatus.PENDING: "it does not continue the track; a second one that agrees with it starts the track anew",
    FusionStatus.REJECTED_COVARIANCE: "it does not determine the ring's plane, or a track has another one",
    FusionStatus.REJECTED_GATE: "it contradicts the track",
}
"""Why a measurement that was tested is not used."""

MAX_DISTANCE_M, MAX_RADIUS_M = 100.0, 1e5
"""Longest plausible distance of a ring's face from the camera, and radius at which nearly straight edges count as those
of a ring whose curvature was not determined."""


class _Entry(NamedTuple):
    """A record, and the track after it."""

    observed: Observation
    radius: RadiusPrior | None
    flags: PoseFlag
    levels: ShotLevels | None
    track: Track
    fusion: Fusion

    @property
    def key(self) -> tuple[float, str]:
        """Order of the records; records with equal stamps are ordered by name, so that the result is reproducible."""
        return self.observed.stamp_s, self.observed.shot


class Tracker:
    """A track that pose records are added to as they arrive."""

    def __init__(
        self, rig: Rig | None, options: TrackOptions | None = None, camera: CameraMotion | None = None
    ) -> None:
        """If the motion of the `camera` is given, the track is in the robot's base frame."""
        self._rig, self.options = rig, options or TrackOptions()
        self.camera = camera
        """The motion of the camera, which may be replaced by one with further poses; None if it is not known."""
        self._hash = rig.sha256 if rig is not None else ""
        self._common: CommonErrors | None = None
        self._form = FormEvidence()
        self._base = Track()
        self._base_stamp_s = -float("inf")
        self._base_flags = PoseFlag(0)
        self._base_levels: ShotLevels | None = None
        self._entries: list[_Entry] = []
        self._attempts: list[Attempt] = []
        self._clock = StreamClock(self.options.lost_after_s)

    @property
    def track(self) -> Track:
        """The track after all records so far."""
        return self._entries[-1].track if self._entries else self._base

    def add(self, line: PoseLine, now_s: float = float("inf"), inflation: float = 1.0) -> Attempt:
        """Use one record, if it can be used; `now_s` is the host's clock, `inflation` a factor on its variances.

        Raises `DataError` for a record that does not belong to this track: of another rig, repeated, or with other
        nuisance parameters.
        """
        self._check_belongs(line)
        stamp_s = line.pose_stamp_s if isfinite(line.pose_stamp_s) else line.stamp_s
        arrival = self._arrived(line, stamp_s, now_s)
        try:
            with np.errstate(all="ignore"):  # a ring that is not where it was seen has NaN coordinates
                status, ratio, reason = self._fused(line, now_s, inflation, arrival)
        except np.linalg.LinAlgError:
            status, ratio, reason = Fusion(FusionStatus.REJECTED_COVARIANCE, reason="its equations are singular")
        if arrival is Arrival.SET_BACK:
            reason = "; ".join(filter(None, ["the clock of the stamps was set back", reason]))
        attempt = Attempt(shot=line.shot, stamp_s=stamp_s, fusion_status=status, test_ratio=ratio, reason=reason)
        self._attempts.append(attempt)
        return attempt

    def start_anew(self) -> None:
        """Forget what was measured, as its stamps are not of the same clock as those of the records that follow."""
        self._base, self._base_stamp_s = Track(resets=self.track.resets + 1), -float("inf")
        self._base_flags, self._base_levels, self._entries = PoseFlag(0), None, []
        self._clock = StreamClock(self.options.lost_after_s)

    def line_at(self, stamp_s: float, next_stamp_s: float | None = None, now_s: float = float("inf")) -> TrackLine:
        """The record of the track at an instant, and the attempts since the last one; `now_s` is the host's clock."""
        attempts, self._attempts = tuple(self._attempts), []
        used = [entry for entry in self._entries if entry.fusion.status is FusionStatus.FUSED]
        flags = (used[-1].flags if used else self._base_flags) & LASTING_FLAGS
        levels = [entry.levels for entry in used] or [self._base_levels]
        is_contradicted = bool(attempts) and attempts[-1].fusion_status is FusionStatus.REJECTED_GATE
        findings = Finding.TRACK_CONTRADICTED if is_contradicted or self._clock.is_in_doubt else NOTHING
        line = track_line(
            self.track,
            stamp_s,
            next_stamp_s,
            attempts,
            findings,
            flags,
            self._hash,
            self.options,
            self.camera,
            [each for each in levels if each is not None],
        )
        latency_s = now_s - line.measurement_stamp_s
        return replace(line, latency_s=latency_s) if 0.0 <= latency_s < self.options.lost_after_s else line

    def line_of(self, attempt: Attempt, now_s: float = float("inf")) -> TrackLine:
        """The track record after the newest attempt: at its stamp, but never before that of the record before.

        The track grows older with records that arrive and are not used, also if their stamps are not of its time: only
        a measurement that is used makes it younger.
        """
        is_used = attempt.fusion_status in (FusionStatus.FUSED, FusionStatus.FUSED_LATE)
        stamp_s = attempt.stamp_s
        if self.track.banks:
            stamp_s = self._clock.state_stamp_s(stamp_s, self.track.stamp_s, is_used=is_used)
        return self.line_at(stamp_s, now_s=now_s)

    def _arrived(self, line: PoseLine, stamp_s: float, now_s: float) -> Arrival:
        """How the stamp of a record follows those before it; if the clock was set back, the track starts anew."""
        track_s, is_measured = self.track.stamp_s, line.measurement is not None and isfinite(line.pose_stamp_s)
        is_in_buffer = is_measured and stamp_s >= self._base_stamp_s
        is_ahead = stamp_s > now_s + FUTURE_S
        arrival = self._clock.arrived(stamp_s, track_s, is_ahead=is_ahead, is_shot=is_in_buffer)
        if arrival is Arrival.SET_BACK:
            self.start_anew()
            self._clock.arrived(stamp_s, self.track.stamp_s, is_ahead=is_ahead, is_shot=is_measured)
        elif arrival is Arrival.AFTER_STRAY:
            self._entries = [entry for entry in self._entries if entry.observed.stamp_s <= stamp_s]
        return arrival

    def _not_usable(self, line: PoseLine, now_s: float, arrival: Arrival) -> Fusion | None:
        """Why a record cannot be used; None if it can."""
        measurement, stamp_s = line.measurement, line.pose_stamp_s
        if measurement is None and line.pose is not None:
            reason = "the record has no measurement: do not use --brief of ringpose pose, nor a method other than ml"
            return Fusion(FusionStatus.NONE, reason=reason)
        if measurement is None or not isfinite(stamp_s):
            return Fusion(FusionStatus.NONE, reason=line.reason or "the record has no time stamp")
        if arrival is Arrival.AHEAD:
            reason = f"its stamp is {stamp_s - now_s:.3g} s ahead of this computer's clock"
            return Fusion(FusionStatus.TOO_NEW, reason=reason)
        if line.flags & PoseFlag.ASSIGNMENT_AMBIGUOUS:
            return Fusion(FusionStatus.REJECTED_COVARIANCE, reason="the assignment of its stripes is ambiguous")
        if not _is_plausible(measurement):
            return Fusion(
                FusionStatus.REJECTED_COVARIANCE, reason="its measurement does not describe a ring in front of a camera"
            )
        if stamp_s < self._base_stamp_s:
            return Fusion(FusionStatus.TOO_OLD, reason=f"it is older than the buffer of {BUFFER_S:g} s")
        if arrival is Arrival.IN_DOUBT:
            reason = (
                "its stamp is among those of earlier shots; if that of the next one is, too, the clock was set back"
            )
            return Fusion(FusionStatus.PENDING, reason=reason)
        return None

    def _fused(self, line: PoseLine, now_s: float, inflation: float, arrival: Arrival) -> Fusion:
        """Use a record for the track, if it can be used, and return how it was used."""
        measurement, stamp_s, newest_s = line.measurement, line.pose_stamp_s, self.track.stamp_s
        if not_usable := self._not_usable(line, now_s, arrival):
            return not_usable
        assert measurement is not None  # as checked
        if line.flags & PoseFlag.INCONSISTENT:
            inflation *= max(measurement.chi2 / max(measurement.degrees_of_freedom, 1), 1.0)
        common = self._checked_common(line)
        camera = None if self.camera is None else self.camera.at(stamp_s)
        if self.camera is not None and camera is None:
            return Fusion(FusionStatus.REJECTED_COVARIANCE, reason=self.camera.why_not_at(stamp_s))
        form = self._form.with_shot(line, measurement, common, inflation)
        common, measurement = form.judged(measurement, common)
        observed = observation(line, measurement, common, inflation, camera)
        radius = None if line.priors is None else line.priors.radius
        levels = shot_levels(line, "camera" if self.camera is None else "base")
        entry = _Entry(observed, radius, line.flags, levels, self._base, Fusion(FusionStatus.NONE))
        status, ratio, _ = self._inserted(entry)
        if status is FusionStatus.FUSED:
            self._form = form
        if status is FusionStatus.FUSED and stamp_s < newest_s:
            status = FusionStatus.FUSED_LATE
        self._forget()
        return Fusion(status, ratio, REASONS.get(status, ""))

    def _inserted(self, entry: _Entry) -> Fusion:
        """Insert an entry by its stamp, and process the entries after it again."""
        place = bisect_left([each.key for each in self._entries], entry.key)
        before, again = self._entries[:place], []
        track = before[-1].track if before else self._base
        for each in (entry, *self._entries[place:]):
            track, fusion = track_after(track, each.observed, each.radius, self.options)
            again.append(each._replace(track=track, fusion=fusion))
        self._entries = before + again
        return again[0].fusion

    def _forget(self) -> None:
        """Drop the records that are older than the buffer; what arrives before the last one of them is too old."""
        oldest_s = self.track.stamp_s - BUFFER_S
        while self._entries and (self._entries[0].observed.stamp_s < oldest_s or len(self._entries) > MAX_ENTRIES):
            first = self._entries.pop(0)
            self._base, self._base_stamp_s = first.track, first.observed.stamp_s
            if first.fusion.status is FusionStatus.FUSED:
                self._base_flags, self._base_levels = first.flags, first.levels
        if isfinite(oldest_s):
            self._base_stamp_s = max(self._base_stamp_s, oldest_s)

    def _check_belongs(self, line: PoseLine) -> None:
        """Raise `DataError` for a measurement of another rig, or one that is in the buffer already."""
        if line.measurement is None:
            return
        self._hash = self._hash or line.rig
        remedy = "track the records of one rig at a time, and give its file with --rig"
        reject_other_rig(line.rig, self._hash, line.shot, remedy)
        if (line.pose_stamp_s, line.shot) in [each.key for each in self._entries]:
            raise DataError(line.shot, f"repeats the record of shot {line.shot}", "give each record once")

    def _checked_common(self, line: PoseLine) -> CommonErrors:
        assert line.measurement is not None
        mount = None if self.camera is None else self.camera.mount
        with_form = self._common is not None and self._common.with_form
        common = common_errors(line, line.measurement, self._rig, mount, with_form=with_form)
        if self._common is None or not _alike(self._common, common):
            if self._common is not None and common.without_form[0] != self._common.without_form[0]:
                finding = "has other nuisance parameters than the records before"
                raise DataError(line.shot, finding, "give ringpose pose the same options for all of them")
            self._common = common
        return self._common


def _alike(first: CommonErrors, second: CommonErrors) -> bool:
    """Whether two priors are of the same errors: a covariance that is estimated again in each shot differs a little.

    Taken as different, the errors of successive shots would count as independent and average out. The tolerance of the
    ring is judged by itself.
    """
    if first.names != second.names:
        return False
    (_, one), (_, other) = first.without_form, second.without_form
    covariance = one @ one.T
    sd = np.sqrt(covariance.diagonal())
    return bool((np.abs(other @ other.T - covariance) <= SAME_PRIOR_WITHIN * np.outer(sd, sd)).all())


def _is_plausible(measurement: RingMeasurement) -> bool:
    """Whether a measurement contains information, and none that no camera can have, about a ring that can exist.

    The camera sees its face, and a target is not faster, relative to the camera, than a robot can be.
    """
    at, largest = measurement.linearized_at, float(np.abs(measurement.square_root[:, :-1]).max(initial=0.0))
    radius_m = 0.5 * (at.radius_inner_m + at.radius_outer_m)
    is_ring = 0.0 < radius_m < MAX_RADIUS_M and float(np.linalg.norm(at.center_m)) < MAX_DISTANCE_M + radius_m
    speed_m_s, rate_rad_s = float(np.linalg.norm(at.velocity_m_s)), float(np.linalg.norm(at.rate_rad_s))
    is_possible = speed_m_s < MAX_SPEED_M_S and rate_rad_s < MAX_RATE_RAD_S
    is_facing = float(at.normal @ at.center_m) < 0.0
    return 0.0 < largest < MAX_INFORMATION_ROOT and is_ring and is_facing and is_possible
