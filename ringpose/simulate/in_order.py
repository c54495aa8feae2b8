"""Independent pieces of work, in several processes if wanted, the results in order and as they come."""

import multiprocessing
import signal
from collections.abc import Callable, Iterator
from contextlib import suppress
from multiprocessing.connection import Connection
from typing import TypeVar

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
