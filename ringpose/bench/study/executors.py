"""Where the shots of a study are computed: this process, several processes, or a dask cluster.

Work is sent as indices, in chunks that take seconds, and comes back as rows; never images. At most a few chunks
wait for each worker. A chunk whose worker was killed is computed again shot by shot; a shot that kills several workers
is reported as failed.
"""

import hashlib
import logging
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import lru_cache
from importlib import import_module
from math import inf
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

from ringpose.errors import DataError, DeviceError
from ringpose.files.io import read_bytes, version
from ringpose.files.records import parsed_record
from ringpose.processes import Pool
from ringpose.types.study import Row

CHUNK_S, CLUSTER_CHUNK_S = 1.0, 5.0
"""Duration of a chunk: the cost of sending it is then negligible. A scheduler handles some hundred tasks a second, and
thus some thousand cores."""

MAX_CHUNK = 5000
"""Maximum number of shots in a chunk."""

SCHEDULER_S = 20
"""Time that a scheduler has to answer."""

WORKERS_S = 30
"""Time that a cluster's first worker has to appear."""

CHUNKS_PER_WORKER = 2
"""Chunks that a cluster may have for each worker, so that none waits for the next one."""

MAX_DEATHS = 3
"""Workers that a shot may kill before it counts as failed; fewer may have been killed from outside."""

Rows = list[Row]
Work = Callable[[int], Rows]

Finished = tuple[list[int], list[Rows] | None, float]
"""A finished chunk: its shots, their rows (None if it killed its worker), and the seconds that it took."""

Executor = Callable[[Work, "Chunks"], Iterator[Finished]]
"""Computes chunks until none is left, and yields each as soon as it is finished, in any order."""


class Done(NamedTuple):
    """A finished shot with its rows."""

    shot: int
    rows: Rows | None
    """None for a shot that kills its worker."""


def software() -> dict[str, str]:
    """Versions on which results depend, and the hash of the installed code."""
    import platform

    import cv2
    import numpy as np

    from ringpose import __file__ as package

    return {
        "version": version(),
        "code_sha256": _code_sha256(Path(str(package)).parent),
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
    }


@lru_cache(maxsize=1)
def _code_sha256(package: Path) -> str:
    """Hash of the modules; compiled kernels, which differ between machines, are not included."""
    digest = hashlib.sha256()
    for file in sorted(package.rglob("*.py")):
        digest.update(str(file.relative_to(package)).encode() + b"\0" + file.read_bytes())
    return digest.hexdigest()


def computed(executor: Executor, work: Work, indices: Iterable[int]) -> Iterator[Done]:
    """Compute the shots; they come in any order."""
    chunks = Chunks(indices)
    for chunk, results, duration_s in executor(work, chunks):
        if results is None:
            yield from (Done(index, None) for index in chunks.killed(chunk))
        else:
            chunks.took(len(chunk), duration_s)
            yield from map(Done, chunk, results)


class Chunks:
    """The shots that remain, in chunks of about the same duration."""

    def __init__(self, indices: Iterable[int]) -> None:
        self._indices = deque(indices)
        self._again: deque[list[int]] = deque()
        self._deaths: dict[int, int] = {}
        self._shot_s = inf

    @property
    def remain(self) -> bool:
        """Whether there is a further chunk."""
        return bool(self._again or self._indices)

    def next(self, duration_s: float) -> list[int]:
        """The next chunk, which takes about this time; empty if there is none. The first chunks have one shot."""
        if self._again:
            return self._again.popleft()
        size = max(1, min(MAX_CHUNK, round(duration_s / max(self._shot_s, 1e-6)), len(self._indices)))
        return [self._indices.popleft() for _ in range(size) if self._indices]

    def took(self, shots: int, duration_s: float) -> None:
        """Adapt the size of chunks to the time that a chunk took."""
        own_s = duration_s / shots
        self._shot_s = own_s if self._shot_s == inf else 0.5 * (self._shot_s + own_s)

    def killed(self, chunk: list[int]) -> list[int]:
        """Repeat a chunk whose worker was killed, shot by shot; returns the shots that are given up."""
        if len(chunk) > 1:
            self._again.extend([index] for index in chunk)
            return []
        deaths = self._deaths[chunk[0]] = self._deaths.get(chunk[0], 0) + 1
        if deaths < MAX_DEATHS:
            self._again.append(chunk)
            return []
        return chunk


