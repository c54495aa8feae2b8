"""Fair times of several things: in turns, on one core, medians."""

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from statistics import median
from time import process_time

import cv2

Clock = Callable[[], float]


def median_times_s(
    calls: Mapping[str, Callable[[], object]], rounds: int, clock: Clock = process_time
) -> dict[str, float]:
    """Median seconds of each call, after one call to warm up, in rounds in which each has its turn.

    Processor time of this process by default, all its threads together: other people's load does not count, and
    more threads buy nothing.
    """
    times: dict[str, list[float]] = {name: [] for name in calls}
    for call in calls.values():
        call()
    for _ in range(rounds):
        for name, call in calls.items():
            start = clock()
            call()
            times[name].append(clock() - start)
    return {name: median(every) for name, every in times.items()}


@contextmanager
def one_core() -> Iterator[None]:
    """OpenCV runs in the calling thread alone while the block runs."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        yield
    finally:
        cv2.setNumThreads(threads)
