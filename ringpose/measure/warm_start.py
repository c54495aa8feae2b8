"""What earlier shots show about the next one of a stream: its stripes by the track, their lasers, its background."""

from collections import deque
from collections.abc import Callable
from dataclasses import replace

import numpy as np

from ringpose.detect.difference_images import laser_images
from ringpose.detect.edge_search import PredictedRing
from ringpose.detect.pipeline import MOVED_PX, Prior
from ringpose.detect.stripes import MIN_GHOSTS, ghost_of_rig
from ringpose.geometry.camera_motion import CameraMotion
from ringpose.track.lines import validity
from ringpose.track.pipeline import Tracker
from ringpose.track.prediction import motion_px, predicted_ring, predicted_stripes
from ringpose.types.arrays import Array, Bool
from ringpose.types.detection import BreakPoints, Detection, SubtractedGhost
from ringpose.types.image import Frame, Shot
from ringpose.types.pose import PoseLine
from ringpose.types.rig import LaserGhost, Rig
from ringpose.types.track import FusionStatus, TrackLine, Validity

FOLLOWED = (Validity.VALID, Validity.PREDICTED)
"""States of a track whose prediction is used."""


BACKGROUND_SHARE = 0.3
"""Share of a shot's variances that its background's noise causes, which shots with one background have in common.

Of a stripe's centre, on a target at rest, it is 12 to 36 % (from a dark scene to one with half of the stripe's light).
"""

MAX_SHARING = 10
"""Number of shots with one background from which the variances grow no further: a track forgets the earlier ones."""

AHEAD = 2.0
"""Intervals between shots after the last measurement at which the next frame is expected at the latest ..."""

FIRST_INTERVAL_S = 0.5
"""... and the interval before there were two shots."""


