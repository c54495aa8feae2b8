"""Camera and lasers -> shots, in lock step: light, settle, trigger, next.

How long lasers take to come on and to go off, measured with the camera that will look at them.
"""

import time
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ringpose.capture.ambient import LOST_SHARE_OF_FULL, AmbientChange, ambient_change, same_ambient_light
from ringpose.capture.cameras.driver import CameraDriver
from ringpose.capture.hdr import merged_brackets, on_the_scale_of
from ringpose.capture.laser_check import (
    STRIPE_IN_THE_DARK,
    LitPlaces,
    broad_light_dn,
    lasers_out_of_turn,
    places_lit,
    seen_lasers,
    shows_stripe,
)
from ringpose.capture.lasers.driver import LaserDriver, LasersWentOff
from ringpose.errors import DeviceError, LaserSafetyError, UsageError
from ringpose.types.arrays import Array, UInt
from ringpose.types.image import Frame, Shot
from ringpose.types.sequence import Step

TRIES = 3
"""How often a shot is taken before what is wrong with it counts."""

DARK_CHECK_S = 0.2
"""After everything was switched off: long enough for any relay, whatever the settling time that was believed in."""

DARK_CHECKS = 4
"""Looks for a laser while all are off and ambient light changes, which may outshine it in some of them."""

MIN_SETTLE_S = 0.02
"""Of a second attempt after lasers that followed too late."""

SHARE_OF_LIMIT = 0.8
"""Of the time for which the guard lets a laser be on, what settling may take beside the exposure."""

MAX_LOST = 10
"""Attempts at one shot that changing ambient light may spoil before the capture ends."""

AWAITED_CHANGES = (0, 1, 2)
"""Changes of the light to wait for before another attempt: none, as most lamps then stay as they are for a while; the
next one, if a shot takes most of that time; the one after that, if the lamp flashes."""

MAX_STEADY_S = 1.0
"""Light that has not changed for so long is not waited for."""

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
    min_s, max_s = (0.0, np.inf) if bounds_us is None else (1e-6 * bound for bound in bounds_us)
    for exposure_s in procedure.exposures_s:
        if not min_s <= exposure_s * (1 + 1e-9) or not exposure_s * (1 - 1e-9) <= max_s:
            found = f"the camera cannot expose for {exposure_s:g} s; it takes {min_s:g} to {max_s:g} s"
            raise UsageError("--exposure, --sequence", found)


class _Unseen(DeviceError):
    """Lasers that were commanded, but made no difference."""

    def __init__(self, lasers: int) -> None:
        self.lasers = lasers
        remedy = "does it shine, on the target? wait longer (--settle), or expose longer (--exposure)"
        super().__init__("lasers", f"{_names(lasers)} commanded but not seen, {TRIES} times", remedy)


