"""Scene -> shots with their truth, one after the other.

Independent pieces of work, in several processes if wanted, the results in order and as they come.
"""

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
from ringpose.simulate.lighting import Stand
from ringpose.simulate.placement import Placement, board_places, ring_rotation, ring_views
from ringpose.simulate.renderer import RenderedView, staged
from ringpose.simulate.sensor import saturation_dn
from ringpose.simulate.target import EmptySpace, Target, ring_target
from ringpose.types.image import Frame, Shot
from ringpose.types.scene import BoardPlace, BoardSet, Light, RingView, Scene
from ringpose.types.truth import Truth

READOUT_S = 0.002
"""Between the end of one exposure and the start of the next."""

_SHOTS, _BOARDS = 0, 1
"""First number of every seed, so that boards and shots share no noise."""


def simulate(scene: Scene, count: int | None = None, jobs: int = 1) -> Iterator[tuple[Shot, Truth]]:
    """The first `count` shots of a scene, or all; each as soon as it is made, the same for any number of processes."""
    views = ring_views(scene)[:count]
    return in_order(partial(simulated_shot, scene, views), len(views), jobs)


def simulated_shot(scene: Scene, views: tuple[RingView, ...], number: int) -> tuple[Shot, Truth]:
    """Shot and truth of one view."""
    view = views[number]
    stand = ring_stand(scene, view, scene.sequence)
    stage = staged(scene, stand, (_SHOTS, scene.seed, number))
    shot = _exposed(scene, view.name, stage, scene.sequence, view_exposure_s(scene, stand), number)
    return shot, view_truth(scene, view, stand)


def simulated_boards(
    scene: Scene, boards: BoardSet, count: int | None = None, jobs: int = 1
) -> Iterator[tuple[Shot, BoardPlace]]:
    """The first `count` views of a calibration board, or all, each with the board's true place."""
    places = board_places(scene, boards)[:count]
    return in_order(partial(simulated_board, scene, boards, places), len(places), jobs)


def simulated_board(
    scene: Scene, boards: BoardSet, places: tuple[BoardPlace, ...], number: int
) -> tuple[Shot, BoardPlace]:
    """One view of a board."""
    place = places[number]
    stage = staged(scene, _board_stand(scene, boards, place, boards.sequence), _board_seed(scene, boards, number))
    return _exposed(scene, place.name, stage, boards.sequence, boards.exposure_s, number), place


def ring_stage(scene: Scene, view: RingView, number: int) -> RenderedView:
    """A view of the ring in which any laser may be lit."""
    return staged(scene, ring_stand(scene, view), (_SHOTS, scene.seed, number))


def board_stage(scene: Scene, boards: BoardSet, place: BoardPlace, number: int) -> RenderedView:
    """A view of a board in which any laser may be lit."""
    return staged(scene, _board_stand(scene, boards, place, (255,)), _board_seed(scene, boards, number))


def ring_stand(scene: Scene, view: RingView, masks: tuple[int, ...] = (255,)) -> Stand:
    """The view's target in its place, and its light; the masks say which lasers will be on."""
    rotation = ring_rotation(view.normal, view.roll_rad)
    placement = Placement(rotation=rotation, translation_m=view.center_m - scene.ring.height_m * rotation[:, 2])
    return Stand(
        target=_target(scene, view),
        placement=placement,
        sheets=sheets(scene.rig.lasers, scene.lasers, placement),
        light=scene.lights[view.light],
        lasers=_lit(scene, masks),
    )


def view_truth(scene: Scene, view: RingView, stand: Stand) -> Truth:
    """What is really there; a view in which no break point shows has no target."""
    groups = {"rig": scene.rig.camera.camera_name, "light": view.light, "frames": len(scene.sequence), **view.groups}
    if view.target != "ring":
        return Truth(shot=view.name, expect="no_target", groups={**groups, "usable": 0})
    break_points_px = true_break_points_px(stand, scene.ring, scene.rig.camera)
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
    """Frames of a scene on demand, for a camera that is simulated in this process.

    The scene's views are its moments, numbered from 0; after the last it stands still.
    """

    def __init__(self, scene: Scene) -> None:
        self.scene = scene
        self.views = ring_views(scene)
        self._moment = -1
        self._stamp_s = -np.inf
        """When the next exposure can begin, at the earliest."""

    def __call__(self, moment: int, lasers: int, exposure_s: float | None = None) -> Frame:
        """The frame of one moment while the lasers of the mask are on; without exposure, the scene's own."""
        if moment != self._moment:
            self._stand_before(moment)
        exposed_s = self._exposure_s if exposure_s is None else exposure_s
        frame = self._stage.frame(lasers, exposed_s, self._stamp_s)
        self._stamp_s += exposed_s + READOUT_S
        return frame

    def _stand_before(self, moment: int) -> None:
        stand = ring_stand(self.scene, self.views[min(moment, len(self.views) - 1)])
        self._stage = staged(self.scene, stand, (_SHOTS, self.scene.seed, moment))
        self._exposure_s = view_exposure_s(self.scene, stand)
        self._stamp_s = max(self._stamp_s, self.scene.start_s + moment * self.scene.period_s)
        self._moment = moment


