"""Camera and laser URIs -> a source of shots; reads the files of recordings and simulated scenes."""

from collections.abc import Container, Iterable, Iterator
from dataclasses import replace
from itertools import chain, islice
from pathlib import Path

from ringpose.capture.cameras.recorded import Recording
from ringpose.capture.lasers.uncontrolled import UncontrolledLasers
from ringpose.capture.latest_frame import paced
from ringpose.capture.source import (
    CaptureRequest,
    OnRead,
    Source,
    camera_source,
    capture_record,
    device_source,
    laser_driver,
    names_by_time,
    switched_steps,
)
from ringpose.capture.uri import CAMERAS, LASERS, device_uri, scheme_and_rest, schemes
from ringpose.cli import messages
from ringpose.cli.batch import Batch
from ringpose.errors import NoInputError, UsageError
from ringpose.files.images.shots import SHOT_SUFFIXES, read_shot
from ringpose.files.inputs import Input, Problem, inputs, path_of_input
from ringpose.types.image import Shot, name_order
from ringpose.types.options import STDIN
from ringpose.types.session import Step, steps_of


def source_of(request: CaptureRequest, batch: Batch) -> Source:
    """The source that the URIs name; bad shots of a recording are reported through the batch."""
    scheme, rest = scheme_and_rest(request.camera, "--camera", schemes(CAMERAS))
    request = replace(request, report=messages.echo)
    if scheme == "files":
        return _recorded(rest, request, batch)
    if scheme == "tcp":
        return _served(request)
    return _simulated(Path(rest), request) if scheme == "sim" else camera_source(request)


def _recorded(pattern: str, request: CaptureRequest, batch: Batch) -> Source:
    """The shots and images of a folder, a pattern, or the names on standard input."""
    if request.lasers is not None:
        scheme_and_rest(request.lasers, "--lasers", schemes(LASERS))
    if request.lasers not in (None, "none:"):
        raise UsageError("--lasers", f'"{request.lasers}" cannot light what is recorded', "leave it out")
    if request.exposure_s is not None or any(step.exposure for step in request.steps or ()):
        raise UsageError("--exposure", "what is recorded has been exposed", "leave it out")
    if request.settle_s is not None or request.allow_missing:
        raise UsageError("--settle, --allow-unseen", "the lasers of what is recorded were switched", "leave them out")
    items = batch.valid_inputs(inputs([STDIN], SHOT_SUFFIXES) if pattern == STDIN else _matching_inputs(pattern))
    first = next(items, None)  # read before the session is created: a source without any input leaves none behind
    if first is None:
        batch.finish()
    items = chain([] if first is None else [first], items)
    return Source(
        capture=capture_record(request),
        shots=lambda on_read, _: paced(
            islice(_recorded_shots(items, request, batch, on_read), request.count), request.rate_hz, request.duration_s
        ),
        folders=_folders([first] if pattern == STDIN else _matches(pattern)),
    )


def _matching_inputs(pattern: str) -> Iterator[Input | Problem]:
    try:
        matches = _matches(pattern)
    except OSError as error:
        return iter([NoInputError(pattern, f"cannot be opened: {(error.strerror or str(error)).lower()}")])
    return inputs(matches, SHOT_SUFFIXES) if matches else iter([NoInputError(pattern, "does not exist")])


def _matches(pattern: str) -> list[Path]:
    path = Path(pattern)
    if path.exists():
        return [path]
    matches = Path(path.anchor or ".").glob(str(path.relative_to(path.anchor)))
    return sorted(matches, key=lambda match: name_order(str(match)))


def _recorded_shots(items: Iterable[Input], request: CaptureRequest, batch: Batch, on_read: OnRead) -> Iterator[Shot]:
    recording = Recording(request.steps)
    for item in items:
        with batch.guarded():
            path = path_of_input(item)
            shot = recording.taken(read_shot(path, request.channel))
            on_read(path)
            if shot is not None:
                yield shot
    with batch.guarded():
        recording.end()


def _folders(items: Iterable[Input | None]) -> frozenset[Path]:
    paths = [item.resolve() for item in items if isinstance(item, Path)]
    return frozenset(path if path.is_dir() else path.parent for path in paths)


def _simulated(scene_file: Path, request: CaptureRequest) -> Source:
    """The scene's own camera; each shot is its next view."""
    from ringpose.capture.cameras.driver import CameraDescription
    from ringpose.capture.cameras.simulated import SimulatedCamera
    from ringpose.files.scenes.scene import read_scene
    from ringpose.optics.sensor import saturation_dn
    from ringpose.simulate.pipeline import SceneFrames

    scene = read_scene(scene_file)
    frames, rig_camera = SceneFrames(scene), scene.rig.camera
    lasers_uri = "sim:" if request.lasers is None else request.lasers
    request = replace(request, lasers=lasers_uri, laser_names=scene.rig.lasers.names)
    lasers = laser_driver(request, None)
    description = CameraDescription(
        name=rig_camera.camera_name,
        image_width=rig_camera.image_width,
        image_height=rig_camera.image_height,
        saturation_dn=saturation_dn(scene.sensor),
    )
    camera = SimulatedCamera(description, frames, lasers)
    if not request.steps:
        always_on = isinstance(lasers, UncontrolledLasers)
        request = replace(request, steps=(Step("all"),) if always_on else steps_of(scene.sequence, lasers.count))

    def names(existing: Container[str]) -> Iterator[str]:
        for view in frames.views:
            if view.name in existing:
                camera.skip()
            else:
                yield view.name

    return device_source(request, camera, lasers, names, scene_file)


def _served(request: CaptureRequest) -> Source:
    """The frames of an image server, which switches the lasers itself; shots have the names that it gives them."""
    from ringpose.capture.cameras.tcp import TcpCamera
    from ringpose.files.io import read_secret

    if request.lasers not in (None, "sim:"):
        raise UsageError("--lasers", f'"{request.lasers}" cannot light a simulated scene', "leave it out")
    uri = device_uri(request.camera, "--camera", CAMERAS)
    secret_file = uri.parameters.get("secret-file")
    camera = TcpCamera(uri, None if secret_file is None else read_secret(Path(secret_file)))
    with camera:
        greeting = camera.greeting
    request = replace(request, lasers="sim:", laser_names=greeting.lasers)
    lasers = laser_driver(request, None)
    camera.commands_lasers = request.choose is not None and not request.steps
    steps = switched_steps(lasers.count) if camera.commands_lasers else steps_of(greeting.sequence, lasers.count)
    request = replace(request, steps=request.steps or steps)
    source = device_source(request, camera, lasers, lambda _: names_by_time())
    if camera.commands_lasers:
        return replace(source, waits_for_consumer=greeting.clock == "lockstep")

    def shots(on_read: OnRead, existing: Container[str]) -> Iterator[Shot]:
        for shot in source.shots(on_read, existing):
            yield replace(shot, meta={**shot.meta, "simulated": True})

    return replace(source, shots=shots, waits_for_consumer=greeting.clock == "lockstep")
