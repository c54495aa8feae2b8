"""Capture requests, and the sources of shots that fulfil them: a camera with the device that switches its lasers.

Recorded shots and simulated scenes are read from files, which this layer does not do; `cli.acquisition` makes their
sources with `device_source` and `capture_record`.
"""

from collections.abc import Callable, Container, Iterator
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import count, islice
from pathlib import Path
from typing import Literal

from ringpose.capture.cameras.driver import CameraDriver
from ringpose.capture.cameras.simulated import SimulatedLasers
from ringpose.capture.lasers.driver import LaserContext, LaserDriver
from ringpose.capture.lasers.uncontrolled import UncontrolledLasers, reject_switching
from ringpose.capture.latest_frame import paced
from ringpose.capture.uri import CAMERAS, LASERS, device_uri, driver
from ringpose.errors import UsageError
from ringpose.types.image import Frame, Shot
from ringpose.types.rig import Rig
from ringpose.types.session import Capture, Step, written_sequence

Choice = Callable[[tuple[Step, ...]], tuple[Step, ...]]
"""Returns the steps of the next shot; called with those of a shot that switches the lasers one by one."""

OnRead = Callable[[Path], None]
"""Called with each file that is read."""


OFF_EVERY = 10
"""Number of shots with all lasers on for each frame without lasers, which shows the background."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureRequest:
    """The options of a capture; None leaves a setting to the device or the recording."""

    camera: str
    """URI."""
    lasers: str | None = None
    """URI."""
    steps: tuple[Step, ...] | None = None
    choose: Choice | None = None
    """Chooses the steps of each shot where `steps` is None and the lasers can be switched."""
    exposure_s: float | Literal["auto"] | None = None
    count: int | None = None
    rate_hz: float | None = None
    duration_s: float | None = None
    settle_s: float | Literal["auto"] | None = None
    allow_missing: bool = False
    """Whether to keep a shot in which a commanded laser is not seen."""
    channel: str | None = None
    laser_names: tuple[str, ...] | None = None
    """Names of the rig's lasers; None where no rig is given."""
    rig: Rig | None = None
    """Rig of the camera; an automatic exposure is that of the stripes on the ring's face if it is given."""
    yields_lost: bool = False
    """Whether shots that are lost to changing ambient light are yielded (`Procedure.yields_lost`)."""
    report: Callable[[str], None] = lambda _: None
    """Receives messages about the capture (`Procedure.report`)."""
    on_frame: Callable[[Frame, int], None] = lambda _frame, _saturation_dn: None
    """Receives each frame as soon as it has arrived, and its saturation value (`Procedure.on_frame`)."""

    @property
    def fixed_exposure_s(self) -> float | None:
        """The exposure, or None if it is automatic or left to the device."""
        return None if self.exposure_s == "auto" else self.exposure_s


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """A camera with its lasers, or a recording, from which shots are taken."""

    capture: Capture
    shots: Callable[[OnRead, Container[str]], Iterator[Shot]]
    """Takes the shots, given what to call with each file that is read, and names of shots that exist already.

    A scene continues after the views of these names.
    """
    folders: frozenset[Path] = frozenset()
    """Folders of recorded shots, as far as they are known before reading."""
    devices: tuple[()] | tuple[CameraDriver, LaserDriver] = ()
    """Context managers to be entered, in this order, while shots are taken."""
    abort: Callable[[], None] | None = None
    """Switches the lasers off, also while another thread takes shots."""
    waits_for_consumer: bool = False
    """Whether time stands still between shots, so that none need be skipped."""
    camera_name: Callable[[], str | None] = lambda: None
    """The name that the camera reports, once it is entered."""


def camera_source(request: CaptureRequest) -> Source:
    """The source of a real camera; by default, each laser is on in one frame, between two dark frames."""
    uri = device_uri(request.camera, "--camera", CAMERAS)
    camera = driver(CAMERAS, uri.scheme)(uri)
    lasers = laser_driver(request, camera)
    steps = request.steps
    choose = None if steps or isinstance(lasers, UncontrolledLasers) else request.choose
    if not steps and isinstance(lasers, UncontrolledLasers):
        steps = (Step("all"),)
    request = replace(request, steps=steps or switched_steps(lasers.count), choose=choose)
    return device_source(request, camera, lasers, lambda _: names_by_time())


