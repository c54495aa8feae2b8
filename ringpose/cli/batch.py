"""Batches of inputs: an invalid input is reported on stderr and skipped, and the highest exit status is returned."""

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any, TypeVar

import typer

from ringpose.cli import messages
from ringpose.errors import DataError, NoInputError

if TYPE_CHECKING:
    from ringpose.files.inputs import Input, Problem


Result = TypeVar("Result")

Jobs = Annotated[
    int,
    typer.Option(
        "--jobs", "-j", metavar="N", min=1, help="Processes; the output does not depend on it, nor its order."
    ),
]


MAX_UNNAMED = 20
"""Problems in a row that are reported each; further ones of names and lines that cannot be read are only counted, as
random data has many lines."""


class Batch:
    """The highest exit status of the inputs processed so far."""

    def __init__(self) -> None:
        self.status = 0
        self._in_a_row, self._unreported = 0, 0

    def _report(self, problem: DataError | NoInputError) -> None:
        """Report a problem on stderr; a file that exists is always named."""
        self.record_status(problem.status)
        self._in_a_row += 1
        is_line = isinstance(problem, NoInputError) or problem.location.startswith("standard input")
        if self._in_a_row > MAX_UNNAMED and is_line:
            self._unreported += 1
        else:
            messages.error(problem)

    def _report_count(self) -> None:
        """Report how many problems were only counted, once a valid input or the end has come."""
        if self._unreported:
            messages.echo(f"{self._unreported} further lines or names cannot be read; give names or records")
        self._in_a_row, self._unreported = 0, 0

    @contextmanager
    def guarded(self) -> Iterator[None]:
        """Process one input: invalid or missing data end the block, not the batch.

        Other errors (full disk, absent device) are not caught, since they would recur for the remaining inputs.
        """
        try:
            yield
            self._report_count()
        except (DataError, NoInputError) as problem:
            self._report(problem)

    def valid_inputs(self, items: "Iterable[Input | Problem]") -> "Iterator[Input]":
        """Yield the inputs in order; report those that are errors on stderr."""
        for item in items:
            if isinstance(item, DataError | NoInputError):
                self._report(item)
            else:
                yield item

    def results(
        self, work: "Callable[[Input], Result]", items: "Iterable[Input | Problem]", jobs: int = 1
    ) -> "Iterator[Result]":
        """What `work` returns for each valid input, in their order; the others are reported on stderr.

        With several jobs `work` must be a function that worker processes can import. The first result is yielded as
        soon as it is there, even if inputs are still awaited.
        """
        valid = self.valid_inputs(items)
        if jobs == 1:
            found: Iterator[Any] = (_result(work, item) for item in valid)
        else:
            found = _in_order(partial(_result, work), valid, jobs)
        for result in found:
            with self.guarded():
                if isinstance(result, Exception):
                    raise result
                yield result

    def record_status(self, status: int) -> None:
        """Include one exit status in that of the batch."""
        self.status = max(self.status, status)

    def finish(self) -> None:
        """Exit the command with the highest status."""
        self._report_count()
        raise typer.Exit(self.status)


def _result(work: "Callable[[Input], Result]", item: "Input") -> "Result | Exception":
    """The result, or the error as a value, which can be sent between processes."""
    try:
        return work(item)
    except Exception as error:
        return error


def _in_order(work: Callable[[Any], Any], items: Iterable[Any], jobs: int) -> Iterator[Any]:
    """Results of processes in the order of the items."""
    from ringpose.processes import Pool

    source, pool = _Fetched(items, 2 * jobs), Pool(partial(_numbered, work))
    finished: dict[int, Any] = {}
    wanted = given = 0
    try:
        while True:
            while wanted in finished:
                yield finished.pop(wanted)
                wanted += 1
            while len(pool.busy) < jobs and given < wanted + 4 * jobs and source.ready:
                pool.give([(given, source.next())])
                given += 1
            if source.ended and not pool.busy:
                return
            idle = len(pool.busy) < jobs and not source.ended
            for chunk, found, _ in pool.collected(*([source.awakened] if idle else [])):
                number, item = chunk[0]
                finished[number] = DataError(_place(item), "killed the process that computed it")
                if found is not None:
                    finished[number] = found[0]
    finally:
        pool.close()


class _Fetched:
    """Items that a thread fetches, as they may come slowly, while results are awaited."""

    def __init__(self, items: Iterable[Any], limit: int) -> None:
        from multiprocessing import Pipe
        from queue import Queue
        from threading import Thread

        self._queue: Queue[tuple[str, Any]] = Queue(maxsize=limit)
        self.awakened, self._awaken = Pipe(duplex=False)
        """Can be read whenever there is a further item, or the end."""
        self.ended = False
        self._head: list[Any] = []
        Thread(target=self._fetch, args=(items,), daemon=True).start()

    @property
    def ready(self) -> bool:
        """Whether `next` returns an item at once; an error of the source is raised."""
        if not self._head and not self.ended and self.awakened.poll():
            self.awakened.recv()
            kind, value = self._queue.get()
            if kind == "error":
                raise value
            self.ended = kind == "end"
            self._head = [] if self.ended else [value]
        return bool(self._head)

    def next(self) -> Any:
        """The next item, after `ready`."""
        return self._head.pop()

    def _fetch(self, items: Iterable[Any]) -> None:
        try:
            for item in items:
                self._put("item", item)
            self._put("end", None)
        except Exception as error:
            self._put("error", error)

    def _put(self, kind: str, value: Any) -> None:
        self._queue.put((kind, value))
        self._awaken.send(None)


def _numbered(work: Callable[[Any], Any], numbered: tuple[int, Any]) -> Any:
    return work(numbered[1])


def _place(item: Any) -> str:
    return str(getattr(item, "location", item))
