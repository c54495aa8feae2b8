"""Worker processes: work in any order by a pool that survives killed workers, and results in order."""

import multiprocessing
import signal
from collections.abc import Callable, Iterator
from functools import partial
from multiprocessing.connection import Connection, wait
from time import perf_counter
from typing import Any, NamedTuple, TypeVar

Result = TypeVar("Result")

MIN_ITEMS_PER_PROCESS = 4
"""Fewer items than this take less time than starting a process."""


def in_order(work: Callable[[int], Result], count: int, jobs: int) -> Iterator[Result]:
    """work(0), work(1), ... work(count - 1), computed by several processes; an exception in `work` is raised here.

    At most two results for each process wait until they are fetched, which limits the memory.
    """
    jobs = min(jobs, count // MIN_ITEMS_PER_PROCESS)
    if jobs <= 1:
        yield from map(work, range(count))
        return
    pool, items = Pool(partial(_result, work)), iter(range(count))
    finished: dict[int, Any] = {}
    try:
        for wanted in range(count):
            while True:
                while len(pool.busy) < jobs and len(finished) < 2 * jobs and (item := next(items, None)) is not None:
                    pool.give([item])
                if wanted in finished:
                    break
                finished |= _collected(pool)
            result = finished.pop(wanted)
            if isinstance(result, Exception):
                raise result
            yield result
    finally:
        pool.close()


def _collected(pool: "Pool") -> dict[int, Any]:
    """Results by their items, after waiting for at least one."""
    results = {}
    for chunk, found, _ in pool.collected():
        if found is None:
            raise RuntimeError("a worker process was killed, perhaps for lack of memory")
        results[chunk[0]] = found[0]
    return results


def _result(work: Callable[[int], Result], item: int) -> Result | Exception:
    """The result, or the exception as a value, which can be sent between processes."""
    try:
        return work(item)
    except Exception as error:
        return error


class _Worker(NamedTuple):
    process: Any
    connection: "Connection[Any, Any]"


class Pool:
    """Worker processes; unlike those of an executor they have no threads or locks that a kill could leave behind."""

    def __init__(self, work: Callable[[Any], Any]) -> None:
        self._work = work
        self._context = multiprocessing.get_context("spawn")
        self._idle: list[_Worker] = []
        self.busy: dict[Any, tuple[_Worker, list[Any], float]] = {}
        """Workers that compute a chunk, by their connections."""

    def give(self, chunk: list[Any]) -> None:
        """Let an idle or a new worker compute a chunk."""
        while True:
            worker = self._idle.pop() if self._idle else self._started()
            try:
                worker.connection.send(chunk)
            except OSError:  # killed while it was idle
                worker.process.join()
                continue
            self.busy[worker.connection] = worker, chunk, perf_counter()
            return

    def collected(self, *others: "Connection[Any, Any]") -> Iterator[tuple[list[Any], list[Any] | None, float]]:
        """Wait for results: chunks with theirs (None if the worker was killed) and their duration.

        Returns without any if one of the other connections can be read first.
        """
        for connection in wait([*self.busy, *others]):
            if connection in others:
                continue
            worker, chunk, started_s = self.busy.pop(connection)
            try:
                found = worker.connection.recv()
            except (EOFError, OSError):
                worker.process.join()
                found = None
            else:
                self._idle.append(worker)
            yield chunk, found, perf_counter() - started_s

    def close(self) -> None:
        """End all workers."""
        for worker in [*self._idle, *(each for each, _, _ in self.busy.values())]:
            worker.process.terminate()
            worker.process.join()
            worker.connection.close()

    def _started(self) -> _Worker:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=_serve, args=(self._work, theirs), daemon=True)
        process.start()
        theirs.close()
        return _Worker(process, ours)


def _serve(work: Callable[[Any], Any], connection: "Connection[Any, Any]") -> None:
    """Main function of a worker: it ends when the parent closes the connection, even by being killed."""
    import cv2

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    cv2.setNumThreads(1)
    try:
        while True:
            connection.send([work(index) for index in connection.recv()])
    except (EOFError, OSError):
        return
