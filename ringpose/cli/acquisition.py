"""Camera and laser URIs -> shots."""

from collections.abc import Callable, Container, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import chain, count, islice
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from ringpose.capture.cameras.driver import CameraDriver
from ringpose.capture.cameras.recorded import Recording
from ringpose.capture.lasers.driver import LaserDriver
from ringpose.capture.lasers.simulated import SimulatedLasers
from ringpose.capture.lasers.uncontrolled import UncontrolledLasers, refuse_switching
from ringpose.capture.latest_frame import paced
from ringpose.capture.uri import CAMERAS, LASERS, scheme_and_rest, schemes
from ringpose.cli.batch import Batch
from ringpose.errors import NoInputError, UsageError
from ringpose.files.inputs import STDIN, Input, Problem, inputs
from ringpose.files.shots import SHOT_SUFFIXES, read_shot
from ringpose.files.sources import file_named
from ringpose.types.image import Shot
from ringpose.types.sequence import Step, steps_of, written_sequence
from ringpose.types.session import Capture

if TYPE_CHECKING:
    from ringpose.capture.pipeline import Procedure

ReadFrom = Callable[[Path], None]
"""Is told of each file that is read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CaptureRequest:
    """What the user asks for; None leaves it to the device or the recording."""

    camera: str
    lasers: str | None = None
    steps: tuple[Step, ...] | None = None
    exposure_s: float | None = None
    count: int | None = None
    rate_hz: float | None = None
    duration_s: float | None = None
    settle_s: float | Literal["auto"] | None = None
    allow_missing: bool = False
    """Whether a shot counts in which a laser that was commanded does not show."""
    channel: str | None = None
    laser_names: tuple[str, ...] | None = None
    """Of the rig's lasers; None where no rig is given."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Where shots come from."""

    capture: Capture
    shots: Callable[[ReadFrom, Container[str]], Iterator[Shot]]
    """The shots; those of a scene go on behind the names that there are already."""
    folders: frozenset[Path] = frozenset()
    """Where recorded shots lie, as far as it is known before they are read."""
    devices: tuple[AbstractContextManager[None], ...] = ()
    """To be entered, in this order, while shots are taken."""
    abort: Callable[[], None] | None = None
    """Switches the lasers off although another thread takes shots."""
    camera_name: Callable[[], str | None] = lambda: None
    """What the camera calls itself, once it is entered."""


def source_of(wanted: CaptureRequest, batch: Batch) -> Source:
    """The source that the URIs name; bad shots of a recording are the batch's business."""
    scheme, rest = scheme_and_rest(wanted.camera, "--camera", schemes(CAMERAS))
    if scheme == "files":
        return _recorded(rest, wanted, batch)
    return _simulated(Path(rest), wanted) if scheme == "sim" else _taken(wanted)


def _recorded(pattern: str, wanted: CaptureRequest, batch: Batch) -> Source:
    if wanted.lasers is not None:
        scheme_and_rest(wanted.lasers, "--lasers", schemes(LASERS))
    if wanted.lasers not in (None, "none:"):
        raise UsageError("--lasers", f'"{wanted.lasers}" cannot light what is recorded', "leave it out")
    if wanted.exposure_s is not None or any(step.exposure for step in wanted.steps or ()):
        raise UsageError("--exposure", "what is recorded has been exposed", "leave it out")
    named = batch.good(inputs([STDIN], SHOT_SUFFIXES) if pattern == STDIN else _named(pattern))
    first = next(named, None)
    if first is None:
        batch.finish()
    items = chain([first] if first is not None else [], named)
    return Source(
        capture=_capture(wanted, "none:"),
        shots=lambda read_from, _: paced(
            islice(_recorded_shots(items, wanted, batch, read_from), wanted.count), wanted.rate_hz, wanted.duration_s
        ),
        folders=_folders([first] if pattern == STDIN else _matches(pattern)),
    )


def _simulated(scene_file: Path, wanted: CaptureRequest) -> Source:
    """The scene's own camera; every shot is the next of its views."""
    from ringpose.capture.cameras.driver import CameraDescription
    from ringpose.capture.cameras.simulated import SimulatedCamera
    from ringpose.files.scenes import read_scene
    from ringpose.simulate.pipeline import SceneFrames
    from ringpose.simulate.sensor import saturation_dn

    scene = read_scene(scene_file)
    frames, rig_camera = SceneFrames(scene), scene.rig.camera
    switch = "sim:" if wanted.lasers is None else wanted.lasers
    wanted = replace(wanted, lasers=switch, laser_names=scene.rig.lasers.names)
    lasers = _lasers(wanted, None)
    description = CameraDescription(
        name=rig_camera.camera_name,
        image_width=rig_camera.image_width,
        image_height=rig_camera.image_height,
        saturation_dn=saturation_dn(scene.sensor),
    )
    steps = wanted.steps or (
        (Step("all"),) if isinstance(lasers, UncontrolledLasers) else steps_of(scene.sequence, lasers.count)
    )
    camera = SimulatedCamera(description, frames, lasers)

    def names(there: Container[str]) -> Iterator[str]:
        for view in frames.views:
            if view.name in there:
                camera.skip()
            else:
                yield view.name

    return _of_devices(replace(wanted, steps=steps), camera, lasers, names, scene_file)