class WarmStart:
    """Predicts what the next shot of a stream shows, and extends the track by it."""

    def __init__(self, tracker: Tracker) -> None:
        self.tracker = tracker
        """The tracker; the motion of its camera, if it has one, is also used within the shots."""
        self._background: Frame | None = None
        """The newest frame without lasers."""
        self._seen: Bool[Array, "laser edge=2"] | None = None
        """Break points that the last shot with a pose showed."""
        self._ghosts: tuple[SubtractedGhost, ...] = ()
        """Ghosts of the last shot that had some: they are a property of the camera."""
        self._shown: deque[SubtractedGhost] = deque(maxlen=2 * MIN_GHOSTS)
        """Ghosts of the last frames that had one, until most of them determine ..."""
        self.ghost: LaserGhost | None = None
        """... the one that all stripes have, which serves the frames that do not show it, such as saturated ones."""
        self._known: tuple[Rig, Rig] | None = None
        """The last rig without and with that ghost."""
        self._is_subtracted = False
        """Whether a background was subtracted from the last shot ..."""
        self._background_shots = 0
        """... and the number of shots from which the newest one was subtracted so far."""
        self._is_followed = False
        """Whether the last measurement continued the track."""
        self._stamp_s, self._interval_s = float("nan"), FIRST_INTERVAL_S

    def before(self, shot: Shot, rig: Rig) -> Prior:
        """What is known about a shot before its detection."""
        background = self._usable_background(shot, rig)
        return Prior(predicted=self.prediction(shot, rig), background=background, ghosts=self._ghosts)

    def with_ghost(self, rig: Rig) -> Rig:
        """The rig with the ghost that the stream has shown, for the lasers of which it states none."""
        if self.ghost is None:
            return rig
        if self._known is None or self._known[0] is not rig:
            ghosts = {**dict.fromkeys(rig.lasers.names, self.ghost), **rig.ghosts}
            self._known = rig, replace(rig, ghosts=ghosts)
        return self._known[1]

    def after(self, shot: Shot, detection: Detection, prior: Prior) -> None:
        """Keep what the detection of a shot shows about the following ones."""
        points = detection.break_points
        if isinstance(points, BreakPoints):
            self._seen = points.seen
        self._ghosts = detection.ghosts or self._ghosts
        if self.ghost is None and detection.ghosts:
            self._shown.extend(detection.ghosts)
            self.ghost = ghost_of_rig(self._shown)
        dark = np.flatnonzero(shot.lasers == 0)
        if len(dark):
            self._background, self._background_shots = list(shot.frames)[int(dark[-1])], 0
        self._is_subtracted = bool(len(dark)) or prior.background is not None
        self._background_shots += self._is_subtracted

    def added(self, line: PoseLine, clock: Callable[[], float] = lambda: float("inf")) -> TrackLine:
        """The track after a pose line; `clock` is the host's. Raises `DataError` as `Tracker.add` does."""
        self._is_followed = False
        if line.stamp_s > self._stamp_s:
            self._interval_s = line.stamp_s - self._stamp_s
        self._stamp_s = line.stamp_s
        number = self._background_shots if self._is_subtracted else 0
        attempt = self.tracker.add(line, clock(), shared_inflation(number))
        self._is_followed = attempt.fusion_status in (FusionStatus.FUSED, FusionStatus.FUSED_LATE)
        return self.tracker.line_of(attempt, clock())

    def prediction(self, shot: Shot, rig: Rig) -> BreakPoints | None:
        """The stripes at the times of the shot's frames; None if the track does not predict them well enough."""
        stamps_s = np.full(len(rig.lasers.names), shot.measured_at_s)
        for image in laser_images(shot, len(stamps_s)):
            stamps_s[list(image.lasers)] = image.stamp_s
        ring_at = {stamp_s: self._ring_at(stamp_s, self.tracker.camera) for stamp_s in set(stamps_s.tolist())}
        rings = [ring for stamp_s in stamps_s.tolist() if (ring := ring_at[stamp_s]) is not None]
        predicted = predicted_stripes(rings, rig) if len(rings) == len(stamps_s) else None
        if predicted is None or self._seen is None:  # ends that the last shot did not show are not searched
            return predicted
        position_px = np.where(self._seen[..., None], predicted.position_px, np.nan)
        return replace(predicted, position_px=position_px)

    def assigns_lasers(self, rig: Rig) -> bool:
        """Whether the track will assign the stripes of the next frame with all lasers on to their lasers."""
        if not self._is_followed:
            return False
        stamp_s, camera = self.tracker.track.stamp_s + AHEAD * self._interval_s, self.tracker.camera
        if camera is not None:
            camera = camera.going_on_until(stamp_s)  # poses of a robot that arrive meanwhile are not known ahead
        ring = self._ring_at(stamp_s, camera)
        predicted = None if ring is None else predicted_stripes([ring] * len(rig.lasers.names), rig)
        return predicted is not None and predicted.labelled

    def _ring_at(self, stamp_s: float, camera: CameraMotion | None) -> PredictedRing | None:
        track = self.tracker.track
        if not track.stamp_s <= stamp_s or validity(track, stamp_s, self.tracker.options) not in FOLLOWED:
            return None
        with np.errstate(all="ignore"):  # improbable states may be far off
            return predicted_ring(track, stamp_s, camera)

    def _usable_background(self, shot: Shot, rig: Rig) -> Frame | None:
        """The newest frame without lasers, unless the ring's edges have moved since, or the exposure has changed."""
        dark, track, stamp_s = self._background, self.tracker.track, shot.measured_at_s
        if dark is None or not track.banks or dark.stamp_s > stamp_s:  # of a clock that was set back since
            return None
        if not np.allclose(shot.exposure_s, dark.exposure_s, rtol=1e-3):
            return None
        with np.errstate(all="ignore"):
            taken_s = dark.stamp_s + dark.exposure_s / 2
            moved_px = motion_px(track, taken_s, stamp_s, rig, self.tracker.camera)
        return dark if moved_px <= MOVED_PX and dark.image.shape == shot.images.shape[1:] else None


def shared_inflation(number: int) -> float:
    """Factor on the variances of the shot of this number, from 1, with one background; 1 for 0.

    n such shots of a target at rest determine it with the variance (1 + (n - 1) share) / n of a single one. The
    information of the n-th shot is the difference between the information of n and of n - 1 shots.
    """
    before = min(number, MAX_SHARING) - 1
    if before < 1:
        return 1.0
    return (1.0 + before * BACKGROUND_SHARE) * (1.0 + (before - 1) * BACKGROUND_SHARE) / (1.0 - BACKGROUND_SHARE)
