"""Camera and lasers -> shots, frame by frame: switch the lasers, wait until they are steady, trigger; then check.

`captured_shots` is the whole procedure. The checks of a finished shot are in `shot_check`.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ringpose.capture.ambient import AmbientChange, lost_shot, same_ambient_light
from ringpose.capture.cameras.driver import CameraDriver
from ringpose.capture.exposure import ExposureControl
from ringpose.capture.hdr import merged_brackets
from ringpose.capture.lasers.driver import LaserDriver, LasersWentOff
from ringpose.capture.settle import measured_settle_s
from ringpose.capture.shot_check import MAX_LOST, TRIES, AmbientLightChanged, MissingLasers, ShotChecker
from ringpose.errors import DeviceError, UsageError
from ringpose.types.image import Frame, Shot
from ringpose.types.rig import Rig
from ringpose.types.session import Step

MIN_SETTLE_S = 0.02
"""Minimum settling time of the attempt that follows the first one with wrong lasers."""

SHARE_OF_LIMIT = 0.5
"""Share of the watchdog's on-time limit that settling and exposure together may use in such an attempt.

The other half is for a busy machine: at least 0.5 s with the default limit.
"""

CHANGES_TO_AWAIT = (0, 1, 2)
"""Ambient-light changes to wait for before the attempts after a lost one, in turn.

None, because most lamps then stay as they are for a while; one, in case a shot takes most of the time between two
changes; two, in case the lamp flashes.
"""

MAX_CUT_SHORT = 6
"""Attempts at one shot that the watchdog may cut short: a busy machine may be late for seconds, and then in time."""

MAX_STEADY_S = 1.0
"""Stop waiting for a change if ambient light has been constant for this long."""

MAX_EXPOSED = 6
"""Number of times that a shot is taken again because its exposure was wrong: a factor of 4 each."""

AUTO_RANGE_S = (2e-5, 0.1)
"""Range of automatic exposures, besides the limits of the camera; half of the lasers' on-time is left for a second
exposure."""

RECONNECT_PAUSES_S = (0.0, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4)
"""Pause before each attempt to open a camera whose connection was lost."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Procedure:
    """How shots are taken."""

    steps: tuple[Step, ...]
    choose: Callable[[tuple[Step, ...]], tuple[Step, ...]] | None = None
    """Returns the steps of the next shot, given these; they have no exposures of their own."""
    exposure_s: float | None = None
    """Exposure of the steps without their own; None for the setting of the device."""
    is_exposure_auto: bool = False
    """Whether the exposure is controlled by the stripes (`ringpose.capture.exposure`); it starts at `exposure_s`."""
    rig: Rig | None = None
    """Rig of the camera: the stripes on the ring's face control the exposure, otherwise all stripes."""
    settle_s: float | None = 0.0
    """Time from switching to triggering; None to measure it before the first shot."""
    must_see: bool = False
    """Whether every commanded laser must be seen in the images of a shot."""
    yields_lost: bool = False
    """Whether a shot that is lost to changing ambient light is yielded (`Shot.is_lost`), instead of taken again."""
    report: Callable[[str], None] = lambda _: None
    """Receives a message when the camera is lost, and at the first shot that is lost to changing ambient light."""
    on_frame: Callable[[Frame, int], None] = lambda _frame, _saturation_dn: None
    """Receives each frame as soon as it has arrived, unless several exposures are merged, and its saturation value."""

    @property
    def exposures_s(self) -> tuple[float, ...]:
        """All exposures that are set; empty if every one is left to the device."""
        exposures = [self.exposure_s, *(step.exposure_s for step in self.steps)]
        return tuple(exposure_s for exposure_s in exposures if exposure_s is not None)


def captured_shots(
    camera: CameraDriver, lasers: LaserDriver, procedure: Procedure, names: Iterable[str]
) -> Iterator[Shot]:
    """One shot for each name, with one frame for each step; all lasers are off whenever a shot is yielded."""
    bounds_us = camera.bounds("ExposureTime") if procedure.exposures_s else None
    min_s, max_s = (0.0, np.inf) if bounds_us is None else (1e-6 * bound for bound in bounds_us)
    for exposure_s in procedure.exposures_s:
        if not min_s <= exposure_s * (1 + 1e-9) or not exposure_s * (1 - 1e-9) <= max_s:
            finding = f"the camera cannot expose for {exposure_s:g} s; it takes {min_s:g} to {max_s:g} s"
            raise UsageError("--exposure, --sequence", finding)
    sequencer = _Sequencer(camera, lasers, procedure)
    for name in names:
        sequencer.choose_steps()
        yield sequencer.shot(name)


