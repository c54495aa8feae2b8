"""Worker processes: a pool that survives killed workers, and results in the order of the items."""

import os
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from threading import Thread
from time import perf_counter
from typing import TYPE_CHECKING, Any, NamedTuple, TypeVar

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

Result = TypeVar("Result")

MIN_ITEMS_PER_PROCESS = 4
"""Fewer items than this take less time than starting a process."""


class WorkerKilled(RuntimeError):
    """The process that worked on an item was killed."""

    def __init__(self, item: object) -> None:
        self.item = item
        super().__init__("a worker process was killed, perhaps for lack of memory")


def cores() -> int:
    """Number of cores that this process may use."""
    return len(os.sched_getaffinity(0))


def in_order(work: Callable[[int], Result], count: int, jobs: int) -> Iterator[Result]:
    """work(0), work(1), ... work(count - 1), computed by several processes; an exception in `work` is raised here."""
    for outcome in outcomes(work, range(count), max(1, min(jobs, count // MIN_ITEMS_PER_PROCESS))):
        if isinstance(outcome, Exception):
            raise outcome
        yield outcome


def outcomes(work: Callable[[Any], Result], items: Iterable[Any], jobs: int) -> Iterator[Result | Exception]:
    """What `work` returns for each item, or the exception that it raises, in the order of the items.

    With several processes `work` must be a function that they can import. Items may come slowly: a thread awaits them,
    and no result waits for a later item. At most three results for each process are computed ahead.
    """
    if jobs == 1:
        yield from (_outcome(work, numbered) for numbered in enumerate(items))
        return
    from multiprocessing import Pipe  # slow to import

    arriving, sending = Pipe(duplex=False)
    Thread(target=_send, args=(items, sending), daemon=True).start()
    pool = Pool(partial(_outcome, work))
    finished: dict[int, Any] = {}
    wanted = given = 0
    ended = False
    try:
        while True:
            while wanted in finished:
                yield finished.pop(wanted)
                wanted += 1
            if ended and not pool.busy:
                return
            is_ready = not ended and len(pool.busy) < jobs and given < wanted + 3 * jobs
            if is_ready and arriving.poll():
                item = _received(arriving)
                ended = item is None
                if item is not None:
                    pool.give([(given, *item)])
                    given += 1
                continue
            for chunk, found, _ in pool.collected(*([arriving] if is_ready else [])):
                number, item = chunk[0]
                finished[number] = WorkerKilled(item) if found is None else found[0]
    finally:
        arriving.close()
        pool.close()


def _outcome(work: Callable[[Any], Result], numbered: tuple[int, Any]) -> Result | Exception:
    """The result of `work` for an item, or its exception as a value, which can be sent between processes."""
    try:
        return work(numbered[1])
    except Exception as error:
        return error


def _send(items: Iterable[Any], connection: "Connection[Any, Any]") -> None:
    """Thread function: send the items that `_received` receives, until the receiver is closed."""
    with connection, suppress(OSError):
        try:
            for item in items:
                connection.send((item,))
        except Exception as error:
            connection.send(error)
        else:
            connection.send(None)


def _received(connection: "Connection[Any, Any]") -> tuple[Any] | None:
    """The next item, in a tuple; None at their end. An error of their source is raised."""
    received: tuple[Any] | Exception | None = connection.recv()
    if isinstance(received, Exception):
        raise received
    return received


class _Worker(NamedTuple):
    process: Any
    connection: "Connection[Any, Any]"


class Pool:
    """Worker processes; unlike those of an executor they have no threads or locks that a kill could leave behind."""

    def __init__(self, work: Callable[[Any], Any]) -> None:
        import multiprocessing

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
        """Wait until workers have finished; yields each finished chunk, its results and the seconds that it took.

        The results are None if the worker was killed. Nothing is yielded if one of the other connections can be read
        before a worker has finished.
        """
        from multiprocessing.connection import wait

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
