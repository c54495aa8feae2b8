"""Simulation of the shots of a scene with their ground truth, in parallel processes but in order."""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

import numpy as np

from ringpose.errors import DataError
from ringpose.optics.sensor import saturation_dn
from ringpose.processes import in_order
from ringpose.simulate.break_points import true_break_points_px
from ringpose.simulate.exposure import view_exposure_s
from ringpose.simulate.light import IlluminatedTarget
from ringpose.simulate.motion import velocities
from ringpose.simulate.placement import READOUT_S, Placement, board_poses, ring_views, target_placement
from ringpose.simulate.renderer import TIMES, RenderedView, render_view
from ringpose.simulate.target.parts import board_target, part_around, view_target
from ringpose.types.arrays import Array, Float64
from ringpose.types.image import Frame, Shot
from ringpose.types.scene import BoardSet, Light, NamedBoardPose, RingView, Scene
from ringpose.types.target import TimedPoses
from ringpose.types.truth import Truth, TruthFrame

_SHOTS, _BOARDS = 0, 1
"""First number of each seed, so that the noise of boards and shots is independent."""


def simulate(scene: Scene, count: int | None = None, jobs: int = 1, begin: int = 0) -> Iterator[tuple[Shot, Truth]]:
    """The first `count` shots of a scene, or all, each as soon as it is ready; `jobs` does not change the result.

    The first `begin` of them are left out.

    A motion that does not cover them, or a part around the camera where one of the first `CHECKED_VIEWS` shots begins,
    is a `DataError` before the first is rendered.
    """
    views = ring_views(scene)
    shots = len(views) if count is None else min(count, len(views))
    for view in views[: min(shots, CHECKED_VIEWS)]:
        _check_camera(scene, view, target_placement(scene, view))
    if shots and _motion_ends(scene):
        last = views[shots - 1]
        exposure_s = view_exposure_s(scene, illuminated_ring(scene, last, scene.sequence))
        target_placement(scene, last, shot_begins_s(scene.sequence, exposure_s)[-1] + exposure_s)
    return in_order(partial(simulated_shot, scene, views), shots, jobs, begin)


CHECKED_VIEWS = 1000
"""Number of views that are checked before the first is rendered; the others are checked when they are rendered."""


def _motion_ends(scene: Scene) -> bool:
    """Whether the motion of target or camera is given by poses, which end; a free motion without them does not."""
    return isinstance(scene.motion, TimedPoses) or (scene.motion is not None and scene.motion.camera is not None)


def simulated_shot(scene: Scene, views: Sequence[RingView], number: int) -> tuple[Shot, Truth]:
    """Shot and truth of the view of this number."""
    return shot_of_view(scene, views[number], number)


def shot_of_view(scene: Scene, view: RingView, number: int) -> tuple[Shot, Truth]:
    """Shot and truth of one view; of a moving target, every frame is rendered at its own mid exposure."""
    illuminated = illuminated_ring(scene, view, scene.sequence)
    exposure_s = view_exposure_s(scene, illuminated)
    begins_s = shot_begins_s(scene.sequence, exposure_s)
    stamps_s = scene.start_s + number * scene.period_s + begins_s
    seed = (_SHOTS, scene.seed, number)
    if view.path is None:
        frames = render_view(scene, illuminated, seed).frames(scene.sequence, exposure_s, stamps_s)
        return _shot_of(scene, view.name, frames, still=True), view_truth(scene, view, illuminated)
    if scene.shots > 1 and begins_s[-1] + exposure_s > scene.period_s:
        finding = f"is {scene.period_s:g} s, shorter than the {begins_s[-1] + exposure_s:.3f} s of a shot"
        raise DataError("the scene's period_s", finding, "give a longer period, or set exposure_s")
    frames = [
        moving_frame(scene, view, mask, exposure_s, begin_s, stamp_s, (*seed, frame))
        for frame, (mask, begin_s, stamp_s) in enumerate(zip(scene.sequence, begins_s, stamps_s, strict=True))
    ]
    return _shot_of(scene, view.name, frames, still=False), moving_truth(scene, view, exposure_s, begins_s, stamps_s)


def shot_begins_s(sequence: tuple[int, ...], exposure_s: float) -> Float64[Array, "frame"]:
    """Begin of each exposure of a shot, in seconds since the begin of the first exposure."""
    return np.arange(len(sequence)) * (exposure_s + READOUT_S)


def moving_frame(
    scene: Scene,
    view: RingView,
    mask: int,
    exposure_s: float,
    begin_s: float,
    stamp_s: float,
    seed: tuple[int, ...],
) -> Frame:
    """A frame of a moving target; its exposure begins `begin_s` after the begin of the shot."""
    illuminated = illuminated_ring(scene, view, (mask,), begin_s + exposure_s / 2, exposure_s)
    return render_view(scene, illuminated, seed).frame(mask, exposure_s, stamp_s)