class _CameraError(Exception):
    """Wraps a `DeviceError` of the camera, to distinguish it from one of the laser board."""


@contextmanager
def _camera_errors() -> Iterator[None]:
    """Raises a `DeviceError` of the block as a `_CameraError`; a simulated camera may notice that lasers went off."""
    try:
        yield
    except LasersWentOff:
        raise
    except DeviceError as error:
        raise _CameraError(error) from error


class _Findings:
    """What the attempts at one shot have found."""

    def __init__(self) -> None:
        self.of_shots: list[DeviceError] = []
        """Problems of lasers in shots that were checked."""
        self.interruptions: list[DeviceError] = []
        """Why attempts ended before their shot was complete: a slow machine, a lost camera, a board that fails."""
        self.light: AmbientLightChanged | None = None
        """The changes of ambient light in all lost attempts."""

    @property
    def failures(self) -> int:
        """Attempts that failed because of camera or lasers."""
        return len(self.of_shots) + len(self.interruptions)

    @property
    def are_enough(self) -> bool:
        """Whether no further attempt is to be made."""
        cut_short = sum(isinstance(each, LasersWentOff) for each in self.interruptions)
        return self.failures - cut_short >= TRIES or cut_short >= MAX_CUT_SHORT

    @property
    def missing(self) -> int:
        """The mask of the lasers that were commanded but not seen in some attempt."""
        return int(
            np.bitwise_or.reduce([each.lasers for each in self.of_shots if isinstance(each, MissingLasers)] or [0])
        )

    def first(self) -> DeviceError:
        """The finding to raise, with the others attached: what a shot has shown says more than why one broke off.

        Changing ambient light goes first where it alone has used up the attempts.
        """
        of_shots: list[DeviceError] = [error for error in self.of_shots if not isinstance(error, MissingLasers)]
        times = sum(isinstance(error, MissingLasers) for error in self.of_shots)
        if times:
            position = next(i for i, error in enumerate(self.of_shots) if isinstance(error, MissingLasers))
            of_shots.insert(position, MissingLasers(self.missing, times))
        light = [self.light] if self.light is not None else []
        ordered = [*of_shots, *self.interruptions]
        ordered = [*light, *ordered] if not self.are_enough and not self.interruptions else [*ordered, *light]
        return ordered[0].followed_by(*ordered[1:])


