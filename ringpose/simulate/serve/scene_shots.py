"""Shots of a scene on demand, for the image server: the only place where it depends on the renderer."""

from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ringpose.simulate.exposure import view_exposure_s
from ringpose.simulate.pipeline import illuminated_ring, moving_frame, moving_truth, render_ring_view, view_truth
from ringpose.simulate.placement import MAX_DURATION_S, READOUT_S, ring_views
from ringpose.simulate.renderer import RenderedView
from ringpose.types.arrays import Array, Float64
from ringpose.types.image import Frame
from ringpose.types.scene import RingView, Scene, Truth
from ringpose.types.target import TargetPath
from ringpose.wire.images import ServedPose

KEPT_BYTES = 1 << 27
"""Memory for rendered views, of which at least two are kept."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RenderedShot:
    """One view of a still target, ready for exposures."""

    rendered: RenderedView
    exposure_s: float
    """Exposure by the scene's own rule."""
    truth: Truth

    def frame(self, lasers: int, exposure_s: float, stamp_s: float, seed: tuple[int, ...]) -> Frame:
        """One exposure; the seed is that of its noise."""
        rendered = replace(self.rendered, generator=np.random.default_rng(seed))  # several threads expose
        return rendered.frame(lasers, exposure_s, stamp_s)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovingShot:
    """A shot of a moving target, of which each frame is rendered at its own time."""

    scene: Scene
    """Its sequence is that of the shot."""
    view: RingView
    exposure_s: float
    stamp_s: float
    """Of the first frame."""
    period_s: float
    """Between two frames."""

    def frame(self, step: int, seed: tuple[int, ...]) -> Frame:
        """One exposure; the seed is that of speckle and noise."""
        begin_s, mask = step * self.period_s, self.scene.sequence[step]
        return moving_frame(self.scene, self.view, mask, self.exposure_s, begin_s, self.stamp_s + begin_s, seed)

    def truth(self) -> Truth:
        """The truth at each frame."""
        begins_s = np.arange(len(self.scene.sequence)) * self.period_s
        no_image = np.zeros((0, 0), np.uint8)  # the truth depends on stamps, exposures and lasers
        frames = [
            Frame(image=no_image, lasers=mask, stamp_s=self.stamp_s + float(begin_s), exposure_s=self.exposure_s)
            for mask, begin_s in zip(self.scene.sequence, begins_s, strict=True)
        ]
        return moving_truth(self.scene, self.view, frames, begins_s)


@dataclass(frozen=True, slots=True, eq=False)
class _Standing:
    """A path on which time stands still."""

    path: TargetPath
    time_s: float

    def camera_from_target(self, _: float) -> tuple[Float64[Array, "3 3"], Float64[Array, "xyz=3"]]:
        return self.path.camera_from_target(self.time_s)

    def inertial_from_camera(self, _: float) -> Float64[Array, "3 3"]:
        return self.path.inertial_from_camera(self.time_s)


class Motion:
    """The moving views of a scene by the time of day, or simulated time: run after run, again and again."""

    def __init__(self, scene: Scene, views: tuple[RingView, ...]) -> None:
        self._runs = tuple(view for view in views if view.begin_s == 0.0)
        self.duration_s = (scene.shots - 1) * scene.period_s + len(scene.sequence) * (
            max(scene.exposure_s, MAX_DURATION_S) + READOUT_S
        )
        """For which the motion of a run is known."""
        self._run, self._began_s = -1, -np.inf
        self._paused_s: float | None = None

    def seek(self, time_s: float, stamp_s: float, *, paused: bool) -> None:
        """Continue at another time since the first run began; `paused` lets the target stand there."""
        run, within_s = divmod(time_s, self.duration_s)
        self._run, self._began_s = int(run) % len(self._runs), stamp_s - within_s
        self._paused_s = within_s if paused else None

    def view(self, stamp_s: float, shot_s: float) -> RingView:
        """The view of a shot that begins at this stamp; one that would outlast a run begins the next one."""
        if self._paused_s is not None:
            view = self._runs[self._run]
            assert view.path is not None
            return replace(view, path=_Standing(view.path, self._paused_s), begin_s=0.0)
        if stamp_s - self._began_s + shot_s > self.duration_s:
            self._run, self._began_s = (self._run + 1) % len(self._runs), stamp_s
        return replace(self._runs[self._run], begin_s=stamp_s - self._began_s)


class SceneShots:
    """The views of a trajectory in their order, repeated from the beginning after the last.

    The next one of a still target is rendered in the background, and as many as fit into `KEPT_BYTES` are kept. The
    methods are called by one thread.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.views = ring_views(scene)
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="scene shots")
        self._kept: OrderedDict[int, tuple[RingView, Future[RenderedShot]]] = OrderedDict()
        """By the identity of the view, which is kept so that it remains unique; the one used last is at the end."""
        camera = scene.rig.camera
        layers = 1 + len(scene.rig.lasers.names)
        self._capacity = max(2, KEPT_BYTES // (4 * layers * camera.image_width * camera.image_height))

    def shot(self, views: tuple[RingView, ...], number: int) -> Callable[[], RenderedShot]:
        """View `number` of a trajectory, to be waited for; one that was not expected is rendered from now on."""
        shown = self._requested(views[number % len(views)], number)
        self._requested(views[(number + 1) % len(views)], number + 1)
        while len(self._kept) > self._capacity:
            self._kept.popitem(last=False)
        return shown.result

    def exposure_s(self, view: RingView) -> float:
        """Exposure of a view by the scene's own rule."""
        return view_exposure_s(self.scene, illuminated_ring(self.scene, view))

    def moving_shot(
        self, view: RingView, masks: tuple[int, ...], exposure_s: float, stamp_s: float, period_s: float
    ) -> MovingShot:
        """A shot of a moving target."""
        scene = replace(self.scene, sequence=masks)
        return MovingShot(scene=scene, view=view, exposure_s=exposure_s, stamp_s=stamp_s, period_s=period_s)

    def views_at(self, poses: tuple[ServedPose, ...]) -> tuple[RingView, ...]:
        """The views of these poses, whose lights the scene has; without any, those of the scene."""
        if not poses:
            return self.views
        usual = self.views[0].light if self.views else next(iter(self.scene.lights))
        return tuple(
            RingView(
                name=f"pose_{number:06d}",
                center_m=np.array(pose.center_m),
                normal=np.array(pose.normal) / np.linalg.norm(pose.normal),
                roll_rad=pose.roll_rad,
                light=usual if pose.light is None else pose.light,
            )
            for number, pose in enumerate(poses, start=1)
        )

    def close(self) -> None:
        """Stop rendering."""
        self._worker.shutdown(wait=True, cancel_futures=True)

    def _requested(self, view: RingView, number: int) -> Future[RenderedShot]:
        kept = self._kept.get(id(view)) or (view, self._worker.submit(self._rendered, view, number))
        self._kept[id(view)] = kept
        self._kept.move_to_end(id(view))
        return kept[1]

    def _rendered(self, view: RingView, number: int) -> RenderedShot:
        illuminated = illuminated_ring(self.scene, view)
        return RenderedShot(
            rendered=render_ring_view(self.scene, view, number),
            exposure_s=view_exposure_s(self.scene, illuminated),
            truth=view_truth(self.scene, view, illuminated),
        )
