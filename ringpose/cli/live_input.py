"""Input that arrives while a command runs: poses of the robot that carries a live camera, records at fixed ticks."""

import queue
import threading
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from time import monotonic, sleep
from typing import TYPE_CHECKING, TypeVar

from ringpose.types.options import STDIN

if TYPE_CHECKING:
    from ringpose.cli.batch import Batch
    from ringpose.geometry.camera_motion import CameraMotion

Item = TypeVar("Item")

PATIENCE_S = 0.2
"""Time for which a live shot waits for the pose of the robot that follows it."""


@contextmanager
def live_camera_motion(rig: Path, batch: "Batch") -> "Iterator[Callable[[float], CameraMotion]]":
    """A function of a stamp that returns the motion of the camera up to it.

    It waits for the robot's poses, which arrive on standard input. The batch reports bad ones; those that repeat the
    one before are counted, and reported at the end of the block.
    """
    from ringpose.cli.options.robot import report_repeats
    from ringpose.files.records.robot_poses import RobotPoseStream
    from ringpose.files.rigs import read_mount
    from ringpose.geometry.camera_motion import CameraMotion

    mount, stream = read_mount(rig), RobotPoseStream(batch.report)
    later_s = mount.delay_s + mount.delay_sd_s  # errors of the delay are taken by differences of one standard deviation
    try:
        yield lambda stamp_s: CameraMotion(poses=stream.until(stamp_s + later_s, PATIENCE_S), mount=mount)
    finally:
        report_repeats(STDIN, stream.repeats, stream.received)


def at_ticks(items: Iterable[Item], period_s: float) -> Iterator[list[Item]]:
    """Yields at each tick the items that have arrived; ends with the tick after the last one.

    A thread reads the items, so that a silent source does not delay a tick; its failure is raised at the end. A tick
    that is late by more than a period is left out rather than made up for.
    """
    arrived: queue.SimpleQueue[Item] = queue.SimpleQueue()
    ended = threading.Event()
    failures: list[BaseException] = []

    def read() -> None:
        try:
            for item in items:
                arrived.put(item)
        except BaseException as failure:  # raised again by the main thread
            failures.append(failure)
        finally:
            ended.set()

    threading.Thread(target=read, daemon=True).start()
    tick_s = monotonic()
    while True:
        tick_s += period_s
        sleep(max(tick_s - monotonic(), 0.0))
        tick_s = max(tick_s, monotonic() - period_s)
        is_last = ended.is_set()
        yield [arrived.get() for _ in range(arrived.qsize())]
        if is_last:
            if failures:
                raise failures[0]
            return
