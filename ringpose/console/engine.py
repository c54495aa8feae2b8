"""The work behind the console: previews, measurements and pictures, each in a thread of its own.

Each thread works on the newest state only, so that a preview never waits for a measurement; the kernels run in
parallel. States are worked on only while a browser shows the page. While states change, measurements pause after each
one: without the pauses they would take a core from previews and browser.
"""

import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, Generic, TypeVar

import cv2
import numpy as np

from ringpose.bench.score import estimate_of, score
from ringpose.console.state import ConsoleState
from ringpose.errors import DataError
from ringpose.estimate.pose_errors import truth_at
from ringpose.measure.stream import Setup, Stream
from ringpose.report.overlay import captioned, overlay, picture_of
from ringpose.simulate.exposure import view_exposure_s
from ringpose.simulate.pipeline import illuminated_ring, simulated_shot, view_truth
from ringpose.simulate.renderer import render_view
from ringpose.track.explanations import TrackOptions
from ringpose.types.arrays import Array, UInt8
from ringpose.types.image import Shot
from ringpose.types.pose import PoseLine
from ringpose.types.rig import Camera, Rig
from ringpose.types.scene import Scene
from ringpose.types.track import TrackLine
from ringpose.types.truth import Truth

PREVIEW_WIDTH = 640
"""Largest width of a preview, which is rendered with one ray a pixel."""

JPEG_QUALITY = 85

QUIET_S = 0.3
"""Time without a change after which the state is measured at once; longer than a preview takes to reach the screen."""

PAUSE = 2.0
"""Pause after a measurement while states change, in durations of that measurement: a third of the time is measured."""

MAX_CAMERAS = 4
"""Camera records that are kept."""

POLL_S = 0.05
"""Time between two checks whether a waiting item can be worked on."""

Item = TypeVar("Item")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ConsolePicture:
    """The picture of one state, with its measurement."""

    state: ConsoleState
    image: UInt8[Array, "row column 3"]
    """Blue, green, red; the number of the state and its time are written into it."""
    rig: Rig
    """Rig of the images of this picture."""
    truth: Truth
    """Truth at the time at which the pose holds."""
    shot: Shot | None = None
    shot_truth: Truth | None = None
    line: PoseLine | None = None
    """The pose line; None in a preview."""
    errors: dict[str, float] | None = None
    """Errors of the pose, as `ringpose bench` names and computes them; empty without a pose."""
    track: TrackLine | None = None
    track_error_m: float = np.nan
    """Error of the track's centre."""

    @property
    def jpeg(self) -> bytes:
        """The image for browsers."""
        return bytes(cv2.imencode(".jpg", self.image, (cv2.IMWRITE_JPEG_QUALITY, JPEG_QUALITY))[1].tobytes())


class Stage(Generic[Item]):
    """A thread that works on the newest item; earlier ones that it has not begun are skipped.

    An exception is reported, and the work goes on; others, and all without `report`, end it.
    """

    def __init__(
        self,
        name: str,
        work: Callable[[Item], None],
        fail: Callable[[BaseException], None],
        is_ready: Callable[[], bool] = lambda: True,
        report: Callable[[Exception], None] | None = None,
    ) -> None:
        self._work, self._fail, self._is_ready, self._report = work, fail, is_ready, report or fail
        self._changed = threading.Condition()
        self._newest: Item | None = None
        self._ended = False
        self._thread = threading.Thread(target=self._run, name=f"console {name}", daemon=True)

    def put(self, item: Item) -> None:
        """Work on this item as soon as possible."""
        with self._changed:
            self._newest = item
            self._changed.notify_all()

    def start(self) -> None:
        """Begin to work."""
        self._thread.start()

    def end(self) -> None:
        """Finish the item that is being worked on, and end."""
        with self._changed:
            self._ended = True
            self._changed.notify_all()
        self._thread.join()

    def _run(self) -> None:
        try:
            while (item := self._taken()) is not None:
                self._attempt(item)
        except BaseException as failure:
            self._fail(failure)

    def _attempt(self, item: Item) -> None:
        try:
            self._work(item)
        except Exception as problem:
            self._report(problem)

    def _taken(self) -> Item | None:
        with self._changed:
            while not self._ended and (self._newest is None or not self._is_ready()):
                self._changed.wait(POLL_S if self._newest is not None else None)
            item, self._newest = self._newest, None
            return None if self._ended else item


