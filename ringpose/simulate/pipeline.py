"""Simulation of the shots of a scene with their ground truth, in parallel processes but in order."""

import multiprocessing
import signal
from collections.abc import Callable, Iterator
from contextlib import suppress
from functools import partial
from multiprocessing.connection import Connection
from typing import TypeVar

import numpy as np

from ringpose.simulate.board_target import board_target
from ringpose.simulate.break_points import true_break_points_px
from ringpose.simulate.exposure import view_exposure_s
from ringpose.simulate.laser_planes import sheets
from ringpose.simulate.lighting import IlluminatedTarget
from ringpose.simulate.placement import Placement, board_poses, ring_rotation, ring_views
from ringpose.simulate.renderer import RenderedView, render_view
from ringpose.simulate.sensor import saturation_dn
from ringpose.simulate.target import EmptySpace, Target, ring_target
from ringpose.types.image import Frame, Shot
from ringpose.types.scene import BoardSet, Light, NamedBoardPose, RingView, Scene
from ringpose.types.truth import Truth

READOUT_S = 0.002
"""Time between the end of an exposure and the start of the next."""

_SHOTS, _BOARDS = 0, 1
"""First number of each seed, so that the noise of boards and shots is independent."""


def simulate(scene: Scene, count: int | None = None, jobs: int = 1) -> Iterator[tuple[Shot, Truth]]:
    """The first `count` shots of a scene, or all, each as soon as it is ready; `jobs` does not change the result."""
    views = ring_views(scene)[:count]
    return in_order(partial(simulated_shot, scene, views), len(views), jobs)


def simulated_shot(scene: Scene, views: tuple[RingView, ...], number: int) -> tuple[Shot, Truth]:
    """Shot and truth of one view."""
    view = views[number]
    illuminated = illuminated_ring(scene, view, scene.sequence)
    rendered = render_view(scene, illuminated, (_SHOTS, scene.seed, number))
    shot = _exposed(scene, view.name, rendered, scene.sequence, view_exposure_s(scene, illuminated), number)
    return shot, view_truth(scene, view, illuminated)


def simulated_boards(
    scene: Scene, boards: BoardSet, count: int | None = None, jobs: int = 1
) -> Iterator[tuple[Shot, NamedBoardPose]]:
    """The first `count` views of a calibration board, or all, each with the true pose of the board."""
    poses = board_poses(scene, boards)[:count]
    return in_order(partial(simulated_board, scene, boards, poses), len(poses), jobs)


def simulated_board(
    scene: Scene, boards: BoardSet, poses: tuple[NamedBoardPose, ...], number: int
) -> tuple[Shot, NamedBoardPose]:
    """One view of a board."""
    pose = poses[number]
    rendered = render_view(
        scene, _illuminated_board(scene, boards, pose, boards.sequence), _board_seed(scene, boards, number)
    )
    return _exposed(scene, pose.name, rendered, boards.sequence, boards.exposure_s, number), pose


def render_ring_view(scene: Scene, view: RingView, number: int) -> RenderedView:
    """A rendered view of the ring, with the light of every laser."""
    return render_view(scene, illuminated_ring(scene, view), (_SHOTS, scene.seed, number))


def render_board_view(scene: Scene, boards: BoardSet, pose: NamedBoardPose, number: int) -> RenderedView:
    """A rendered view of a board, with the light of every laser."""
    return render_view(scene, _illuminated_board(scene, boards, pose, (255,)), _board_seed(scene, boards, number))


def illuminated_ring(scene: Scene, view: RingView, masks: tuple[int, ...] = (255,)) -> IlluminatedTarget:
    """The target of a view with its placement and light; `masks` are those of the frames to be rendered."""
    rotation = ring_rotation(view.normal, view.roll_rad)
    placement = Placement(rotation=rotation, translation_m=view.center_m - scene.ring.height_m * rotation[:, 2])
    target: Target = EmptySpace()
    if view.target != "none":
        target = ring_target(scene.ring if view.target == "ring" else None, scene.body)
    return IlluminatedTarget(
        target=target,
        placement=placement,
        sheets=sheets(scene.rig.lasers, scene.lasers, placement),
        light=scene.lights[view.light],
        lasers=_lasers_on(scene, masks),
    )