def switched_steps(count: int) -> tuple[Step, ...]:
    """Steps in which each of `count` lasers is on alone, between two frames without lasers."""
    return (Step("off"), *(Step(str(number + 1)) for number in range(count)), Step("off"))


class TrackedSequence:
    """Chooses the lasers of each shot: all at once while the track reports that it can assign their stripes.

    A frame with all lasers on has a single time, so that the target does not move within it.
    """

    def __init__(self) -> None:
        self._is_assigned = False
        self._since_off = 0

    def report(self, *, is_assigned: bool) -> None:
        """Set whether the track will assign the stripes of the next frame with all lasers on; from any thread."""
        self._is_assigned = is_assigned

    def __call__(self, switched: tuple[Step, ...]) -> tuple[Step, ...]:
        """The steps of the next shot; `switched` are the steps of a shot in which each laser has its own frame."""
        if not self._is_assigned:
            self._since_off = 0  # switched shots begin and end without lasers
            return switched
        self._since_off += 1
        if self._since_off < OFF_EVERY:
            return (Step("all"),)
        self._since_off = 0
        return (Step("off"), Step("all"))


def laser_driver(request: CaptureRequest, camera: CameraDriver | None) -> LaserDriver:
    """The driver of the lasers' URI, `none:` if there is none; `camera` may switch them by its output lines."""
    uri = device_uri("none:" if request.lasers is None else request.lasers, "--lasers", LASERS)
    return driver(LASERS, uri.scheme)(uri, LaserContext(names=request.laser_names, camera=camera))


def device_source(
    request: CaptureRequest,
    camera: CameraDriver,
    lasers: LaserDriver,
    names: Callable[[Container[str]], Iterator[str]],
    scene_file: Path | None = None,
) -> Source:
    """The source that takes shots from devices by the steps of the request.

    `names` receives the existing names of shots and yields new ones.
    """
    from ringpose.capture.pipeline import Procedure, captured_shots

    steps = request.steps or ()
    if isinstance(lasers, UncontrolledLasers):
        reject_switching(steps)
    for step in steps:
        step.mask(lasers.count)  # rejects lasers that the rig does not have
    if request.exposure_s == "auto" and any(step.exposure for step in steps):
        raise UsageError("--exposure", "auto, and the sequence has exposures of its own", "leave one of them out")
    settle_s = lasers.settle_s if request.settle_s is None else request.settle_s
    procedure = Procedure(
        steps=steps,
        choose=request.choose,
        exposure_s=request.fixed_exposure_s,
        is_exposure_auto=request.exposure_s == "auto",
        rig=request.rig,
        settle_s=None if settle_s == "auto" else settle_s,
        must_see=not isinstance(lasers, UncontrolledLasers | SimulatedLasers) and not request.allow_missing,
        yields_lost=request.yields_lost,
        report=request.report,
        on_frame=request.on_frame,
    )
    # A frame that lasts longer than the watchdog waits would show lasers going off.
    on_s = (procedure.settle_s or 0.0) + max(step.exposure_s or procedure.exposure_s or 0.0 for step in steps)
    if lasers.longest_on_s is not None and on_s >= lasers.longest_on_s:
        finding = f"a laser would be on for {on_s:g} s, and the watchdog of the lasers allows {lasers.longest_on_s:g} s"
        raise UsageError("--exposure", finding, "raise heartbeat= and longest_on= in --lasers")

    def shots(on_read: OnRead, existing: Container[str]) -> Iterator[Shot]:
        if scene_file is not None:
            on_read(scene_file)
        due = paced(islice(names(existing), request.count), request.rate_hz, request.duration_s, lasers.wait)
        return captured_shots(camera, lasers, procedure, due)

    return Source(
        capture=replace(capture_record(request), laser_count=lasers.count, laser_names=request.laser_names),
        shots=shots,
        devices=(camera, lasers),
        abort=lasers.abort,
        camera_name=lambda: camera.describe().name,
    )


def capture_record(request: CaptureRequest) -> Capture:
    """The entry of the session file, as far as it follows from the request."""
    return Capture(
        camera=request.camera,
        lasers="none:" if request.lasers is None else request.lasers,
        sequence=None if request.steps is None else written_sequence(request.steps),
        exposure_s=request.fixed_exposure_s,
        rate_hz=request.rate_hz,
    )


def names_by_time() -> Iterator[str]:
    """Names of shots: the time of the first and a number from 1, such as `20260101T000000Z_000001`."""
    began = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
    for number in count(1):
        yield f"{began}_{number:06d}"