def _taken(wanted: CaptureRequest) -> Source:
    """A camera, and what switches its lasers; without a wish each laser in turn between two frames without any."""
    from ringpose.capture.uri import device_uri, driver

    uri = device_uri(wanted.camera, "--camera", CAMERAS)
    camera = driver(CAMERAS, uri.scheme)(uri)
    lasers = _lasers(wanted, camera)
    steps = wanted.steps or _each_laser(lasers)
    return _of_devices(replace(wanted, steps=steps), camera, lasers, lambda _: names_by_time(), None)


def _lasers(wanted: CaptureRequest, camera: CameraDriver | None) -> LaserDriver:
    from ringpose.capture.lasers.driver import LaserPlace
    from ringpose.capture.uri import device_uri, driver

    uri = device_uri("none:" if wanted.lasers is None else wanted.lasers, "--lasers", LASERS)
    lasers: LaserDriver = driver(LASERS, uri.scheme)(uri, LaserPlace(names=wanted.laser_names, camera=camera))
    return lasers


def _of_devices(
    wanted: CaptureRequest,
    camera: CameraDriver,
    lasers: LaserDriver,
    names: Callable[[Container[str]], Iterator[str]],
    read: Path | None,
) -> Source:
    """Shots under names beside those there are, by the steps that are wanted; `read` is a file that they come from."""
    from ringpose.capture.pipeline import Procedure, captured_shots

    steps = wanted.steps or ()
    if isinstance(lasers, UncontrolledLasers):
        refuse_switching(steps)
    for step in steps:
        step.mask(lasers.count)
    procedure = Procedure(
        steps=steps,
        exposure_s=wanted.exposure_s,
        settle_s=_settle_s(wanted, lasers),
        must_see=not isinstance(lasers, UncontrolledLasers | SimulatedLasers) and not wanted.allow_missing,
    )
    _refuse_long_light(procedure, lasers)

    def shots(read_from: ReadFrom, there: Container[str]) -> Iterator[Shot]:
        if read is not None:
            read_from(read)
        due = paced(islice(names(there), wanted.count), wanted.rate_hz, wanted.duration_s, lasers.wait)
        return captured_shots(camera, lasers, procedure, due)

    capture = replace(_capture(wanted, "none:"), laser_count=lasers.count, laser_names=wanted.laser_names)
    return Source(
        capture=capture,
        shots=shots,
        devices=(camera, lasers),
        abort=lasers.abort,
        camera_name=lambda: camera.describe().name,
    )


def _refuse_long_light(procedure: "Procedure", lasers: LaserDriver) -> None:
    """A frame that lasts longer than the guard waits would show lasers going off."""
    exposures_s = [step.exposure_s or procedure.exposure_s or 0.0 for step in procedure.steps]
    lasts_s, limit_s = (procedure.settle_s or 0.0) + max(exposures_s), lasers.longest_on_s
    if limit_s is not None and lasts_s >= limit_s:
        found = f"a laser would be on for {lasts_s:g} s, and the guard of the lasers allows {limit_s:g} s"
        raise UsageError("--exposure", found, "raise heartbeat= and longest_on= in --lasers")


def _settle_s(wanted: CaptureRequest, lasers: LaserDriver) -> float | None:
    """None if it is to be measured."""
    if wanted.settle_s == "auto":
        return None
    return lasers.settle_s if wanted.settle_s is None else wanted.settle_s


def _each_laser(lasers: LaserDriver) -> tuple[Step, ...]:
    if isinstance(lasers, UncontrolledLasers):
        return (Step("all"),)
    return (Step("off"), *(Step(str(number + 1)) for number in range(lasers.count)), Step("off"))


def names_by_time() -> Iterator[str]:
    """`20260101T000000Z_000001`, counted from 1: no two runs give the same."""
    began = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
    for number in count(1):
        yield f"{began}_{number:06d}"


def _named(pattern: str) -> Iterator[Input | Problem]:
    """The files of a folder or a pattern."""
    try:
        found = _matches(pattern)
    except OSError as error:
        return iter([NoInputError(pattern, f"cannot be opened: {(error.strerror or str(error)).lower()}")])
    return inputs(found, SHOT_SUFFIXES) if found else iter([NoInputError(pattern, "does not exist")])


def _matches(pattern: str) -> list[Path]:
    path = Path(pattern)
    if path.exists():
        return [path]
    return sorted(Path(path.anchor or ".").glob(str(path.relative_to(path.anchor))))


def _folders(items: Iterable[Input | None]) -> frozenset[Path]:
    paths = [item.resolve() for item in items if isinstance(item, Path)]
    return frozenset(path if path.is_dir() else path.parent for path in paths)


def _recorded_shots(
    items: Iterable[Input], wanted: CaptureRequest, batch: Batch, read_from: ReadFrom
) -> Iterator[Shot]:
    recording = Recording(wanted.steps)
    for item in items:
        with batch.item():
            path = file_named(item)
            shot = recording.taken(read_shot(path, wanted.channel))
            read_from(path)
            if shot is not None:
                yield shot
    with batch.item():
        recording.end()


def _capture(wanted: CaptureRequest, lasers: str) -> Capture:
    return Capture(
        camera=wanted.camera,
        lasers=lasers if wanted.lasers is None else wanted.lasers,
        sequence=None if wanted.steps is None else written_sequence(wanted.steps),
        exposure_s=wanted.exposure_s,
        rate_hz=wanted.rate_hz,
    )