# Executors


def in_this_process(work: Work, chunks: Chunks) -> Iterator[Finished]:
    """Compute one shot after the other in this process."""
    while chunk := chunks.next(0.0):
        yield chunk, *_timed(work, chunk)


def by_processes(jobs: int) -> Executor:
    """Compute by this number of processes; one that is killed is replaced."""

    def compute(work: Work, chunks: Chunks) -> Iterator[Finished]:
        pool = Pool(work)
        try:
            while pool.busy or chunks.remain:
                while len(pool.busy) < jobs and (chunk := chunks.next(CHUNK_S)):
                    pool.give(chunk)
                yield from pool.collected()
        finally:
            pool.close()

    return compute


def by_cluster(scheduler: str | None, scheduler_file: Path | None) -> Executor:
    """Compute by the workers of a dask.distributed cluster; the extra `cluster` is needed.

    Workers with other versions are an error. A cluster that disappears ends the iteration with an error; what was
    yielded before is valid.
    """

    def compute(work: Work, chunks: Chunks) -> Iterator[Finished]:
        place = scheduler or _address_in(scheduler_file or Path())
        with _connected(place) as client:
            yield from _submitted(client, work, chunks)

    return compute


@contextmanager
def _connected(place: str) -> Iterator[Any]:
    """A client of the cluster, whose workers are ready and run the same software as this process."""
    distributed: Any = import_module("distributed")
    for name in list(logging.root.manager.loggerDict):
        if name.startswith("distributed"):  # its errors are reported by exceptions, too
            logging.getLogger(name).setLevel(logging.CRITICAL)
    try:
        client = distributed.Client(place, timeout=SCHEDULER_S, set_as_default=False)
    except (OSError, TimeoutError, ValueError) as error:
        raise DeviceError(place, f"no scheduler answers: {error}", "start a dask scheduler and workers") from error
    try:
        try:
            client.wait_for_workers(1, timeout=WORKERS_S)
        except TimeoutError:
            raise DeviceError(place, f"has no workers after {WORKERS_S} s", "start dask workers") from None
        _require_same_software(client.run(software), software())
        yield client
    except (distributed.CancelledError, distributed.comm.core.CommClosedError, OSError, TimeoutError) as error:
        finding = f"the cluster has disappeared ({type(error).__name__})"
        raise DeviceError(place, finding, "finished shots are kept; start it again and repeat the command") from error
    finally:
        client.close(timeout=5)


def _address_in(scheduler_file: Path) -> str:
    """The address in the file of a scheduler; dask itself would wait for a missing file without end."""
    record = parsed_record(read_bytes(scheduler_file), str(scheduler_file))
    address = record.get("address")
    if not isinstance(address, str):
        raise DataError(str(scheduler_file), "has no address", "give the file of dask scheduler --scheduler-file")
    return address


def _submitted(client: Any, work: Work, chunks: Chunks) -> Iterator[Finished]:
    """Submit chunks, at most a few for each worker at a time, and yield those that are finished."""
    distributed: Any = import_module("distributed")
    futures = distributed.as_completed(loop=client.loop)
    waiting: dict[str, list[int]] = {}
    while True:
        window = CHUNKS_PER_WORKER * max(1, len(client.nthreads()))
        while len(waiting) < window and (chunk := chunks.next(CLUSTER_CHUNK_S)):
            future = client.submit(_timed, work, chunk, pure=False)
            waiting[future.key] = chunk
            futures.add(future)
        if not waiting:
            return
        future = next(futures)
        chunk = waiting.pop(future.key)
        if future.status == "error" and isinstance(future.exception(), distributed.scheduler.KilledWorker):
            yield chunk, None, 0.0
        else:
            yield chunk, *future.result()


def _timed(work: Work, chunk: list[int]) -> tuple[list[Rows], float]:
    """Results of a chunk, and the time that it took."""
    start_s = perf_counter()
    results = [work(index) for index in chunk]
    return results, perf_counter() - start_s


def _require_same_software(workers: Mapping[str, dict[str, str]], ours: Mapping[str, str]) -> None:
    for address, theirs in workers.items():
        for name, value in ours.items():
            if theirs.get(name) != value:
                finding = f"has {name} {theirs.get(name)}, this process {value}"
                raise DataError(f"worker {address}", finding, "install the same versions")