def moving_truth(
    scene: Scene,
    view: RingView,
    exposure_s: float,
    begins_s: Float64[Array, "frame"],
    stamps_s: Float64[Array, "frame"],
) -> Truth:
    """Ground truth of a moving target at the first frame with a laser on, and at each frame, all mid exposure.

    The frames begin at `begins_s` after the shot, with these stamps. The break points of the shot are those of each
    laser in the first of its frames with the fewest lasers on.
    """
    masks, lasers = scene.sequence, np.arange(len(scene.rig.lasers.names))
    middles_s = begins_s + exposure_s / 2
    poses = [illuminated_ring(scene, view, (mask,), time_s) for mask, time_s in zip(masks, middles_s, strict=True)]
    points_px = [true_break_points_px(pose, scene.ring, scene.rig.camera) for pose in poses]
    first = next((frame for frame, mask in enumerate(masks) if mask), 0)
    lit = [[frame for frame, mask in enumerate(masks) if mask >> laser & 1] or [first] for laser in lasers]
    shown = [min(frames, key=lambda frame: masks[frame].bit_count()) for frames in lit]
    truth = view_truth(scene, view, poses[first], np.stack([points_px[frame][k] for k, frame in enumerate(shown)]))
    if truth.center_m is None or view.path is None:
        return truth
    face_m = np.array([0.0, 0.0, scene.ring.height_m])
    velocity_m_s, rate_rad_s = velocities(view.path, view.begin_s + float(middles_s[first]), face_m)
    frames = tuple(
        TruthFrame(
            stamp_s=float(stamp_s) + exposure_s / 2,
            center_m=pose.placement.points_camera(face_m),
            normal=pose.placement.rotation[:, 2],
            break_points_px=np.where((mask >> lasers & 1)[:, None, None], point_px, np.nan) if mask else None,
        )
        for mask, stamp_s, pose, point_px in zip(masks, stamps_s, poses, points_px, strict=True)
    )
    return replace(
        truth,
        stamp_s=frames[first].stamp_s,
        velocity_m_s=velocity_m_s,
        angular_velocity_rad_s=rate_rad_s,
        frames=frames,
    )


def simulated_boards(
    scene: Scene, boards: BoardSet, count: int | None = None, jobs: int = 1, begin: int = 0
) -> Iterator[tuple[Shot, NamedBoardPose]]:
    """The views of a calibration board from `begin` to `count`, or all, each with the true pose of the board."""
    poses = board_poses(scene, boards)[:count]
    return in_order(partial(simulated_board, scene, boards, poses), len(poses), jobs, begin)


def simulated_board(
    scene: Scene, boards: BoardSet, poses: tuple[NamedBoardPose, ...], number: int
) -> tuple[Shot, NamedBoardPose]:
    """One view of a board."""
    pose = poses[number]
    rendered = render_board_view(scene, boards, pose, number, boards.sequence)
    stamps_s = scene.start_s + number * scene.period_s + shot_begins_s(boards.sequence, boards.exposure_s)
    frames = rendered.frames(boards.sequence, boards.exposure_s, stamps_s)
    return _shot_of(scene, pose.name, frames, still=True), pose


def render_ring_view(scene: Scene, view: RingView, number: int) -> RenderedView:
    """A rendered view of the ring, with the light of every laser."""
    return render_view(scene, illuminated_ring(scene, view), (_SHOTS, scene.seed, number))


def render_board_view(
    scene: Scene, boards: BoardSet, pose: NamedBoardPose, number: int, masks: tuple[int, ...] = (255,)
) -> RenderedView:
    """A rendered view of a board, with the light of the lasers that are on in any of the masks."""
    placement = Placement(rotation=pose.rotation, translation_m=pose.translation_m)
    illuminated = IlluminatedTarget(
        target=board_target(boards.board),
        placement=placement,
        during=(placement,),
        planes=scene.rig.lasers,
        laser_light=scene.lasers,
        light=Light(name="boards", ambient_w_m2=boards.ambient_w_m2),
        lasers=_lasers_on(scene, masks),
        bows=scene.rig.bows,
    )
    return render_view(scene, illuminated, (_BOARDS, scene.seed, len(boards.sequence), number))


def illuminated_ring(
    scene: Scene, view: RingView, masks: tuple[int, ...] = (255,), time_s: float = 0.0, exposure_s: float = 0.0
) -> IlluminatedTarget:
    """The target of a view with its light, `time_s` after the beginning of the shot.

    `masks` are the laser masks of the frames to be rendered. If an exposure is given, its middle is at `time_s`, and a
    moving target has placements during it.
    """
    placement = target_placement(scene, view, time_s)
    _check_camera(scene, view, placement)
    during: tuple[Placement, ...] = (placement,)
    light = scene.lights[view.light]
    if view.path is not None:
        turned = view.path.inertial_from_camera(view.begin_s + time_s)
        earth = None if light.earth is None else replace(light.earth, direction=light.earth.direction @ turned)
        light = replace(light, sun_direction=light.sun_direction @ turned, earth=earth)
    if view.path is not None and exposure_s > 0.0:
        shares = (np.arange(TIMES) + 0.5) / TIMES - 0.5
        during = tuple(target_placement(scene, view, time_s + float(share) * exposure_s) for share in shares)
    return IlluminatedTarget(
        target=view_target(scene, view, placement),
        placement=placement,
        during=during,
        planes=scene.rig.lasers,
        laser_light=scene.lasers,
        light=light,
        lasers=_lasers_on(scene, masks),
        bows=scene.rig.bows,
    )


