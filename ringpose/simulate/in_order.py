"""Independent pieces of work, in several processes if wanted, the results in order and as they come."""

import multiprocessing
from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from typing import TypeVar

Result = TypeVar("Result")


def in_order(work: Callable[[int], Result], count: int, jobs: int) -> Iterator[Result]:
    """work(0), work(1), ... work(count - 1); never more than two results a process lie waiting."""
    if min(jobs, count) <= 1:
        yield from map(work, range(count))
        return
    context = multiprocessing.get_context("spawn")
    executor = ProcessPoolExecutor(min(jobs, count), context)
    waiting: deque[Future[Result]] = deque()
    try:
        for number in range(count):
            waiting.append(executor.submit(work, number))
            if len(waiting) > 2 * jobs:
                yield waiting.popleft().result()
        while waiting:
            yield waiting.popleft().result()
    finally:
        executor.shutdown(cancel_futures=True)