class _AmbientChanged(DeviceError):
    """Ambient light changed while a shot was taken; that is no reason to wait longer for the lasers."""

    def __init__(self, changes: Sequence[AmbientChange], unseen: int = 0) -> None:
        self.changes = changes
        largest = max(changes, key=lambda change: abs(change.size_dn))
        size = f"by up to {abs(largest.size_dn):.0f} dn ({100 * largest.share_of_full:.0f} % of the full grey value)"
        found = f"changed within each of {len(changes)} shots in a row, {size}"
        if unseen:
            found += f", and {_names(unseen)} not seen in any of them"
        remedy = "shield the scene, or take shorter shots (--sequence off,all; lasers at line:)"
        if all(change.only_with_lasers for change in changes):
            remedy += "; if it is stray light of the lasers, expose shorter"
        super().__init__("ambient light", found, remedy)


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
        """A shot in which nothing is wrong, after up to three attempts and those that changing ambient light spoils."""
        problem, failures, doubts = DeviceError("lasers", "no shot could be taken"), 0, 0
        lost: list[AmbientChange] = []
        while failures < TRIES and len(lost) < MAX_LOST:
            try:
                if not failures and not lost:  # a camera that was lost has been armed when it was opened again
                    self._arm()
                self._settle()
                self._await_changes(AWAITED_CHANGES[(len(lost) - 1) % len(AWAITED_CHANGES)] if lost else 0)
                shot = self._taken(name, self._settle_after_s(doubts))
            except LasersWentOff as error:
                self._lasers.set_mask(0)
                problem, failures = error, failures + 1
                continue
            except _CameraLost as error:
                self._lasers.set_mask(0)
                problem, failures = self._reconnected(error), failures + 1
                continue
            checked, doubt = self._checked(shot)
            if doubt is None:
                self._learn(doubts)
                return _after_lost(checked, lost)
            if isinstance(doubt, _AmbientChanged):
                lost += doubt.changes
                problem = _AmbientChanged(lost, self._unseen_after_change(shot, len(lost)))
            else:
                problem, failures, doubts = doubt, failures + 1, doubts + 1
        if isinstance(problem, _Unseen):
            self._refuse_stripe(problem.lasers, self._dark_frame().image)
        raise problem

    def _unseen_after_change(self, shot: Shot, lost: int) -> int:
        """The lasers of a lost shot that have never been seen; one that burns in frames of others is a safety fault."""
        same_light = same_ambient_light(shot.images, shot.usual_full_dn)
        self._places, suspects = lasers_out_of_turn(shot, self._places, same_light)
        for _ in range(DARK_CHECKS if suspects else 0):
            image = self._dark_image(shot)
            self._refuse_laser_light([laser for laser, found in suspects.items() if found.stand_out_in(image)])
        unseen = int(np.bitwise_or.reduce(shot.lasers)) & ~sum(1 << laser for laser in self._places)
        if unseen and self._procedure.must_see and lost in (TRIES, MAX_LOST):
            always = np.minimum.reduce([*shot.images, self._dark_image(shot)])
            self._refuse_stripe(unseen, always)
        return unseen

    def _await_changes(self, count: int) -> None:
        """Let ambient light change so many times, while all lasers are off; a shot that begins then has most time."""
        full_dn = self._camera.describe().saturation_dn
        before = self._frame(0, None) if count else None
        steady_since_s = 0.0 if before is None else before.stamp_s
        while count and before is not None and before.stamp_s - steady_since_s < MAX_STEADY_S:
            frame = self._frame(0, None)
            if not same_ambient_light(np.stack([before.image, frame.image]), full_dn).all():
                count, steady_since_s = count - 1, frame.stamp_s
            before = frame

    def _settle_after_s(self, doubts: int) -> float:
        """Settling time after so many attempts in doubt: twice as long each time, within what the guard allows."""
        if not doubts:
            return self._settle_s
        longer_s = (1 << doubts - 1) * max(2 * self._settle_s, MIN_SETTLE_S)
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
        extra = int(np.bitwise_or.reduce(seen & ~shot.lasers))
        missing = int(np.bitwise_or.reduce(shot.lasers & ~seen))
        is_wrong = bool(extra or (missing and self._procedure.must_see))
        change = ambient_change(shot)
        if change is not None and (is_wrong or change.share_of_full > LOST_SHARE_OF_FULL):
            return shot, _AmbientChanged([change])
        stuck = {laser: self._places[laser] for laser in self._places if laser not in places}
        self._places |= places
        suspects = {laser: found for laser, found in (places | stuck).items() if (extra | missing) >> laser & 1}
        if suspects:
            self._refuse_light(suspects, shot)
        noted = {} if change is None else {"ambient_change_dn": change.size_dn}
        checked = replace(shot, seen_lasers=seen, meta={**shot.meta, **noted})
        broad_dn = broad_light_dn(shot, seen, places)
        if broad_dn:
            share = broad_dn / shot.usual_full_dn
            return shot, _AmbientChanged([AmbientChange(size_dn=broad_dn, share_of_full=share)])
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
        image = self._dark_image(shot)
        self._refuse_laser_light(
            [laser for laser, found in suspects.items() if found.are_lit_in(image) and found.stand_out_in(image)]
        )

    def _refuse_laser_light(self, lit: Sequence[int]) -> None:
        if lit:
            raise LaserSafetyError("lasers", f"{_names_of(lit)} seen while all are off", "cut the power")

    def _refuse_stripe(self, lasers: int, image: UInt[Array, "row column"]) -> None:
        """Of lasers that make no difference no stripe may show while all are off."""
        if shows_stripe(image):
            found = f"{_names(lasers)} not seen to go on or off, and a stripe shows while all are off"
            raise LaserSafetyError("lasers", found, STRIPE_IN_THE_DARK)

    def _dark_image(self, shot: Shot) -> UInt[Array, "row column"]:
        """With everything off for long enough, on the scale of a shot."""
        frame = self._dark_frame()
        return on_the_scale_of(frame.image, frame.exposure_s, shot)

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


def _after_lost(shot: Shot, lost: Sequence[AmbientChange]) -> Shot:
    """The shot, with the attempts at it that changing ambient light spoiled; see `lost_attempts_dn`."""
    if not lost:
        return shot
    sizes_dn = [change.size_dn for change in lost]
    return replace(shot, meta={**shot.meta, "attempts_lost": {"ambient_changed": sizes_dn}})


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


MAX_DURATION_S = 0.3
"""No relay and no laser takes longer."""

STEADY = 0.95
"""Share of its full light with which a laser counts as on; as off, when only the rest of it is left."""

MARGIN = 1.25
"""Contacts do not always close in the same time."""


def measured_settle_s(camera: CameraDriver, lasers: LaserDriver, exposure_s: float | None) -> float:
    """Time from a command after which a frame is as it stays, the longest of all lasers, with a margin.

    Every laser that shows is switched off and on again while frames are triggered; all are off in the end.
    """
    saturation_dn = camera.describe().saturation_dn
    lasers.set_mask(0)
    lasers.wait(MAX_DURATION_S)
    dark = camera.trigger(0, exposure_s).image
    times_s = []
    for laser in range(lasers.count):
        lasers.set_mask(1 << laser)
        lasers.wait(MAX_DURATION_S)
        places = places_lit(camera.trigger(1 << laser, exposure_s).image, [dark], saturation_dn)
        if places is not None:
            times_s += [_steady_after_s(camera, lasers, mask, places, exposure_s) for mask in (0, 1 << laser)]
        lasers.set_mask(0)
    if not times_s:
        raise DeviceError("--settle auto", "no laser shows in the image", "say how long, such as --settle 0.05")
    return MARGIN * max(times_s)


def _steady_after_s(
    camera: CameraDriver, lasers: LaserDriver, mask: int, places: LitPlaces, exposure_s: float | None
) -> float:
    """When the first of the frames was triggered from which on all are steady, after switching to `mask`."""
    lasers.set_mask(mask)
    began_s = time.monotonic()
    steady_s = triggered_s = 0.0
    was_steady = False
    while triggered_s < MAX_DURATION_S:
        triggered_s = time.monotonic() - began_s
        share = places.share_of_light(camera.trigger(mask, exposure_s).image)
        is_steady = share >= STEADY if mask else share <= 1 - STEADY
        steady_s = steady_s if was_steady and is_steady else triggered_s
        was_steady = is_steady
    return steady_s
