"""The camera of the image server: settings of the clients, and exposures of the shots of a scene."""

from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import lru_cache
from typing import Any

import numpy as np

from ringpose.errors import DataError, UsageError
from ringpose.optics.sensor import saturation_dn
from ringpose.simulate.exposure import view_exposure_s
from ringpose.simulate.motion import SteadyPath
from ringpose.simulate.pipeline import (
    around_camera,
    illuminated_ring,
    moving_frame,
    moving_truth,
    render_ring_view,
    view_truth,
)
from ringpose.simulate.placement import MAX_DURATION_S, MIN_DURATION_S, READOUT_S, ring_rotation, ring_views
from ringpose.simulate.renderer import RenderedView
from ringpose.types.arrays import Array, Float64
from ringpose.types.image import Frame
from ringpose.types.scene import RingView, Scene
from ringpose.types.target import TargetPath
from ringpose.types.truth import Truth
from ringpose.wire import images as wire
from ringpose.wire.images import ServedFrame, ServedPose

KEPT_BYTES = 1 << 27
"""Memory for rendered views, of which at least two are kept."""

Setting = wire.SetLasers | wire.SetExposure | wire.SetTrajectory | wire.SetTime


class ImageCamera:
    """Exposes shot after shot; `truth_record` makes the record of a truth, which each frame carries.

    A setting concerns the next frame; one of the target, or of lasers and exposure while it moves, the next shot. The
    methods are called by one thread.
    """

    def __init__(
        self,
        scene: Scene,
        rate_hz: float,
        clock: wire.Clock,
        truth_record: Callable[[Truth], Mapping[str, Any]],
        report: Callable[[str], None] | None,
    ) -> None:
        self._scene, self._rate_hz, self._clock = scene, rate_hz, clock
        self._truth_record, self._report = truth_record, report
        lasers = (1 << len(scene.rig.lasers.names)) - 1
        self._sequence = tuple(mask & lasers for mask in scene.sequence)
        self._shot_s = len(self._sequence) / rate_hz
        self._check()
        self._scene_views: Sequence[RingView] = (views := ring_views(scene))
        self._views: Sequence[RingView] = views
        self._motion = None if scene.motion is None else MotionRuns(scene, views.begins)
        if self._motion is not None and self._shot_s > self._motion.duration_s:
            finding = f"a shot takes {self._shot_s:.3g} s, but the scene's motion {self._motion.duration_s:.3g} s"
            raise UsageError("--rate", finding, "raise it, or the motion's shots")
        self._rendered = RenderedShots(scene)
        self._next_views: Sequence[RingView] | None = None
        self._number, self._paused = -1, False
        """Number of the view in its trajectory, and whether the next shot shows it again."""
        self._still: Future[RenderedShot] | None = None
        self._moving: MovingShot | None = None
        """The shot that is being exposed is one of these."""
        self._newest_s = scene.start_s
        self._began = f"{datetime.now(UTC):%Y%m%dT%H%M%S%f}Z"
        self._shot_name, self._shot_count = "", 0
        self._next_id, self._next_step = 1, 0
        self._mask: int | None = None
        self._exposure_s: float | None = None
        self._is_clipped = False
        self.dropped = 0
        """Frames that could not be rendered in time."""

    def _check(self) -> None:
        """Check that the scene can be served at this rate."""
        scene, rate_hz = self._scene, self._rate_hz
        if len(scene.sequence) > wire.MAX_SEQUENCE:
            finding = f"has {len(scene.sequence)} frames; at most {wire.MAX_SEQUENCE} can be served"
            raise UsageError("the scene's sequence", finding)
        if not scene.views and not any(approach.count for approach in scene.approaches):
            raise DataError("the scene", "has no trajectory", "add one with a view")
        exposure_s = MIN_DURATION_S if scene.stripe_dn is not None else scene.exposure_s
        if 1.0 / rate_hz < exposure_s + READOUT_S:
            finding = f"{rate_hz:g} frames a second leave no time for an exposure of {exposure_s:g} s"
            raise UsageError("--rate", finding, f"take at most {1.0 / (exposure_s + READOUT_S):.3g}")

    @property
    def is_between_shots(self) -> bool:
        """Whether the next frame is the first one of a shot."""
        return self._next_step == 0

    @property
    def start_s(self) -> float:
        """Simulated time of the first frame."""
        return self._scene.start_s

    @property
    def greeting(self) -> wire.Greeting:
        """The message that greets a client."""
        camera = self._scene.rig.camera
        return wire.Greeting(
            clock=self._clock,
            rate_hz=self._rate_hz,
            camera_name=camera.camera_name,
            image_width=camera.image_width,
            image_height=camera.image_height,
            saturation_dn=saturation_dn(self._scene.sensor),
            lasers=self._scene.rig.lasers.names,
            sequence=self._sequence,
            min_exposure_s=MIN_DURATION_S,
            max_exposure_s=min(MAX_DURATION_S, 1.0 / self._rate_hz - READOUT_S),
        )

    def is_brightest(self, frame: ServedFrame) -> bool:
        """Whether a frame has as many lasers on as any of its shot."""
        return self._mask is not None or frame.lasers == max(self._sequence, key=int.bit_count)

    def next_exposure(self, stamp_s: float) -> Callable[[], ServedFrame]:
        """The exposure of the next frame, to be run in another thread.

        The first frame of a shot takes over a new trajectory.
        """
        frame_id, step = self._next_id, self._next_step
        self._next_id, self._next_step = frame_id + 1, (step + 1) % len(self._sequence)
        self._newest_s = stamp_s
        if step == 0:
            self._begin_shot(stamp_s)
        name, dropped, seed = self._shot_name, self.dropped, (self._scene.seed, frame_id)
        still, moving, wanted_s = self._still, self._moving, self._exposure_s
        mask = self._sequence[step] if self._mask is None else self._mask

        def served() -> ServedFrame:
            if moving is not None:
                frame, truth = moving.frame(step, seed), moving.truth
            else:
                assert still is not None
                shot = still.result()
                exposure_s = self._limited_s(shot.exposure_s if wanted_s is None else wanted_s)
                frame = shot.frame(mask, exposure_s, stamp_s, seed)
                truth = self._truth_record(replace(shot.truth, shot=name))
            return ServedFrame(
                image=frame.image,
                frame_id=frame_id,
                shot=name,
                step=step,
                lasers=frame.lasers,
                stamp_s=frame.stamp_s,
                exposure_s=frame.exposure_s,
                dropped=dropped,
                truth=truth,
            )

        return served

    def _limited_s(self, exposure_s: float) -> float:
        """The exposure, shortened where the rate leaves less time."""
        limit_s = 1.0 / self._rate_hz - READOUT_S
        if exposure_s > limit_s and not self._is_clipped and self._report is not None:
            self._is_clipped = True
            self._report(f"an exposure of {exposure_s:g} s is shortened to {limit_s:g} s; lower --rate")
        return min(exposure_s, limit_s)

    def _begin_shot(self, stamp_s: float) -> None:
        if self._next_views is not None:
            self._views, self._next_views, self._number = self._next_views, None, -1
        if not self._paused or self._number < 0:
            self._number += 1
        self._shot_count += 1
        self._shot_name = f"{self._began}_{self._shot_count:06d}"
        self._still = self._moving = None
        scene, view = self._scene, self._views[self._number % len(self._views)]
        if self._motion is not None and self._views is self._scene_views:
            view = self._motion.view(stamp_s, self._shot_s)
        if view.path is None:
            self._still = self._rendered.shot(self._views, self._number)
            return
        usual_s = view_exposure_s(scene, illuminated_ring(scene, view))
        exposure_s = self._limited_s(usual_s if self._exposure_s is None else self._exposure_s)
        masks = self._sequence if self._mask is None else (self._mask,) * len(self._sequence)
        begins_s = np.arange(len(masks)) / self._rate_hz
        scene = replace(scene, sequence=masks)
        truth = moving_truth(scene, view, exposure_s, begins_s, stamp_s + begins_s)
        self._moving = MovingShot(
            scene=scene,
            view=view,
            exposure_s=exposure_s,
            stamp_s=stamp_s,
            begins_s=begins_s,
            truth=self._truth_record(replace(truth, shot=self._shot_name)),
        )

    def set(self, request: Setting) -> str | None:
        """Apply a setting. Returns None, or the message to the client if it is not possible."""
        match request:
            case wire.SetLasers(mask=mask):
                if mask is not None and mask >> len(self._scene.rig.lasers.names):
                    return f"mask {mask} names a laser that the rig does not have"
                self._mask = mask
            case wire.SetExposure(exposure_s=exposure_s):
                low_s, high_s = self.greeting.min_exposure_s, self.greeting.max_exposure_s
                if exposure_s is not None and not low_s <= exposure_s <= high_s:
                    return f"the camera cannot expose for {exposure_s:g} s; it takes {low_s:g} to {high_s:g} s"
                self._exposure_s = exposure_s
            case wire.SetTime(time_s=time_s, paused=paused):
                shot = int(time_s / self._shot_s)
                self._number, self._paused = (shot if paused else shot - 1), paused
                if self._motion is not None:
                    self._motion.seek(time_s, self._newest_s, paused=paused)
            case wire.SetTrajectory(poses=poses):
                return self._set_trajectory(poses)
        return None

    def _set_trajectory(self, poses: tuple[ServedPose, ...]) -> str | None:
        """Show these poses from the next shot on; without any, the views of the scene."""
        scene, usual = self._scene, self._scene_views[0].light
        if unknown := {pose.light for pose in poses} - {None, *scene.lights}:
            return f"the scene has no light {sorted(map(str, unknown))[0]!r}"
        views = tuple(self._view(f"pose_{number:06d}", pose, usual) for number, pose in enumerate(poses, start=1))
        if name := next(filter(None, (around_camera(scene, view) for view in views)), None):
            return f"a pose has the camera inside the part {name!r}"
        self._next_views = views or self._scene_views
        return None

    def _view(self, name: str, pose: ServedPose, usual: str) -> RingView:
        """The view of a pose; `usual`: its light if it states none."""
        normal = np.array(pose.normal) / np.linalg.norm(pose.normal)
        view = RingView(
            name=name,
            center_m=np.array(pose.center_m),
            normal=normal,
            roll_rad=pose.roll_rad,
            light=usual if pose.light is None else pose.light,
        )
        if not pose.is_moving:
            return view
        path = SteadyPath(
            rotation=ring_rotation(normal, pose.roll_rad),
            center_m=view.center_m,
            velocity_m_s=np.array(pose.velocity_m_s),
            angular_velocity_rad_s=np.array(pose.angular_velocity_rad_s),
            face_m=np.array([0.0, 0.0, self._scene.ring.height_m]),
        )
        return replace(view, path=path)

    def first_frame_with(self, request: Setting) -> int:
        """Number of the first frame with a setting that has just been made."""
        of_next_frame = isinstance(request, wire.SetLasers | wire.SetExposure) and self._moving is None
        return self._next_id + (0 if of_next_frame else -self._next_step % len(self._sequence))

    def close(self) -> None:
        """Stop rendering."""
        self._rendered.close()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RenderedShot:
    """One view of a still target, ready for exposures."""

    rendered: RenderedView
    exposure_s: float
    """Exposure by the scene's own rule."""
    truth: Truth

    def frame(self, lasers: int, exposure_s: float, stamp_s: float, seed: tuple[int, ...]) -> Frame:
        """One exposure; `seed` is the seed of its noise."""
        rendered = replace(self.rendered, generator=np.random.default_rng(seed))  # several threads expose
        return rendered.frame(lasers, exposure_s, stamp_s)