def view_truth(scene: Scene, view: RingView, illuminated: IlluminatedTarget) -> Truth:
    """Ground truth of a view; a view without a visible break point has no target."""
    groups = {"rig": scene.rig.camera.camera_name, "light": view.light, "frames": len(scene.sequence), **view.groups}
    if view.target != "ring":
        return Truth(shot=view.name, expect="no_target", groups={**groups, "usable": 0})
    break_points_px = true_break_points_px(illuminated, scene.ring, scene.rig.camera)
    usable = int(np.isfinite(break_points_px).all(axis=-1).sum())
    groups = {"ring": f"R{1000 * scene.ring.radius_outer_m:.0f}", **groups, "usable": usable}
    if usable == 0:
        return Truth(shot=view.name, expect="no_target", groups=groups)
    return Truth(
        shot=view.name,
        expect="pose" if usable == 2 * len(break_points_px) else "partial",
        center_m=view.center_m,
        normal=view.normal,
        radius_inner_m=scene.ring.radius_inner_m,
        radius_outer_m=scene.ring.radius_outer_m,
        break_points_px=break_points_px,
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
        if moment != self._moment:
            illuminated = illuminated_ring(self.scene, self.views[min(moment, len(self.views) - 1)])
            self._view = render_view(self.scene, illuminated, (_SHOTS, self.scene.seed, moment))
            self._exposure_s = view_exposure_s(self.scene, illuminated)
            self._stamp_s = max(self._stamp_s, self.scene.start_s + moment * self.scene.period_s)
            self._moment = moment
        exposed_s = self._exposure_s if exposure_s is None else exposure_s
        frame = self._view.frame(lasers, exposed_s, self._stamp_s)
        self._stamp_s += exposed_s + READOUT_S
        return frame


def _illuminated_board(
    scene: Scene, boards: BoardSet, pose: NamedBoardPose, masks: tuple[int, ...]
) -> IlluminatedTarget:
    placement = Placement(rotation=pose.rotation, translation_m=pose.translation_m)
    return IlluminatedTarget(
        target=board_target(boards.board),
        placement=placement,
        sheets=sheets(scene.rig.lasers, scene.lasers, placement),
        light=Light(name="boards", ambient_w_m2=boards.ambient_w_m2),
        lasers=_lasers_on(scene, masks),
    )


def _board_seed(scene: Scene, boards: BoardSet, number: int) -> tuple[int, ...]:
    return (_BOARDS, scene.seed, len(boards.sequence), number)


def _exposed(
    scene: Scene, name: str, rendered: RenderedView, sequence: tuple[int, ...], exposure_s: float, number: int
) -> Shot:
    """The frames of one view as a shot."""
    stamps_s = scene.start_s + number * scene.period_s + np.arange(len(sequence)) * (exposure_s + READOUT_S)
    frames = [rendered.frame(mask, exposure_s, float(stamp)) for mask, stamp in zip(sequence, stamps_s, strict=True)]
    meta = {"simulated": True} | ({"saturation_dn": saturation_dn(scene.sensor)} if scene.sensor.bits > 8 else {})
    return Shot(
        name=name,
        images=np.stack([frame.image for frame in frames]),
        lasers=np.array(sequence, dtype=np.uint8),
        stamp_s=stamps_s,
        exposure_s=np.full(len(sequence), exposure_s),
        meta=meta,
    )


def _lasers_on(scene: Scene, masks: tuple[int, ...]) -> tuple[int, ...]:
    """Lasers that are on in at least one of the masks."""
    return tuple(k for k in range(len(scene.rig.lasers.names)) if any(mask >> k & 1 for mask in masks))


Result = TypeVar("Result")

MIN_ITEMS_PER_PROCESS = 4
"""Fewer items than this take less time than starting a process."""


def in_order(work: Callable[[int], Result], count: int, jobs: int) -> Iterator[Result]:
    """work(0), work(1), ... work(count - 1), computed by several processes.

    Process k of n computes the items k, k + n, k + 2n, ... and waits after each until its result is fetched, which
    limits the memory. Unlike the pool of an executor it has no threads or locks that an interrupt could leave behind.
    """
    jobs = min(jobs, count // MIN_ITEMS_PER_PROCESS)
    if jobs <= 1:
        yield from map(work, range(count))
        return
    context = multiprocessing.get_context("spawn")
    processes, results = [], []
    try:
        for first in range(jobs):
            receiver, sender = context.Pipe(duplex=False)
            process = context.Process(target=_work, args=(work, range(first, count, jobs), sender), daemon=True)
            processes.append(process)
            process.start()
            sender.close()
            results.append(receiver)
        for number in range(count):
            try:
                result = results[number % jobs].recv()
            except EOFError:
                raise RuntimeError("a worker process was killed, perhaps for lack of memory") from None
            if isinstance(result, Exception):
                raise result
            yield result
    finally:
        for process in processes:
            if process.pid is not None:
                process.terminate()
                process.join()


def _work(work: Callable[[int], object], numbers: range, sender: "Connection[object, object]") -> None:
    """Main function of a worker process; it ignores Ctrl-C, which the parent process handles."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(BrokenPipeError, ConnectionResetError):
        for number in numbers:
            try:
                result = work(number)
            except Exception as error:
                sender.send(error)
                return
            sender.send(result)