def around_camera(scene: Scene, view: RingView) -> str | None:
    """Name of the part of the target that contains the camera at the beginning of a view; None if there is none."""
    return part_around(scene, view, target_placement(scene, view).eye_m)


def _check_camera(scene: Scene, view: RingView, placement: Placement) -> None:
    if name := part_around(scene, view, placement.eye_m):
        raise DataError(f"the scene's view {view.name}", f"has the camera inside the part {name!r}", "move it away")


def view_truth(
    scene: Scene,
    view: RingView,
    illuminated: IlluminatedTarget,
    break_points_px: Float64[Array, "laser edge=2 xy=2"] | None = None,
) -> Truth:
    """Ground truth of a view, `no_target` if no break point is visible.

    Break points that are not given are computed for the placement of `illuminated`.
    """
    if break_points_px is None and view.target == "ring":
        break_points_px = true_break_points_px(illuminated, scene.ring, scene.rig.camera)
    placement = illuminated.placement
    center_m = placement.points_camera(np.array([0.0, 0.0, scene.ring.height_m]))
    return ring_truth(scene, view, center_m, placement.rotation[:, 2], break_points_px)


def ring_truth(
    scene: Scene,
    view: RingView,
    center_m: Float64[Array, "xyz=3"],
    normal: Float64[Array, "xyz=3"],
    break_points_px: Float64[Array, "laser edge=2 xy=2"] | None,
) -> Truth:
    """Ground truth of a ring with this pose and these break points; `no_target` if none of them is visible."""
    points_px = None if view.target != "ring" else break_points_px
    usable = 0 if points_px is None else int(np.isfinite(points_px).all(axis=-1).sum())
    groups = {"rig": scene.rig.camera.camera_name, "light": view.light, "frames": len(scene.sequence), **view.groups}
    groups["usable"] = usable
    if view.target == "ring":
        groups = {"ring": f"R{1000 * scene.ring.radius_outer_m:.0f}", **groups}
    if points_px is None or usable == 0:
        return Truth(shot=view.name, expect="no_target", groups=groups)
    return Truth(
        shot=view.name,
        expect="pose" if usable == 2 * len(points_px) else "partial",
        center_m=center_m,
        normal=normal,
        radius_inner_m=scene.ring.radius_inner_m,
        radius_outer_m=scene.ring.radius_outer_m,
        break_points_px=points_px,
        groups=groups,
    )


class SceneFrames:
    """Frames of a scene on demand, for the camera `sim:`, which is simulated in this process.

    Moment k, counted by the camera, shows view k of the scene; after the last view the scene does not change.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.views = ring_views(scene)
        self._moment = -1
        self._stamp_s = -np.inf
        """Earliest time of the next exposure."""

    def __call__(self, moment: int, lasers: int, exposure_s: float | None = None) -> Frame:
        """A frame of one moment with the lasers of the mask on; the exposure of the scene by default."""
        scene, view = self.scene, self.views[min(moment, len(self.views) - 1)]
        if moment != self._moment:
            illuminated = illuminated_ring(scene, view)
            if view.path is None:
                self._view = render_view(scene, illuminated, (_SHOTS, scene.seed, moment))
            self._exposure_s = view_exposure_s(scene, illuminated)
            self._stamp_s = max(self._stamp_s, scene.start_s + moment * scene.period_s)
            self._moment, self._begin_s, self._frames = moment, 0.0, 0
        exposed_s = self._exposure_s if exposure_s is None else exposure_s
        if view.path is None:
            frame = self._view.frame(lasers, exposed_s, self._stamp_s)
        else:
            seed = (_SHOTS, scene.seed, moment, self._frames)
            frame = moving_frame(scene, view, lasers, exposed_s, self._begin_s, self._stamp_s, seed)
        self._frames += 1
        self._begin_s += exposed_s + READOUT_S
        self._stamp_s += exposed_s + READOUT_S
        return frame


def _shot_of(scene: Scene, name: str, frames: Sequence[Frame], *, still: bool) -> Shot:
    meta: dict[str, Any] = {"simulated": True} | ({"still": True} if still else {})
    if scene.sensor.bits > 8:
        meta["saturation_dn"] = saturation_dn(scene.sensor)
    return Shot(
        name=name,
        images=np.stack([frame.image for frame in frames]),
        lasers=np.array([frame.lasers for frame in frames], dtype=np.uint8),
        stamp_s=np.array([frame.stamp_s for frame in frames]),
        exposure_s=np.array([frame.exposure_s for frame in frames]),
        meta=meta,
    )


def _lasers_on(scene: Scene, masks: tuple[int, ...]) -> tuple[int, ...]:
    """Lasers that are on in at least one of the masks."""
    return tuple(k for k in range(len(scene.rig.lasers.names)) if any(mask >> k & 1 for mask in masks))
