"""Work beside the caller: a thread that is one item ahead, and a pool of processes that survives killed workers."""

import math
import os
import resource
import signal
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from functools import partial
from queue import Empty, SimpleQueue
from threading import Semaphore, Thread
from time import perf_counter, process_time
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, TypeVar

if TYPE_CHECKING:
    from multiprocessing.connection import Connection

Result = TypeVar("Result")

POLL_S = 0.2
"""Timeout of one wait for workers. A signal that arrives just before the wait begins does not interrupt it; Python runs
the signal handler between two waits."""

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


def in_order(work: Callable[[int], Result], count: int, jobs: int, begin: int = 0) -> Iterator[Result]:
    """work(begin), ... work(count - 1), computed by several processes; an exception in `work` is raised here."""
    for outcome in outcomes(work, range(begin, count), max(1, min(jobs, (count - begin) // MIN_ITEMS_PER_PROCESS))):
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
            for chunk, results, _ in pool.collected(*([arriving] if is_ready else [])):
                number, item = chunk[0]
                finished[number] = WorkerKilled(item) if results is None else results[0]
    finally:
        arriving.close()
        pool.close()


def one_ahead(work: Callable[[Any], Result], items: Iterable[Any]) -> Iterator[Result | Exception]:
    """What `work` returns for each item, or the exception that it raises, computed by a thread one item ahead.

    For work that releases the interpreter's lock, such as decompression: while the caller uses one result, the thread
    computes the next one and no more. Items may come slowly: no result waits for a later item. What the source of the
    items reports about the next one comes after the caller's report of an exception. At the end of the
    iteration, which a signal or an error may cause, the thread begins no further item; it does not keep the process
    from ending.
    """
    ready: SimpleQueue[tuple[Result | Exception] | Exception | None] = SimpleQueue()
    room, ended = Semaphore(1), False

    def run() -> None:
        numbered = enumerate(items)
        try:
            while room.acquire() and not ended:
                following = next(numbered, None)
                ready.put(None if following is None else (_outcome(work, following),))
                if following is None:
                    return
        except Exception as error:  # of the items' source: raised where the results are consumed
            ready.put(error)

    Thread(target=run, name="one ahead", daemon=True).start()
    try:
        while (result := _waited_for(ready)) is not None:
            if isinstance(result, Exception):
                raise result
            (outcome,) = result
            if isinstance(outcome, Exception):
                yield outcome
                room.release()
            else:
                room.release()
                yield outcome
    finally:
        ended = True
        room.release()


def _waited_for(queue: "SimpleQueue[Result]") -> Result:
    """The next entry of a queue; a signal ends the wait by its exception."""
    while True:
        with suppress(Empty):
            return queue.get(timeout=POLL_S)


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
    """Worker processes; unlike those of an executor they have no threads or locks that a kill could leave behind.

    OpenCV uses one thread in each of them, or all cores if `threads` is None.
    """

    def __init__(self, work: Callable[[Any], Any], threads: int | None = 1) -> None:
        import multiprocessing

        self._work, self._threads = work, threads
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

        while not (ready := wait([*self.busy, *others], POLL_S)):
            pass
        for connection in ready:
            if connection in others:
                continue
            worker, chunk, started_s = self.busy.pop(connection)
            try:
                received = worker.connection.recv()
            except (EOFError, OSError):
                worker.process.join()
                received = None
            else:
                self._idle.append(worker)
            yield chunk, received, perf_counter() - started_s

    def close(self) -> None:
        """End all workers."""
        for worker in [*self._idle, *(each for each, _, _ in self.busy.values())]:
            worker.process.terminate()
            worker.process.join()
            worker.connection.close()

    def _started(self) -> _Worker:
        ours, theirs = self._context.Pipe()
        process = self._context.Process(target=_serve, args=(self._work, theirs, self._threads), daemon=True)
        # a worker inherits the mask: Ctrl-C, which the parent handles, must not end it while it starts either
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        theirs.close()
        return _Worker(process, ours)


def _serve(work: Callable[[Any], Any], connection: "Connection[Any, Any]", threads: int | None) -> None:
    """Main function of a worker: it ends when the parent closes the connection, even by being killed."""
    import cv2

    if threads is not None:
        cv2.setNumThreads(threads)
    try:
        while True:
            connection.send([work(index) for index in connection.recv()])
    except (EOFError, OSError):
        return


class LimitedCalls(Generic[Result]):
    """Calls of a function, one after the other, in a process of their own.

    A signal ends such a call at once even while C code runs, which holds signals back in its own process; and a call
    that takes more CPU time than its limit ends. The process starts with the first call and serves all of them.
    `work` must be a function that it can import.
    """

    def __init__(self, work: Callable[..., Result]) -> None:
        self._pool = Pool(partial(_limited, work), threads=None)

    def __enter__(self) -> "LimitedCalls[Result]":
        return self

    def __exit__(self, *_: object) -> None:
        self._pool.close()

    def __call__(self, limit_s: int, *arguments: Any) -> Result:
        """The function's result; its exception, or `WorkerKilled` after more than `limit_s` seconds of CPU time."""
        self._pool.give([(limit_s, arguments)])
        ((_, outcomes, _),) = self._pool.collected()
        if outcomes is None:
            raise WorkerKilled(arguments)
        if isinstance(outcomes[0], Exception):
            raise outcomes[0]
        result: Result = outcomes[0]
        return result


def _limited(work: Callable[..., Result], call: tuple[int, tuple[Any, ...]]) -> Result | Exception:
    """The result or exception of one call; the kernel kills the process (SIGXCPU) when its time is over."""
    limit_s, arguments = call
    end_s, most_s = math.ceil(process_time()) + limit_s, resource.getrlimit(resource.RLIMIT_CPU)[1]
    resource.setrlimit(resource.RLIMIT_CPU, (end_s if most_s == resource.RLIM_INFINITY else min(end_s, most_s), most_s))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))  # this signal would leave a memory dump
    try:
        return work(*arguments)
    except Exception as error:
        return error