class _Sequencer:
    """Takes shots by a procedure; keeps the settling time and the checker's state from shot to shot."""

    def __init__(self, camera: CameraDriver, lasers: LaserDriver, procedure: Procedure) -> None:
        self._camera = camera
        self._lasers = lasers
        self._procedure = procedure
        self._checker = ShotChecker(camera, lasers, must_see=procedure.must_see)
        self._steps = procedure.steps
        """Steps of the shot that is being taken."""
        self._settle_s = 0.0 if procedure.settle_s is None else procedure.settle_s
        self._is_settle_measured = procedure.settle_s is not None
        self._control = self._exposure_control() if procedure.is_exposure_auto else None
        self._was_slow = False
        """Whether the last shot needed a longer settling time."""
        self._lost: list[AmbientChange] = []
        """The changes of ambient light in the attempts that were lost in a row, up to now."""
        self._is_loss_reported = False

    def choose_steps(self) -> None:
        """Choose the steps of the next shot, if that is wanted."""
        if self._procedure.choose is not None:
            self._steps = self._procedure.choose(self._procedure.steps)

    def shot(self, name: str) -> Shot:
        """Take shots until one passes all checks, and return it; with `yields_lost` also one that is lost.

        The first problem is raised, with those of later attempts attached, after `TRIES` attempts that failed because
        of camera or lasers, `MAX_CUT_SHORT` that the watchdog cut short, or `MAX_LOST` in a row that were lost to
        changing ambient light.
        """
        findings = _Findings()
        try:
            shot = self._accepted_shot(name, findings)
            if shot is not None:
                return shot
            self._reject_lasers_in_dark(findings)
        except DeviceError as error:
            findings.interruptions.append(error)
        raise findings.first()

    def _accepted_shot(self, name: str, findings: "_Findings") -> Shot | None:
        """The first shot that passes all checks, or one that is lost and wanted; None after the last attempt."""
        attempts = 0
        while not findings.are_enough and len(self._lost) < MAX_LOST:
            attempts += 1
            try:
                shot = self._attempt(name, len(findings.of_shots), is_first=attempts == 1)
            except LasersWentOff as error:
                self._lasers.set_mask(0)
                findings.interruptions.append(error)
                continue
            except _CameraError as error:
                self._lasers.set_mask(0)
                findings.interruptions.append(self._reconnected(error))
                continue
            checked, problem = self._checker.checked(shot)
            if problem is None:
                is_first = not findings.failures and not self._lost
                return self._completed(checked, len(findings.of_shots), is_first=is_first)
            if isinstance(problem, AmbientLightChanged):
                self._lost += problem.changes
                findings.light = AmbientLightChanged(self._lost, self._checker.never_seen(shot, len(self._lost)))
                self._report_loss(shot.name, findings.light)
                if self._procedure.yields_lost and len(self._lost) < MAX_LOST:
                    return lost_shot(shot, problem.changes[0])
            else:
                findings.of_shots.append(problem)
        return None

    def _reject_lasers_in_dark(self, findings: "_Findings") -> None:
        """Raise a safety fault if a laser is on while all are off, after attempts that have not shown every laser."""
        self._checker.reject_stripe_in_dark(findings.missing)
        if any(isinstance(each, LasersWentOff) for each in findings.interruptions):
            commanded = [step.mask(self._lasers.count) for step in self._steps]
            self._checker.reject_lasers_in_dark(int(np.bitwise_or.reduce(commanded)))

    def _attempt(self, name: str, wrong: int, *, is_first: bool) -> Shot:
        """A shot whose lasers and ambient light are not checked yet, after so many attempts with wrong lasers."""
        if is_first:  # reconnecting arms the camera, too
            with _camera_errors():
                self._camera.arm(self._procedure.exposure_s)
        self._measure_settle()
        self._await_changes(len(self._lost))
        return self._well_exposed(name, self._settle_after_s(wrong))

    def _report_loss(self, name: str, problem: AmbientLightChanged) -> None:
        """Report the first shot that is lost: a camera beside a lamp that flashes may lose many, for long."""
        if not self._is_loss_reported:
            again = "" if self._procedure.yields_lost else " and taken again"
            finding = f"{problem.location} {problem.finding}; {problem.remedy}"
            self._procedure.report(f"{name}: lost{again}: {finding} (reported once)")
        self._is_loss_reported = True

    def _completed(self, shot: Shot, wrong: int, *, is_first: bool) -> Shot:
        """The accepted shot; its `meta` lists the changes of ambient light in lost attempts, for `lost_attempts_dn`.

        Lost shots that were yielded (`yields_lost`) do not count as attempts at this one.
        A longer settling time is kept for later shots if two shots in a row needed one; a single shot may have been
        disturbed.
        """
        if not is_first:  # a contact may have welded in an attempt that was lost, before its laser was seen
            self._checker.reject_stripe_in_dark(self._checker.unseen(shot))
        if wrong and self._was_slow:
            self._settle_s = self._settle_after_s(wrong)
        self._was_slow = wrong > 0
        sizes_dn, self._lost = [change.size_dn for change in self._lost], []
        if not sizes_dn or self._procedure.yields_lost:
            return shot
        return replace(shot, meta={**shot.meta, "attempts_lost": {"ambient_changed": sizes_dn}})

    def _well_exposed(self, name: str, settle_s: float) -> Shot:
        """A shot, taken again while automatic exposure finds that its exposure was wrong."""
        shot = self._exposed(name, settle_s)
        for _ in range(MAX_EXPOSED):
            if self._control is None or self._control.accepts(shot):
                break
            shot = self._exposed(name, settle_s)
        return shot

    def _exposed(self, name: str, settle_s: float) -> Shot:
        """One frame for each step; all lasers are off at the end."""
        frames, read_masks, switched_mask = [], [], -1
        control = None if self._control is None or self._control.exposures is None else self._control
        is_bracketed = control is not None or any(step.exposure for step in self._procedure.steps)
        saturation_dn = self._camera.describe().saturation_dn
        for step in self._steps:
            mask = step.mask(self._lasers.count)
            self._lasers.set_mask(mask)
            if mask != switched_mask:
                self._lasers.wait(settle_s)
            switched_mask = mask
            for exposure_s in (step.exposure_s,) if control is None else control.of_step(mask):
                frames.append(self._frame(mask, exposure_s))
                read_masks.append(self._lasers.read_mask())
                if not is_bracketed:
                    self._procedure.on_frame(frames[-1], saturation_dn)
        self._lasers.set_mask(0)
        shot = _shot(name, frames, read_masks, {"saturation_dn": saturation_dn, "settle_s": settle_s})
        return merged_brackets(shot) if is_bracketed else shot

    def _exposure_control(self) -> ExposureControl:
        """Automatic exposure within the limits of the camera and of the watchdog of the lasers."""
        bounds_us = self._camera.bounds("ExposureTime")
        min_s, max_s = AUTO_RANGE_S
        if bounds_us is not None:
            min_s, max_s = max(min_s, 1e-6 * bounds_us[0]), min(max_s, 1e-6 * bounds_us[1])
        if self._lasers.longest_on_s is not None:
            max_s = min(max_s, SHARE_OF_LIMIT * self._lasers.longest_on_s / 2 - self._settle_s)
        return ExposureControl(self._procedure.rig, self._lasers.count, min_s, max(min_s, max_s))

    def _frame(self, mask: int, exposure_s: float | None) -> Frame:
        with _camera_errors():
            return self._camera.trigger(mask, exposure_s)

    def _reconnected(self, lost: _CameraError) -> DeviceError:
        """Open the camera again, with all lasers off, in several attempts; raises its error if none succeeds.

        Returns the error to raise if the camera is lost in every attempt at the shot.
        """
        problem: DeviceError = lost.args[0]
        self._camera.close()
        self._procedure.report(f"{problem}; trying to connect again for {sum(RECONNECT_PAUSES_S):.0f} s")
        for pause_s in RECONNECT_PAUSES_S:
            self._lasers.wait(pause_s)
            try:
                self._camera.open()
                self._camera.arm(self._procedure.exposure_s)
            except DeviceError as error:
                problem.followed_by(error)
                self._camera.close()
            else:
                return DeviceError("camera", f"was lost again and again: {problem}")
        raise problem

    def _await_changes(self, lost_attempts: int) -> None:
        """Wait, with all lasers off, for changes of ambient light: a shot begun just after one has the most time."""
        count = CHANGES_TO_AWAIT[(lost_attempts - 1) % len(CHANGES_TO_AWAIT)]
        if not lost_attempts or not count:
            return
        full_dn = self._camera.describe().saturation_dn
        before = self._frame(0, None)
        steady_since_s = before.stamp_s
        while count and before.stamp_s - steady_since_s < MAX_STEADY_S:
            frame = self._frame(0, None)
            if not same_ambient_light(np.stack([before.image, frame.image]), full_dn).all():
                count, steady_since_s = count - 1, frame.stamp_s
            before = frame

    def _measure_settle(self) -> None:
        """Measure the settling time before the first shot, if it is not given."""
        if self._is_settle_measured:
            return
        try:
            self._settle_s = measured_settle_s(self._camera, self._lasers, self._procedure.exposure_s)
        finally:
            self._lasers.set_mask(0)
        self._is_settle_measured = True

    def _settle_after_s(self, wrong: int) -> float:
        """Settling time after attempts with wrong lasers: doubled for each, within what the watchdog allows."""
        if not wrong:
            return self._settle_s
        longer_s = (1 << wrong - 1) * max(2 * self._settle_s, MIN_SETTLE_S)
        limit_s = self._lasers.longest_on_s
        if limit_s is None:
            return longer_s
        spare_s = SHARE_OF_LIMIT * (limit_s - max(self._procedure.exposures_s, default=0.0))
        return max(self._settle_s, min(longer_s, spare_s))


