"""Rendering and measurement for the console, in a thread of their own: always the newest state, only while watched."""

import threading
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from ringpose.bench.score import estimate_of, score
from ringpose.console.state import ConsoleState
from ringpose.detect.pipeline import detect
from ringpose.errors import DataError
from ringpose.pose.record import pose_line
from ringpose.report.overlay import overlay, picture_of
from ringpose.simulate.exposure import view_exposure_s
from ringpose.simulate.pipeline import illuminated_ring, render_ring_view, view_truth
from ringpose.simulate.placement import READOUT_S
from ringpose.simulate.serve.preview import preview
from ringpose.types.arrays import Array, UInt8
from ringpose.types.camera import Camera
from ringpose.types.image import Shot
from ringpose.types.pose import PoseLine
from ringpose.types.rig import Rig
from ringpose.types.scene import Scene
from ringpose.types.truth import Truth

QUICK_WIDTH = 240
"""Width of the first picture of a new state, which comes without a measurement."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConsolePicture:
    """What the console shows of one state."""

    state: ConsoleState
    image: UInt8[Array, "row column 3"]
    """Blue, green, red."""
    rig: Rig
    """Of the images of this picture."""
    truth: Truth
    shot: Shot | None = None
    line: PoseLine | None = None
    """None in the first picture of a new state."""
    errors: dict[str, float] | None = None
    """Errors of the pose, as `ringpose bench` names and computes them; empty without a pose."""


class Engine:
    """Renders inside its context; `publish` is called in its thread with each picture."""

    def __init__(self, scene: Scene, width: int, publish: Callable[[ConsolePicture], None]) -> None:
        self._scene, self._width, self._publish = scene, width, publish
        self._changed = threading.Condition()
        self._newest: ConsoleState | None = None
        self._ended = False
        self._cameras: dict[tuple[float, int], Camera] = {}
        self.is_watched: Callable[[], bool] = lambda: True
        self.failure: BaseException | None = None
        self._thread = threading.Thread(target=self._run, name="console engine", daemon=True)

    def __enter__(self) -> "Engine":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._thread.join()

    def show(self, state: ConsoleState) -> None:
        """Show this state as soon as possible, instead of earlier ones that are not rendered yet."""
        with self._changed:
            self._newest = state
            self._changed.notify_all()

    def wait_for_failure(self) -> None:
        """Return when the thread has ended."""
        self._thread.join()

    def _run(self) -> None:
        try:
            while (state := self._next_state()) is not None:
                if not state.time_s:  # while time runs, every picture is measured
                    self._publish(self.picture(state, QUICK_WIDTH, measured=False))
                    if self._has_newer():
                        continue
                self._publish(self.picture(state, self._width, measured=True))
        except BaseException as failure:
            self.failure = failure

    def _next_state(self) -> ConsoleState | None:
        with self._changed:
            while not self._ended and (self._newest is None or not self.is_watched()):
                self._changed.wait(0.2)
            state, self._newest = self._newest, None
            return None if self._ended else state

    def _has_newer(self) -> bool:
        with self._changed:
            return self._newest is not None

    def picture(self, state: ConsoleState, width: int, *, measured: bool) -> ConsolePicture:
        """The picture of a state; of one that cannot be seen, such as from inside the target, a black one with why."""
        try:
            return self._picture(state, width, measured=measured)
        except DataError as problem:
            return _unseen(state, preview(state.scene_of(self._scene), width).rig, problem)

    def _picture(self, state: ConsoleState, width: int, *, measured: bool) -> ConsolePicture:
        scene = self._with_same_camera(preview(state.scene_of(self._scene), width), state.focal_scale)
        view, masks = state.view, scene.sequence
        illuminated = illuminated_ring(scene, view, masks)
        rendered = render_ring_view(scene, view, state.number)
        exposure_s = view_exposure_s(scene, illuminated)
        stamps_s = scene.start_s + state.time_s + np.arange(len(masks)) * (exposure_s + READOUT_S)
        shot = Shot(
            name=view.name,
            images=np.stack(
                [rendered.frame(m, exposure_s, float(s)).image for m, s in zip(masks, stamps_s, strict=True)]
            ),
            lasers=np.array(masks, dtype=np.uint8),
            stamp_s=stamps_s,
            exposure_s=np.full(len(masks), exposure_s),
            meta={"simulated": True, "still": True},  # all frames show one state
        )
        truth = view_truth(scene, view, illuminated)
        picture = ConsolePicture(
            state=state, image=_grey(picture_of(shot)), rig=scene.rig, truth=truth, shot=shot if measured else None
        )
        return self._measured(picture, shot) if measured else picture

    def _with_same_camera(self, scene: Scene, focal_scale: float) -> Scene:
        """The scene with the camera record of earlier pictures: the renderer keeps the rays of a record."""
        key = (focal_scale, scene.rig.camera.image_width)
        if key not in self._cameras:
            self._cameras = {**dict(list(self._cameras.items())[-3:]), key: scene.rig.camera}
        return replace(scene, rig=replace(scene.rig, camera=self._cameras[key]))

    def _measured(self, picture: ConsolePicture, shot: Shot) -> ConsolePicture:
        detection = detect(shot, picture.rig)
        line = pose_line(detection, picture.rig)
        estimate = estimate_of(line, shot.name)
        errors = score(picture.truth, estimate, estimate.method, picture.rig.camera).errors
        return replace(
            picture,
            image=overlay(picture_of(shot), detection, line, picture.rig),
            line=line,
            errors=dict(errors),
        )


def _unseen(state: ConsoleState, rig: Rig, problem: DataError) -> ConsolePicture:
    name, camera = state.view.name, rig.camera
    return ConsolePicture(
        state=state,
        image=np.zeros((camera.image_height, camera.image_width, 3), dtype=np.uint8),
        rig=rig,
        truth=Truth(shot=name, expect="no_target", groups={}),
        line=PoseLine(shot=name, stamp_s=state.time_s, pose=None, reason=str(problem)),
        errors={},
    )


def _grey(image: Array) -> UInt8[Array, "row column 3"]:
    from ringpose.detect.line_segments import eight_bit

    return np.repeat(eight_bit(image)[:, :, None], 3, axis=2)
