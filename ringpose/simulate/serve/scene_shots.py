"""Shots of a scene on demand, for the image server: the only place where it depends on the renderer."""

from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from ringpose.simulate.exposure import view_exposure_s
from ringpose.simulate.pipeline import illuminated_ring, render_ring_view, view_truth
from ringpose.simulate.placement import ring_views
from ringpose.simulate.renderer import RenderedView
from ringpose.types.image import Frame
from ringpose.types.scene import RingView, Scene
from ringpose.types.truth import Truth
from ringpose.wire.images import ServedPose


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RenderedShot:
    """One view of a trajectory, ready for exposures."""

    rendered: RenderedView
    exposure_s: float
    """Exposure by the scene's own rule."""
    truth: Truth

    def frame(self, lasers: int, exposure_s: float | None, stamp_s: float) -> Frame:
        """One exposure; by default with the exposure of the scene."""
        return self.rendered.frame(lasers, self.exposure_s if exposure_s is None else exposure_s, stamp_s)


class SceneShots:
    """The views of a trajectory one after the other, from the beginning after the last.

    The next one is rendered in the background. `shot` is called by one thread at a time.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.views = ring_views(scene)
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="scene shots")
        self._shown: tuple[RingView, RenderedShot] | None = None
        self._next: tuple[RingView, Future[RenderedShot]] | None = None

    def shot(self, views: tuple[RingView, ...], number: int) -> RenderedShot:
        """View `number` of a trajectory; it is rendered now unless it was expected."""
        view, following = views[number % len(views)], views[(number + 1) % len(views)]
        if self._shown is None or self._shown[0] is not view:
            expected = self._next is not None and self._next[0] is view
            rendered = self._next[1].result() if expected and self._next is not None else self._rendered(view, number)
            self._shown = (view, rendered)
        if following is not view and (self._next is None or self._next[0] is not following):
            self._next = (following, self._worker.submit(self._rendered, following, number + 1))
        return self._shown[1]

    def views_at(self, poses: tuple[ServedPose, ...]) -> tuple[RingView, ...]:
        """The views of these poses, whose lights the scene has; without any, those of the scene."""
        if not poses:
            return ring_views(self.scene)
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

    def _rendered(self, view: RingView, number: int) -> RenderedShot:
        illuminated = illuminated_ring(self.scene, view)
        return RenderedShot(
            rendered=render_ring_view(self.scene, view, number),
            exposure_s=view_exposure_s(self.scene, illuminated),
            truth=view_truth(self.scene, view, illuminated),
        )


def truth_named(truth: Truth, shot: str) -> Truth:
    """The truth under the name of the served shot."""
    return replace(truth, shot=shot)