def _shot(name: str, frames: Sequence[Frame], read_masks: Sequence[int | None], meta: dict[str, Any]) -> Shot:
    """The frames as a shot; what some frames do not report is left out for all. Names of the camera come first."""

    def reported(values: Sequence[int | float | None], dtype: type[np.generic]) -> Any:
        return None if any(value is None for value in values) else np.array(values, dtype=dtype)

    attempts, dropped = [frame.attempts for frame in frames], sum(frame.dropped for frame in frames)
    if max(attempts) > 1:
        meta = {**meta, "attempts": attempts}
    if dropped:
        meta = {**meta, "dropped_frames": dropped}
    return Shot(
        name=frames[-1].shot or name,
        images=np.stack([frame.image for frame in frames]),
        lasers=np.array([frame.lasers for frame in frames], dtype=np.uint8),
        stamp_s=np.array([frame.stamp_s for frame in frames], dtype=np.float64),
        exposure_s=np.array([frame.exposure_s for frame in frames], dtype=np.float64),
        device_stamp_s=reported([frame.device_stamp_s for frame in frames], np.float64),
        gain_db=reported([frame.gain_db for frame in frames], np.float64),
        frame_id=reported([frame.frame_id for frame in frames], np.int64),
        read_lasers=reported(read_masks, np.uint8),
        meta=meta,
    )
