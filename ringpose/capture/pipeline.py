"""Camera and lasers -> shots, in lock step: light, settle, trigger, next."""

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ringpose.capture.bracketing import merged_brackets, on_the_scale_of
from ringpose.capture.cameras.driver import CameraDriver
from ringpose.capture.lasers.driver import LaserDriver, LasersWentOff
from ringpose.capture.seen import STRIPE_IN_THE_DARK, LitPlaces, seen_lasers, shows_stripe
from ringpose.capture.settling import measured_settle_s
from ringpose.errors import DeviceError, LaserSafetyError, UsageError
from ringpose.types.frame import Frame, Shot
from ringpose.types.sequence import Step

TRIES = 3
"""How often a shot is taken before what is wrong with it counts."""

DARK_CHECK_S = 0.2
"""After everything was switched off: long enough for any relay, whatever the settling time that was believed in."""

LEAST_SETTLE_S = 0.02
"""Of a second attempt after lasers that followed too late."""

SHARE_OF_LIMIT = 0.8
"""Of the time for which the guard lets a laser be on, what settling may take beside the exposure."""

RECONNECT_TRIES = 5

RECONNECT_S = 1.0
"""Between two attempts to open a camera that was lost."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Procedure:
    """How shots are taken."""

    steps: Sequence[Step]
    exposure_s: float | None = None
    """Of steps without one of their own; None for the device's own setting."""
    settle_s: float | None = 0.0
    """From switching to triggering; None to measure it before the first shot."""
    must_see: bool = False
    """Whether a laser that was commanded must show in the image."""

    @property
    def exposures_s(self) -> tuple[float, ...]:
        """All that are asked for; none where everything is left to the device."""
        asked = [self.exposure_s, *(step.exposure_s for step in self.steps)]
        return tuple(exposure_s for exposure_s in asked if exposure_s is not None)


def captured_shots(
    camera: CameraDriver, lasers: LaserDriver, procedure: Procedure, names: Iterable[str]
) -> Iterator[Shot]:
    """One shot a name, of one frame a step; every laser is off whenever a shot is handed on."""
    _refuse_exposures(camera, procedure)
    taker = _Taker(camera, lasers, procedure)
    for name in names:
        yield taker.shot(name)


def _refuse_exposures(camera: CameraDriver, procedure: Procedure) -> None:
    bounds_us = camera.bounds("ExposureTime") if procedure.exposures_s else None
    least_s, most_s = (0.0, np.inf) if bounds_us is None else (1e-6 * bound for bound in bounds_us)
    for exposure_s in procedure.exposures_s:
        if not least_s <= exposure_s * (1 + 1e-9) or not exposure_s * (1 - 1e-9) <= most_s:
            found = f"the camera cannot expose for {exposure_s:g} s; it takes {least_s:g} to {most_s:g} s"
            raise UsageError("--exposure, --sequence", found)


class _Unseen(DeviceError):
    """Lasers that were commanded, but made no difference."""

    def __init__(self, lasers: int) -> None:
        self.lasers = lasers
        remedy = "does it shine, on the target? wait longer (--settle), or expose longer (--exposure)"
        super().__init__("lasers", f"{_names(lasers)} commanded but not seen, {TRIES} times", remedy)


class _CameraLost(Exception):
    """The camera, not the lasers' board, has failed."""


