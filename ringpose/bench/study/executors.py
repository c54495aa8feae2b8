"""Where the shots of a study are computed: this process, several processes, or a dask cluster.

Work is sent as indices, in chunks that take seconds, and comes back as rows; never images. At most a few chunks
wait for each worker. A chunk whose worker was killed is computed again shot by shot; a shot that kills several workers
is reported as failed.
"""

import hashlib
import logging
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Mapping
from functools import lru_cache
from importlib import import_module
from pathlib import Path
from time import perf_counter
from typing import Any, NamedTuple

from ringpose.errors import DataError, DeviceError
from ringpose.files.io import read_bytes
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


class Done(NamedTuple):
    """A finished shot with its rows."""

    shot: int
    rows: Rows | None
    """None for a shot that kills its worker."""


def software() -> dict[str, str]:
    """Versions on which results depend, and the hash of the installed code."""
    import platform
    from importlib.metadata import version

    import cv2
    import numpy as np

    from ringpose import __file__ as package

    return {
        "version": version("ringpose"),
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


def here(work: Work, indices: Iterable[int]) -> Iterator[Done]:
    """Compute the shots one by one in this process."""
    for index in indices:
        yield Done(index, work(index))


# Processes


def by_processes(work: Work, indices: Iterable[int], jobs: int) -> Iterator[Done]:
    """Compute the shots in chunks by this number of processes; they come in any order.

    A process that is killed is replaced.
    """
    chunks, pool = _Chunks(indices), Pool(work)
    try:
        while pool.busy or chunks.remain:
            while len(pool.busy) < jobs and (chunk := chunks.next()):
                pool.give(chunk)
            for chunk, found, duration_s in pool.collected():
                if found is None:
                    yield from (Done(index, None) for index in chunks.killed(chunk))
                else:
                    chunks.took(len(chunk), duration_s)
                    yield from map(Done, chunk, found)
    finally:
        pool.close()


class _Chunks:
    """The shots that remain, in chunks of about the same duration."""

    def __init__(self, indices: Iterable[int], duration_s: float = CHUNK_S) -> None:
        self._duration_s = duration_s
        self._indices = deque(indices)
        self._again: deque[list[int]] = deque()
        self._deaths: dict[int, int] = {}
        self._shot_s = duration_s

    @property
    def remain(self) -> bool:
        """Whether there is a further chunk."""
        return bool(self._again or self._indices)

    def next(self) -> list[int]:
        """The next chunk; empty if there is none."""
        if self._again:
            return self._again.popleft()
        size = max(1, min(MAX_CHUNK, round(self._duration_s / max(self._shot_s, 1e-6)), len(self._indices)))
        return [self._indices.popleft() for _ in range(size) if self._indices]

    def took(self, shots: int, duration_s: float) -> None:
        """Adapt the size of chunks to the time that a chunk took."""
        self._shot_s = 0.5 * (self._shot_s + duration_s / shots)

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


# Cluster


def by_cluster(
    work: Work, indices: Iterable[int], scheduler: str | None, scheduler_file: Path | None
) -> Iterator[Done]:
    """Compute the shots in chunks by the workers of a dask.distributed cluster; the extra `cluster` is needed.

    Workers with other versions are an error. A cluster that disappears ends the iteration with an error; what was
    yielded before is valid.
    """
    distributed: Any = import_module("distributed")
    for name in list(logging.root.manager.loggerDict):
        if name.startswith("distributed"):  # its errors are reported by exceptions, too
            logging.getLogger(name).setLevel(logging.CRITICAL)
    place = scheduler or _address_in(scheduler_file or Path())
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
        yield from _submitted(client, work, _Chunks(indices, CLUSTER_CHUNK_S))
    except (distributed.CancelledError, distributed.comm.core.CommClosedError, OSError, TimeoutError) as error:
        found = f"the cluster has disappeared ({type(error).__name__})"
        raise DeviceError(place, found, "finished shots are kept; start it again and repeat the command") from error
    finally:
        client.close(timeout=5)


def _address_in(scheduler_file: Path) -> str:
    """The address in the file of a scheduler; dask itself would wait for a missing file without end."""
    record = parsed_record(read_bytes(scheduler_file), str(scheduler_file))
    address = record.get("address")
    if not isinstance(address, str):
        raise DataError(str(scheduler_file), "has no address", "give the file of dask scheduler --scheduler-file")
    return address


def _submitted(client: Any, work: Work, chunks: _Chunks) -> Iterator[Done]:
    """Submit chunks, at most a few for each worker at a time, and yield their shots."""
    distributed: Any = import_module("distributed")
    futures = distributed.as_completed(loop=client.loop)
    waiting: dict[str, list[int]] = {}
    while True:
        window = CHUNKS_PER_WORKER * max(1, len(client.nthreads()))
        while len(waiting) < window and (chunk := chunks.next()):
            future = client.submit(_timed, work, chunk, pure=False)
            waiting[future.key] = chunk
            futures.add(future)
        if not waiting:
            return
        future = next(futures)
        chunk = waiting.pop(future.key)
        if future.status == "error" and isinstance(future.exception(), distributed.scheduler.KilledWorker):
            yield from (Done(index, None) for index in chunks.killed(chunk))
            continue
        duration_s, found = future.result()
        chunks.took(len(chunk), duration_s)
        yield from map(Done, chunk, found)


def _timed(work: Work, chunk: list[int]) -> tuple[float, list[Rows]]:
    """Duration and results of a chunk, on a worker of the cluster."""
    start_s = perf_counter()
    found = [work(index) for index in chunk]
    return perf_counter() - start_s, found


def _require_same_software(workers: Mapping[str, dict[str, str]], ours: Mapping[str, str]) -> None:
    for address, theirs in workers.items():
        for name, value in ours.items():
            if theirs.get(name) != value:
                found = f"has {name} {theirs.get(name)}, this process {value}"
                raise DataError(f"worker {address}", found, "install the same versions")
