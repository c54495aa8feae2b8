"""Shots of a scene on demand, for the image server: the only place where it depends on the renderer."""

from collections import OrderedDict
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

KEPT_BYTES = 1 << 27
"""Memory for rendered views, of which at least two are kept."""


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

    The next one is rendered in the background, and as many as fit into `KEPT_BYTES` are kept. `shot` is called by one
    thread at a time.
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

    def shot(self, views: tuple[RingView, ...], number: int) -> RenderedShot:
        """View `number` of a trajectory; one that was not expected is rendered now."""
        shown = self._requested(views[number % len(views)], number)
        self._requested(views[(number + 1) % len(views)], number + 1)
        while len(self._kept) > self._capacity:
            self._kept.popitem(last=False)
        return shown.result()

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


def truth_named(truth: Truth, shot: str) -> Truth:
    """The truth under the name of the served shot."""
    return replace(truth, shot=shot)
