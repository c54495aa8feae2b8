"""Camera and laser URIs -> shots."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from itertools import chain, count, islice
from pathlib import Path

from ringpose.capture.cameras.recorded import Recording
from ringpose.capture.lasers.driver import LaserDriver
from ringpose.capture.lasers.simulated import SimulatedLasers
from ringpose.capture.lasers.uncontrolled import UncontrolledLasers, refuse_switching
from ringpose.capture.pace import paced
from ringpose.capture.uri import CAMERAS, LASERS, scheme_and_rest, schemes
from ringpose.cli.batch import Batch
from ringpose.errors import DataError, NoInputError, UsageError
from ringpose.files.inputs import STDIN, Input, Problem, Record, inputs
from ringpose.files.shots import SHOT_SUFFIXES, read_shot
from ringpose.types.frame import Shot
from ringpose.types.sequence import Step, steps_of
from ringpose.types.session import Capture

ReadFrom = Callable[[Path], None]
"""Is told of each file that is read."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Wanted:
    """What the user asks for; None leaves it to the device or the recording."""

    camera: str
    lasers: str | None = None
    steps: tuple[Step, ...] | None = None
    exposure_s: float | None = None
    count: int | None = None
    rate_hz: float | None = None
    channel: str | None = None
    laser_names: tuple[str, ...] | None = None
    """Of the rig's lasers; None where no rig is given."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Source:
    """Where shots come from."""

    capture: Capture
    shots: Callable[[ReadFrom], Iterator[Shot]]
    folders: frozenset[Path] = frozenset()
    """Where recorded shots lie, as far as it is known before they are read."""
    devices: tuple[AbstractContextManager[None], ...] = ()
    """To be entered, in this order, while shots are taken."""


def source_of(wanted: Wanted, batch: Batch) -> Source:
    """The source that the URIs name; bad shots of a recording are the batch's business."""
    scheme, rest = scheme_and_rest(wanted.camera, "--camera", schemes(CAMERAS))
    _, words = ("", "") if wanted.lasers is None else scheme_and_rest(wanted.lasers, "--lasers", schemes(LASERS))
    if words and scheme in ("files", "sim"):
        raise UsageError("--lasers", f'"{wanted.lasers}" has words after its colon', "leave them out")
    if scheme == "files":
        return _recorded(rest, wanted, batch)
    return _simulated(Path(rest), wanted) if scheme == "sim" else _taken(wanted)


def _recorded(pattern: str, wanted: Wanted, batch: Batch) -> Source:
    if wanted.lasers not in (None, "none:"):
        raise UsageError("--lasers", f'"{wanted.lasers}" cannot light what is recorded', "leave it out")
    if wanted.exposure_s is not None:
        raise UsageError("--exposure", "what is recorded has been exposed", "leave it out")
    named = batch.good(inputs([STDIN], SHOT_SUFFIXES) if pattern == STDIN else _named(pattern))
    first = next(named, None)
    if first is None:
        batch.finish()
    items = chain([first] if first is not None else [], named)
    return Source(
        capture=_capture(wanted, "none:"),
        shots=lambda read_from: paced(
            islice(_recorded_shots(items, wanted, batch, read_from), wanted.count), wanted.rate_hz
        ),
        folders=_folders([first] if pattern == STDIN else _matches(pattern)),
    )


def _simulated(scene_file: Path, wanted: Wanted) -> Source:
    """The scene's own camera; every shot is the next of its views."""
    from ringpose.capture.cameras.driver import CameraDescription
    from ringpose.capture.cameras.simulated import SimulatedCamera
    from ringpose.capture.pipeline import captured_shots
    from ringpose.files.scenes import read_scene
    from ringpose.simulate.pipeline import SceneFrames
    from ringpose.simulate.sensor import saturation_dn

    scene = read_scene(scene_file)
    frames, rig_camera, laser_count = SceneFrames(scene), scene.rig.camera, len(scene.rig.lasers.names)
    lasers, steps = _lasers_and_steps(wanted, laser_count, scene.sequence)
    description = CameraDescription(
        name=rig_camera.camera_name,
        image_width=rig_camera.image_width,
        image_height=rig_camera.image_height,
        saturation_dn=saturation_dn(scene.sensor),
    )
    camera = SimulatedCamera(description, frames, lasers)
    names = islice((view.name for view in frames.views), wanted.count)

    def shots(read_from: ReadFrom) -> Iterator[Shot]:
        read_from(scene_file)
        return captured_shots(camera, lasers, steps, paced(names, wanted.rate_hz), wanted.exposure_s)

    capture = replace(_capture(replace(wanted, steps=steps), "sim:"), camera_name=description.name)
    return Source(capture=replace(capture, laser_count=laser_count), shots=shots, devices=(camera, lasers))