class _Taker:
    """Takes shots and remembers where each laser was last seen."""

    def __init__(self, camera: CameraDriver, lasers: LaserDriver, procedure: Procedure) -> None:
        self._camera = camera
        self._lasers = lasers
        self._procedure = procedure
        self._masks = [step.mask(lasers.count) for step in procedure.steps]
        self._settle_s = 0.0 if procedure.settle_s is None else procedure.settle_s
        self._settled = procedure.settle_s is not None
        self._was_late = False
        """Whether the last shot needed a longer settling time."""
        self._places: dict[int, LitPlaces] = {}

    def shot(self, name: str) -> Shot:
        """A shot in which nothing is wrong, after up to three attempts."""
        problem, doubts = DeviceError("lasers", "no shot could be taken"), 0
        for attempt in range(TRIES):
            try:
                if attempt == 0:  # a camera that was lost has been armed anew when it was opened again
                    self._arm()
                self._settle()
                shot = self._taken(name, self._settle_after_s(doubts))
            except LasersWentOff as error:
                self._lasers.set_mask(0)
                problem = error
                continue
            except _CameraLost as error:
                self._lasers.set_mask(0)
                problem = self._reconnected(error)
                continue
            checked, doubt = self._checked(shot)
            if doubt is None:
                self._learn(doubts)
                return checked
            problem, doubts = doubt, doubts + 1
        if isinstance(problem, _Unseen) and shows_stripe(self._dark_frame().image):
            found = f"{_names(problem.lasers)} not seen to go on or off, and a stripe shows while all are off"
            raise LaserSafetyError("lasers", found, STRIPE_IN_THE_DARK)
        raise problem

    def _settle_after_s(self, doubts: int) -> float:
        """Settling time after so many attempts in doubt: twice as long each time, within what the guard allows."""
        if not doubts:
            return self._settle_s
        longer_s = (1 << doubts - 1) * max(2 * self._settle_s, LEAST_SETTLE_S)
        limit_s = self._lasers.longest_on_s
        if limit_s is None:
            return longer_s
        spare_s = SHARE_OF_LIMIT * (limit_s - max(self._procedure.exposures_s, default=0.0))
        return max(self._settle_s, min(longer_s, spare_s))

    def _learn(self, doubts: int) -> None:
        """Lasers that were late in two shots running are waited for from now on; one that was once, was disturbed."""
        if doubts and self._was_late:
            self._settle_s = self._settle_after_s(doubts)
        self._was_late = doubts > 0

    def _settle(self) -> None:
        """Measure the settling time, once."""
        if self._settled:
            return
        try:
            self._settle_s = measured_settle_s(self._camera, self._lasers, self._procedure.exposure_s)
        finally:
            self._lasers.set_mask(0)
        self._settled = True

    def _taken(self, name: str, settle_s: float) -> Shot:
        frames, read_masks, lit = [], [], -1
        for step, mask in zip(self._procedure.steps, self._masks, strict=True):
            self._lasers.set_mask(mask)
            if mask != lit:
                self._lasers.wait(settle_s)
            lit = mask
            frames.append(self._frame(mask, step.exposure_s))
            read_masks.append(self._lasers.read_mask())
        self._lasers.set_mask(0)
        meta = {"saturation_dn": self._camera.describe().saturation_dn, "settle_s": settle_s}
        shot = _shot(name, frames, read_masks, meta)
        return merged_brackets(shot) if any(step.exposure for step in self._procedure.steps) else shot

    def _arm(self) -> None:
        try:
            self._camera.arm(self._procedure.exposure_s)
        except DeviceError as error:
            raise _CameraLost(error) from error

    def _frame(self, mask: int, exposure_s: float | None) -> Frame:
        try:
            return self._camera.trigger(mask, exposure_s)
        except DeviceError as error:
            raise _CameraLost(error) from error

    def _reconnected(self, lost: _CameraLost) -> DeviceError:
        """The camera opened anew, with all lasers off; what was wrong with it counts if that fails."""
        (problem,) = lost.args
        self._camera.close()
        for attempt in range(RECONNECT_TRIES):
            self._lasers.wait(RECONNECT_S * min(attempt, 1))
            try:
                self._camera.open()
                self._camera.arm(self._procedure.exposure_s)
            except DeviceError as error:
                problem = error
                self._camera.close()
            else:
                return DeviceError("camera", f"was lost again and again: {problem}")
        raise problem

    def _checked(self, shot: Shot) -> tuple[Shot, DeviceError | None]:
        """The shot with the masks that were seen; a doubt if lasers followed too late or not at all."""
        reported = 0 if shot.read_lasers is None else int(np.bitwise_or.reduce(shot.read_lasers & ~shot.lasers))
        if reported:
            self._refuse_reports()
            return shot, DeviceError("lasers", f"{_names(reported)} reported on in frames of others")
        seen, places = seen_lasers(shot)
        if seen is None:
            return shot, None
        stuck = {laser: self._places[laser] for laser in self._places if laser not in places}
        self._places |= places
        extra = int(np.bitwise_or.reduce(seen & ~shot.lasers))
        missing = int(np.bitwise_or.reduce(shot.lasers & ~seen))
        suspects = {laser: found for laser, found in (places | stuck).items() if (extra | missing) >> laser & 1}
        if suspects:
            self._refuse_light(suspects, shot)
        checked = replace(shot, seen_lasers=seen)
        if extra:
            return checked, DeviceError("lasers", f"{_names(extra)} seen in frames of others", "raise --settle")
        if missing and self._procedure.must_see:
            return checked, _Unseen(missing)
        return checked, None

    def _refuse_reports(self) -> None:
        """With everything off for long enough the board may not report a laser on."""
        self._lasers.set_mask(0)
        self._lasers.wait(DARK_CHECK_S)
        reported = self._lasers.read_mask()
        if reported:
            raise LaserSafetyError("lasers", f"{_names(reported)} reported on while all are off", "cut the power")

    def _refuse_light(self, suspects: dict[int, LitPlaces], shot: Shot) -> None:
        """With everything off for long enough no place of these lasers may be lit."""
        frame = self._dark_frame()
        image = on_the_scale_of(frame.image, frame.exposure_s, shot)
        lit = [laser for laser, found in suspects.items() if found.are_lit_in(image) and found.stand_out_in(image)]
        if lit:
            raise LaserSafetyError("lasers", f"{_names_of(lit)} seen while all are off", "cut the power")

    def _dark_frame(self) -> Frame:
        self._lasers.set_mask(0)
        self._lasers.wait(DARK_CHECK_S)
        try:
            return self._camera.trigger(0, None)
        except DeviceError as error:
            found = f"may be on, and the camera failed that was to show it: {error}"
            raise LaserSafetyError("lasers", found, "cut the power") from error