class RenderedShots:
    """The views of trajectories, rendered in a thread of their own; as many as fit into `KEPT_BYTES` are kept."""

    def __init__(self, scene: Scene) -> None:
        self._scene = scene
        self._worker = ThreadPoolExecutor(max_workers=1, thread_name_prefix="scene shots")
        camera, layers = scene.rig.camera, 1 + len(scene.rig.lasers.names)
        kept = max(2, KEPT_BYTES // (4 * layers * camera.image_width * camera.image_height))
        self._requested = lru_cache(kept)(lambda view, number: self._worker.submit(self._render, view, number))

    def shot(self, views: Sequence[RingView], number: int) -> Future[RenderedShot]:
        """View `number` of a trajectory that begins again after its last one; the next view is rendered after it."""
        shown, following = number % len(views), (number + 1) % len(views)
        shot: Future[RenderedShot] = self._requested(views[shown], shown)
        self._requested(views[following], following)
        return shot

    def close(self) -> None:
        """Stop rendering."""
        self._worker.shutdown(wait=True, cancel_futures=True)

    def _render(self, view: RingView, number: int) -> RenderedShot:
        illuminated = illuminated_ring(self._scene, view)
        return RenderedShot(
            rendered=render_ring_view(self._scene, view, number),
            exposure_s=view_exposure_s(self._scene, illuminated),
            truth=view_truth(self._scene, view, illuminated),
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovingShot:
    """A shot of a moving target, of which each frame is rendered at its own time."""

    scene: Scene
    """The scene, with the sequence of this shot."""
    view: RingView
    exposure_s: float
    stamp_s: float
    """Time stamp of the first frame."""
    begins_s: Float64[Array, "frame"]
    """Begin of each exposure since that of the first."""
    truth: Mapping[str, Any]
    """Record of the shot's truth."""

    def frame(self, step: int, seed: tuple[int, ...]) -> Frame:
        """One exposure; `seed` is the seed of speckle and noise."""
        begin_s, mask = float(self.begins_s[step]), self.scene.sequence[step]
        return moving_frame(self.scene, self.view, mask, self.exposure_s, begin_s, self.stamp_s + begin_s, seed)


class MotionRuns:
    """The moving views of a scene at the time of day, or at a simulated time; the runs follow each other and repeat."""

    def __init__(self, scene: Scene, runs: tuple[RingView, ...]) -> None:
        self._runs = runs
        self.duration_s = (scene.shots - 1) * scene.period_s + len(scene.sequence) * (
            max(scene.exposure_s, MAX_DURATION_S) + READOUT_S
        )
        """Duration for which the motion of a run is known."""
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


@dataclass(frozen=True, slots=True, eq=False)
class _Standing:
    """A path on which time stands still."""

    path: TargetPath
    time_s: float

    def camera_from_target(self, _: float) -> tuple[Float64[Array, "3 3"], Float64[Array, "xyz=3"]]:
        return self.path.camera_from_target(self.time_s)

    def inertial_from_camera(self, _: float) -> Float64[Array, "3 3"]:
        return self.path.inertial_from_camera(self.time_s)