class Engine:
    """Threads that make previews and measurements of the newest state; they run within the context.

    `show` is called with each preview and each measurement and its picture as JPEG, by two threads; `record` with each
    measurement; `report` with an exception that one state or its picture has caused, after which the next one is worked
    on; without it, the engine fails.
    """

    def __init__(
        self,
        scene: Scene,
        show: Callable[[ConsolePicture, bytes], None],
        record: Callable[[ConsolePicture], None] = lambda _: None,
        is_watched: Callable[[], bool] = lambda: True,
        report: Callable[[Exception], None] | None = None,
    ) -> None:
        self._scene, self._report = scene, report or self.fail
        self._lock = threading.Lock()
        self._cameras: dict[tuple[object, ...], Camera] = {}
        self._stream: Stream | None = None
        self._measured_at = -1, 0.0
        self._ended = threading.Event()
        self.failure: BaseException | None = None
        self._changed_s = self._due_s = -np.inf
        pictures = [
            Stage[ConsolePicture](name, lambda picture: show(picture, picture.jpeg), self.fail, report=report)
            for name in ("preview pictures", "measured pictures")
        ]

        def measure(state: ConsoleState) -> None:
            began_s = time.monotonic()
            picture = self._made(self.measured, state)
            with self._lock:
                self._due_s = time.monotonic() + PAUSE * (time.monotonic() - began_s)
            record(picture)
            pictures[1].put(picture)

        def may_measure() -> bool:
            with self._lock:
                due_s = min(self._changed_s + QUIET_S, self._due_s)
            return is_watched() and time.monotonic() > due_s

        def preview(state: ConsoleState) -> None:
            pictures[0].put(self._made(self.preview, state))

        self._workers = [
            Stage[ConsoleState]("previews", preview, self.fail, is_watched, report),
            Stage[ConsoleState]("measurements", measure, self.fail, may_measure, report),
        ]
        self._stages: list[Stage[Any]] = [*self._workers, *pictures]

    def __enter__(self) -> "Engine":
        for stage in self._stages:
            stage.start()
        return self

    def __exit__(self, *_: object) -> None:
        for stage in self._stages:
            stage.end()

    def show(self, state: ConsoleState, *, measure_now: bool = False) -> None:
        """Show this state as soon as possible, then measure it; earlier states that are not begun yet are skipped."""
        with self._lock:
            now_s = time.monotonic()
            if now_s > self._changed_s + QUIET_S:  # the first change for a while: its preview comes first
                self._due_s = max(self._due_s, now_s + QUIET_S)
            self._changed_s = now_s
            if measure_now:
                self._due_s = now_s
        for worker in self._workers:
            worker.put(state)

    def wait_for_failure(self) -> None:
        """Wait until a thread has failed; its exception is then in `failure`."""
        self._ended.wait()

    def fail(self, failure: BaseException) -> None:
        """End `wait_for_failure`."""
        self.failure = failure
        self._ended.set()

    def _made(self, make: Callable[[ConsoleState], ConsolePicture], state: ConsoleState) -> ConsolePicture:
        """The picture of a state; a black one with the exception if there is none."""
        try:
            return make(state)
        except Exception as problem:
            self._report(problem)
            return _unseen(state, self._scene.rig, problem)

    def preview(self, state: ConsoleState) -> ConsolePicture:
        """A frame with all lasers that are switched on, with one ray a pixel."""
        scene = self._scene_of(replace(state, width=min(state.width or PREVIEW_WIDTH, PREVIEW_WIDTH)))
        view, mask = state.view(scene), int(np.bitwise_or.reduce(scene.sequence))
        caption = f"{view.name}: {state.time_s:.2f} s"
        try:
            illuminated = illuminated_ring(scene, view, (mask,))
        except DataError as problem:
            return _unseen(state, scene.rig, problem)
        rendered = render_view(scene, illuminated, (state.number,), samples=1)
        frame = rendered.frame(mask, view_exposure_s(scene, illuminated), scene.start_s)
        truth = view_truth(scene, view, illuminated)
        return ConsolePicture(state=state, image=captioned(frame.image, caption), rig=scene.rig, truth=truth)

    def measured(self, state: ConsoleState) -> ConsolePicture:
        """Measure a state: render a shot, detect, estimate the pose, track, and compute the errors."""
        scene = self._scene_of(state)
        try:
            shot, truth = simulated_shot(scene, (state.view(scene),), 0)
        except DataError as problem:
            return _unseen(state, scene.rig, problem)
        measured = self._stream_of(state, scene.rig).measure(shot)
        line, track = measured.line, measured.track
        assert measured.detection is not None  # as of a shot
        estimate = estimate_of(line, shot.name)
        return ConsolePicture(
            state=state,
            # the page has the numbers
            image=overlay(picture_of(shot), measured.detection, line, scene.rig, with_numbers=False),
            rig=scene.rig,
            truth=truth_at(truth, estimate.stamp_s, line.stamp_s),
            shot=shot,
            shot_truth=truth,
            line=line,
            errors=dict(score(truth, estimate, estimate.method, scene.rig.camera).errors),
            track=track,
            track_error_m=np.nan if track is None else _track_error_m(track, truth, shot),
        )

    def _stream_of(self, state: ConsoleState, rig: Rig) -> Stream:
        """The stream that a state continues; a new one begins when something other than the time was changed."""
        since, time_s = self._measured_at
        if self._stream is None or state.since != since or state.time_s <= time_s:
            self._stream = Stream(Setup(rig=rig), TrackOptions())
        self._measured_at = state.since, state.time_s
        return self._stream

    def _scene_of(self, state: ConsoleState) -> Scene:
        """The scene of a state, with the camera record of earlier pictures, whose rays the renderer has cached."""
        scene, change = state.scene_of(self._scene), state.rig_change
        key = (change.rig, change.focal_scale, change.pitch_scale, scene.rig.camera.image_width)
        with self._lock:
            camera = self._cameras.setdefault(key, scene.rig.camera)
            if len(self._cameras) > MAX_CAMERAS:
                del self._cameras[next(iter(self._cameras))]
        return replace(scene, rig=replace(scene.rig, camera=camera))


def _track_error_m(track: TrackLine, truth: Truth, shot: Shot) -> float:
    """Error of the track's centre; NaN if there is none."""
    center_m = truth_at(truth, track.stamp_s, shot.measured_at_s).center_m
    if track.pose is None or center_m is None:
        return np.nan
    return float(np.linalg.norm(track.pose.center_m - center_m))


def _unseen(state: ConsoleState, rig: Rig, problem: Exception) -> ConsolePicture:
    """A black picture of a state that cannot be seen, such as from inside the target, with the reason."""
    camera = rig.camera
    black = np.zeros((camera.image_height, camera.image_width), dtype=np.uint8)
    name = f"console_{state.number:06d}"
    return ConsolePicture(
        state=state,
        image=captioned(black, f"{name}: {problem}"),
        rig=rig,
        truth=Truth(shot=name, expect="no_target", groups={}),
        line=PoseLine(shot=name, stamp_s=state.time_s, pose=None, reason=str(problem)),
        errors={},
    )