def _taken(wanted: Wanted) -> Source:
    """A camera, and what switches its lasers; without a wish each laser in turn between two frames without any."""
    from ringpose.capture.lasers.place import LaserPlace
    from ringpose.capture.pipeline import captured_shots
    from ringpose.capture.uri import device_uri, driver

    camera_uri = device_uri(wanted.camera, "--camera", CAMERAS)
    lasers_uri = device_uri(wanted.lasers or "none:", "--lasers", LASERS)
    camera = driver(CAMERAS, camera_uri.scheme)(camera_uri)
    lasers = driver(LASERS, lasers_uri.scheme)(lasers_uri, LaserPlace(names=wanted.laser_names, camera=camera))
    steps = wanted.steps or _each_laser(lasers)
    if isinstance(lasers, UncontrolledLasers):
        refuse_switching(steps)
    for step in steps:
        step.mask(lasers.count)

    def shots(read_from: ReadFrom) -> Iterator[Shot]:
        names = paced(islice(names_by_time(), wanted.count), wanted.rate_hz)
        return captured_shots(camera, lasers, steps, names, wanted.exposure_s)

    capture = replace(_capture(replace(wanted, steps=steps), "none:"), laser_count=lasers.count)
    return Source(capture=capture, shots=shots, devices=(camera, lasers))


def _each_laser(lasers: LaserDriver) -> tuple[Step, ...]:
    if isinstance(lasers, UncontrolledLasers):
        return (Step("all"),)
    return (Step("off"), *(Step(str(number + 1)) for number in range(lasers.count)), Step("off"))


def names_by_time() -> Iterator[str]:
    """`20260101T000000Z_0001`, counted from 1: no two runs give the same."""
    began = f"{datetime.now(UTC):%Y%m%dT%H%M%SZ}"
    for number in count(1):
        yield f"{began}_{number:04d}"


def _lasers_and_steps(
    wanted: Wanted, laser_count: int, sequence: Iterable[int]
) -> tuple[LaserDriver, tuple[Step, ...]]:
    """The lasers, and the steps that they can go; without a wish those of the scene."""
    if wanted.lasers == "none:":
        steps = wanted.steps or steps_of([(1 << laser_count) - 1], laser_count)
        refuse_switching(steps)
        return UncontrolledLasers(laser_count), steps
    steps = wanted.steps or steps_of(sequence, laser_count)
    for step in steps:
        step.mask(laser_count)
    return SimulatedLasers(laser_count), steps


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


def _recorded_shots(items: Iterable[Input], wanted: Wanted, batch: Batch, read_from: ReadFrom) -> Iterator[Shot]:
    recording = Recording(wanted.steps)
    for item in items:
        with batch.item():
            if isinstance(item, Record):
                raise DataError(item.place, "is a record", "the name of a shot or image is wanted")
            shot = recording.taken(read_shot(item, wanted.channel))
            read_from(item)
            if shot is not None:
                yield shot
    with batch.item():
        recording.end()


def _capture(wanted: Wanted, lasers: str) -> Capture:
    return Capture(
        camera=wanted.camera,
        lasers=wanted.lasers or lasers,
        sequence=None if wanted.steps is None else ",".join(step.text for step in wanted.steps),
        exposure_s=wanted.exposure_s,
        rate_hz=wanted.rate_hz,
    )