def _shot(name: str, frames: Sequence[Frame], read_masks: Sequence[int | None], meta: Mapping[str, Any]) -> Shot:
    reported = [mask for mask in read_masks if mask is not None]
    device_stamps = [frame.device_stamp_s for frame in frames if frame.device_stamp_s is not None]
    gains = [frame.gain_db for frame in frames if frame.gain_db is not None]
    ids = [frame.frame_id for frame in frames if frame.frame_id is not None]
    return Shot(
        name=name,
        images=np.stack([frame.image for frame in frames]),
        lasers=np.array([frame.lasers for frame in frames], dtype=np.uint8),
        stamp_s=np.array([frame.stamp_s for frame in frames], dtype=np.float64),
        exposure_s=np.array([frame.exposure_s for frame in frames], dtype=np.float64),
        device_stamp_s=np.array(device_stamps, dtype=np.float64) if len(device_stamps) == len(frames) else None,
        gain_db=np.array(gains, dtype=np.float64) if len(gains) == len(frames) else None,
        frame_id=np.array(ids, dtype=np.int64) if len(ids) == len(frames) else None,
        read_lasers=np.array(reported, dtype=np.uint8) if len(reported) == len(frames) else None,
        meta={**meta, **_mishaps(frames)},
    )


def _mishaps(frames: Sequence[Frame]) -> Mapping[str, Any]:
    """Frames that were taken again, or that were lost, if there are any."""
    attempts, dropped = [frame.attempts for frame in frames], sum(frame.dropped for frame in frames)
    again = {"attempts": attempts} if max(attempts) > 1 else {}
    return again | ({"dropped_frames": dropped} if dropped else {})


def _names(mask: int) -> str:
    return _names_of([laser for laser in range(mask.bit_length()) if mask >> laser & 1])


def _names_of(lasers: Iterable[int]) -> str:
    numbers = [str(laser + 1) for laser in lasers]
    return f"laser {numbers[0]} was" if len(numbers) == 1 else f"lasers {', '.join(numbers)} were"