def _board_stand(scene: Scene, boards: BoardSet, place: BoardPlace, masks: tuple[int, ...]) -> Stand:
    placement = Placement(rotation=place.rotation, translation_m=place.translation_m)
    return Stand(
        target=board_target(boards.board),
        placement=placement,
        sheets=sheets(scene.rig.lasers, scene.lasers, placement),
        light=Light(name="boards", ambient_w_m2=boards.ambient_w_m2),
        lasers=_lit(scene, masks),
    )


def _board_seed(scene: Scene, boards: BoardSet, number: int) -> tuple[int, ...]:
    return (_BOARDS, scene.seed, len(boards.sequence), number)


def _exposed(
    scene: Scene, name: str, stage: RenderedView, sequence: tuple[int, ...], exposure_s: float, number: int
) -> Shot:
    """The frames of one moment as a shot."""
    stamps_s = scene.start_s + number * scene.period_s + np.arange(len(sequence)) * (exposure_s + READOUT_S)
    frames = [stage.frame(mask, exposure_s, float(stamp)) for mask, stamp in zip(sequence, stamps_s, strict=True)]
    meta = {"simulated": True} | ({"saturation_dn": saturation_dn(scene.sensor)} if scene.sensor.bits > 8 else {})
    return Shot(
        name=name,
        images=np.stack([frame.image for frame in frames]),
        lasers=np.array(sequence, dtype=np.uint8),
        stamp_s=stamps_s,
        exposure_s=np.full(len(sequence), exposure_s),
        meta=meta,
    )


def _target(scene: Scene, view: RingView) -> Target:
    if view.target == "none":
        return EmptySpace()
    return ring_target(scene.ring if view.target == "ring" else None, scene.body)


def _lit(scene: Scene, masks: tuple[int, ...]) -> tuple[int, ...]:
    """Lasers that are on in any of the masks."""
    return tuple(k for k in range(len(scene.rig.lasers.names)) if any(mask >> k & 1 for mask in masks))


Result = TypeVar("Result")

WORTH_A_PROCESS = 4
"""Fewer pieces than this are done sooner than a process has started."""


def in_order(work: Callable[[int], Result], count: int, jobs: int) -> Iterator[Result]:
    """work(0), work(1), ... work(count - 1).

    Process k of n does the pieces k, k + n, k + 2n, ... and waits before each next one until its result is fetched, so
    results never pile up. There are no threads and no locks that an interrupt could leave behind, as there are in an
    executor's pool.
    """
    jobs = min(jobs, count // WORTH_A_PROCESS)
    if jobs <= 1:
        yield from map(work, range(count))
        return
    context = multiprocessing.get_context("spawn")
    processes, results = [], []
    try:
        for first in range(jobs):
            result, sender = context.Pipe(duplex=False)
            process = context.Process(target=_do, args=(work, range(first, count, jobs), sender), daemon=True)
            processes.append(process)
            process.start()
            sender.close()
            results.append(result)
        for number in range(count):
            yield _received(results[number % jobs])
    finally:
        for process in processes:
            if process.pid is not None:
                process.terminate()
                process.join()


def _received(results: "Connection[object, Result | Exception]") -> Result:
    try:
        result = results.recv()
    except EOFError:
        raise RuntimeError("a worker process was killed, perhaps for lack of memory") from None
    if isinstance(result, Exception):
        raise result
    return result


def _do(work: Callable[[int], object], numbers: range, sender: "Connection[object, object]") -> None:
    """The life of a worker; Ctrl-C reaches every process of a terminal, but the parent alone decides what it means."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with suppress(BrokenPipeError, ConnectionResetError):
        for number in numbers:
            try:
                result = work(number)
            except Exception as error:
                sender.send(error)
                return
            sender.send(result)
