"""The camera of the image server: settings of the clients, and exposures of the shots of a scene."""

from collections.abc import Callable, Mapping
from dataclasses import replace
from datetime import UTC, datetime
from typing import Any

from ringpose.errors import DataError, UsageError
from ringpose.simulate.pipeline import around_camera
from ringpose.simulate.placement import MAX_DURATION_S, MIN_DURATION_S, READOUT_S
from ringpose.simulate.sensor import saturation_dn
from ringpose.simulate.serve.scene_shots import Motion, MovingShot, SceneShots
from ringpose.types.image import Frame
from ringpose.types.scene import RingView, Scene, Truth
from ringpose.wire import images as wire
from ringpose.wire.images import ServedFrame

Exposed = Callable[[tuple[int, ...]], tuple[Frame, Mapping[str, Any]]]
"""Makes a frame, whose noise has this seed, and the record of its truth."""

Setting = wire.SetLasers | wire.SetExposure | wire.SetTrajectory | wire.SetTime


class ImageCamera:
    """Exposes shot after shot; `truth_record` makes the record of a truth, which each frame carries.

    A setting concerns the next frame; one of the target, or of lasers and exposure while it moves, the next shot.
    """

    def __init__(
        self,
        scene: Scene,
        rate_hz: float,
        clock: wire.Clock,
        truth_record: Callable[[Truth], Mapping[str, Any]],
        report: Callable[[str], None] | None,
    ) -> None:
        _check(scene, rate_hz)
        self._scene, self._rate_hz, self._clock = scene, rate_hz, clock
        self._truth_record, self._report = truth_record, report
        self._shots = SceneShots(scene)
        self._motion = None if scene.motion is None else Motion(scene, self._shots.views)
        self._check_motion()
        self._began = f"{datetime.now(UTC):%Y%m%dT%H%M%S%f}Z"
        self._views = self._shots.views
        self._next_views: tuple[RingView, ...] | None = None
        self._number, self._paused = -1, False
        self._shown = self._views, 0
        """Trajectory and number of the shot that is being exposed."""
        self._moving: MovingShot | None = None
        """The shot that is being exposed, if the target moves."""
        self._moving_truth: Mapping[str, Any] = {}
        self._newest_s = scene.start_s
        self._shot_name, self._shot_count = "", 0
        self._next_id, self._next_step = 1, 0
        self._mask: int | None = None
        self._exposure_s: float | None = None
        self._is_clipped = False
        self.dropped = 0
        """Frames that could not be rendered in time."""

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
        """What a client is greeted with."""
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

    @property
    def _sequence(self) -> tuple[int, ...]:
        lasers = (1 << len(self._scene.rig.lasers.names)) - 1
        return tuple(mask & lasers for mask in self._scene.sequence)

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
        moving = self._moving
        exposed = self._next_still(step, stamp_s) if moving is None else self._next_moving(moving, step)
        shot_name, dropped, seed = self._shot_name, self.dropped, (self._scene.seed, frame_id)

        def served() -> ServedFrame:
            frame, truth = exposed(seed)
            return ServedFrame(
                image=frame.image,
                frame_id=frame_id,
                shot=shot_name,
                step=step,
                lasers=frame.lasers,
                stamp_s=frame.stamp_s,
                exposure_s=frame.exposure_s,
                dropped=dropped,
                truth=truth,
            )

        return served

    def _next_still(self, step: int, stamp_s: float) -> Exposed:
        mask = self._sequence[step] if self._mask is None else self._mask
        shot_of, name, exposure_s = self._shots.shot(*self._shown), self._shot_name, self._exposure_s

        def exposed(seed: tuple[int, ...]) -> tuple[Frame, Mapping[str, Any]]:
            shot = shot_of()
            wanted_s = self._limited_s(shot.exposure_s if exposure_s is None else exposure_s)
            truth = self._truth_record(replace(shot.truth, shot=name))
            return shot.frame(mask, wanted_s, stamp_s, seed), truth

        return exposed

    def _next_moving(self, shot: MovingShot, step: int) -> Exposed:
        truth = self._moving_truth
        return lambda seed: (shot.frame(step, seed), truth)

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
        self._shown = self._views, self._number
        self._shot_count += 1
        self._shot_name = f"{self._began}_{self._shot_count:06d}"
        self._moving = None
        if self._motion is not None and self._views is self._shots.views:
            masks = self._sequence if self._mask is None else (self._mask,) * len(self._sequence)
            view = self._motion.view(stamp_s, self._shot_s)
            exposure_s = self._limited_s(self._shots.exposure_s(view) if self._exposure_s is None else self._exposure_s)
            self._moving = self._shots.moving_shot(view, masks, exposure_s, stamp_s, 1.0 / self._rate_hz)
            self._moving_truth = self._truth_record(replace(self._moving.truth(), shot=self._shot_name))

    @property
    def _shot_s(self) -> float:
        return len(self._sequence) / self._rate_hz

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
                self._seek(time_s, paused=paused)
            case wire.SetTrajectory(poses=poses):
                return self._set_trajectory(poses)
        return None

    def _set_trajectory(self, poses: tuple[wire.ServedPose, ...]) -> str | None:
        unknown = {pose.light for pose in poses} - {None, *self._scene.lights}
        if unknown:
            return f"the scene has no light {sorted(map(str, unknown))[0]!r}"
        views = self._shots.views_at(poses)
        inside = (around_camera(self._scene, view) for view in views)
        if name := next(filter(None, inside), None):
            return f"a pose has the camera inside the part {name!r}"
        self._next_views = views
        return None

    def _seek(self, time_s: float, *, paused: bool) -> None:
        shot = int(time_s / self._shot_s)
        self._number, self._paused = (shot if paused else shot - 1), paused
        if self._motion is not None:
            self._motion.seek(time_s, self._newest_s, paused=paused)

    def first_frame_with(self, request: Setting) -> int:
        """Number of the first frame with a setting that has just been made."""
        of_next_frame = isinstance(request, wire.SetLasers | wire.SetExposure) and self._moving is None
        return self._next_id + (0 if of_next_frame else -self._next_step % len(self._sequence))

    def close(self) -> None:
        """Stop rendering."""
        self._shots.close()

    def _check_motion(self) -> None:
        if self._motion is not None and self._shot_s > self._motion.duration_s:
            found = (
                f"a shot takes {self._shot_s:.3g} s, longer than the scene's motion of {self._motion.duration_s:.3g} s"
            )
            raise UsageError("--rate", found, "raise it, or the motion's shots")


def _check(scene: Scene, rate_hz: float) -> None:
    if len(scene.sequence) > wire.MAX_SEQUENCE:
        found = f"has {len(scene.sequence)} frames; at most {wire.MAX_SEQUENCE} can be served"
        raise UsageError("the scene's sequence", found)
    if not scene.views and not any(approach.count for approach in scene.approaches):
        raise DataError("the scene", "has no trajectory", "add one with a view")
    exposure_s = MIN_DURATION_S if scene.stripe_dn is not None else scene.exposure_s
    if 1.0 / rate_hz < exposure_s + READOUT_S:
        found = f"{rate_hz:g} frames a second leave no time for an exposure of {exposure_s:g} s"
        raise UsageError("--rate", found, f"take at most {1.0 / (exposure_s + READOUT_S):.3g}")
