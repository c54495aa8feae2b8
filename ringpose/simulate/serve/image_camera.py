"""The camera of the image server: settings of the clients, and exposures of the shots of a scene."""

from collections.abc import Callable, Mapping
from datetime import UTC, datetime
from typing import Any

from ringpose.errors import DataError, UsageError
from ringpose.simulate.placement import MAX_DURATION_S, MIN_DURATION_S, READOUT_S
from ringpose.simulate.sensor import saturation_dn
from ringpose.simulate.serve.scene_shots import SceneShots, truth_named
from ringpose.types.scene import RingView, Scene
from ringpose.types.truth import Truth
from ringpose.wire import images as wire
from ringpose.wire.images import ServedFrame

Setting = wire.SetLasers | wire.SetExposure | wire.SetTrajectory | wire.SetTime


class ImageCamera:
    """Exposes shot after shot; a setting concerns the next frame, or the next shot if it concerns the target.

    `truth_record` makes the record of a truth, which each frame carries; `on_truth` receives it once a shot.
    """

    def __init__(
        self,
        scene: Scene,
        rate_hz: float,
        clock: wire.Clock,
        truth_record: Callable[[Truth], Mapping[str, Any]],
        on_truth: Callable[[Mapping[str, Any]], None] | None,
        report: Callable[[str], None] | None,
    ) -> None:
        _check(scene, rate_hz)
        self._scene, self._rate_hz, self._clock = scene, rate_hz, clock
        self._truth_record, self._on_truth, self._report = truth_record, on_truth, report
        self._shots = SceneShots(scene)
        self._began = f"{datetime.now(UTC):%Y%m%dT%H%M%S%f}Z"
        self._views = self._shots.views
        self._next_views: tuple[RingView, ...] | None = None
        self._number, self._paused = -1, False
        self._shown = self._views, 0
        """Trajectory and number of the shot that is being exposed."""
        self._shot_name, self._shot_count = "", 0
        self._next_id, self._next_step = 1, 0
        self._mask: int | None = None
        self._exposure_s: float | None = None
        self._is_clipped = False
        self.dropped = 0
        """Frames that could not be rendered in time."""

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
        if step == 0:
            self._begin_shot()
        mask = self._sequence[step] if self._mask is None else self._mask
        (views, number), shot_name, exposure_s = self._shown, self._shot_name, self._exposure_s
        limit_s = 1.0 / self._rate_hz - READOUT_S

        def exposed() -> ServedFrame:
            shot = self._shots.shot(views, number)
            wanted_s = shot.exposure_s if exposure_s is None else exposure_s
            if wanted_s > limit_s and not self._is_clipped and self._report is not None:
                self._is_clipped = True
                self._report(f"an exposure of {wanted_s:g} s is shortened to {limit_s:g} s; lower --rate")
            frame = shot.frame(mask, min(wanted_s, limit_s), stamp_s)
            served = ServedFrame(
                image=frame.image,
                frame_id=frame_id,
                shot=shot_name,
                step=step,
                lasers=mask,
                stamp_s=stamp_s,
                exposure_s=frame.exposure_s,
                dropped=self.dropped,
                truth=self._truth_record(truth_named(shot.truth, shot_name)),
            )
            if step == 0 and self._on_truth is not None and served.truth is not None:
                self._on_truth(served.truth)
            return served

        return exposed

    def _begin_shot(self) -> None:
        if self._next_views is not None:
            self._views, self._next_views, self._number = self._next_views, None, -1
        if not self._paused or self._number < 0:
            self._number += 1
        self._shown = self._views, self._number
        self._shot_count += 1
        self._shot_name = f"{self._began}_{self._shot_count:06d}"

    def set(self, request: Setting) -> str | None:
        """Change a setting; the finding if it is not possible."""
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
                shot = int(time_s * self._rate_hz / len(self._sequence))
                self._number, self._paused = (shot if paused else shot - 1), paused
            case wire.SetTrajectory(poses=poses):
                unknown = {pose.light for pose in poses} - {None, *self._scene.lights}
                if unknown:
                    return f"the scene has no light {sorted(map(str, unknown))[0]!r}"
                self._next_views = self._shots.views_at(poses)
        return None

    def first_frame_with(self, request: Setting) -> int:
        """Number of the first frame with a setting that has just been made."""
        of_next_frame = isinstance(request, wire.SetLasers | wire.SetExposure)
        return self._next_id + (0 if of_next_frame else -self._next_step % len(self._sequence))

    def close(self) -> None:
        """Stop rendering."""
        self._shots.close()


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
