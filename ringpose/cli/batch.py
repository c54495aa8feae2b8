"""Batches of inputs: an invalid input is reported on stderr and skipped, and the highest exit status is returned.

The progress is shown on stderr if it is a terminal.
"""

import re
import sys
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from time import monotonic
from typing import IO, TYPE_CHECKING, Annotated, Any, TypeVar, cast

import typer

from ringpose.cli import messages
from ringpose.errors import DataError, NoInputError

if TYPE_CHECKING:
    from rich.progress import Progress

    from ringpose.files.inputs import Input, Problem

Result = TypeVar("Result")
Item = TypeVar("Item")


def _processes(jobs: int) -> int:
    """The number of processes, for 0 one per core."""
    from ringpose.processes import cores

    return jobs or cores()


Jobs = Annotated[
    int,
    typer.Option(
        "--jobs",
        "-j",
        metavar="N",
        min=0,
        callback=_processes,
        help="Processes; 0 is one per core. The output does not depend on it, nor its order.",
    ),
]


MAX_UNNAMED = 20
"""Problems in a row that are reported each; further ones of names and lines that cannot be read are only counted, as
random data has many lines."""


_RECORD = re.compile(r"(?P<file>.+?):\d+(: (?P<key>.+))?")
"""Location of a record, `file:line` or `file:line: key`."""

_NUMBER = re.compile(r"\d+(\.\d+)?")


MAX_REMEMBERED = 100_000
"""Number of inputs, about 20 MB, from which further ones of an endless stream are not compared with those before."""


def _identity(item: "Input") -> Hashable | None:
    """What an input has in common with itself only: file and time of writing, or file and line; None if unknown."""
    if not isinstance(item, Path):
        return item.location
    try:
        status = item.stat()
    except (OSError, ValueError):  # reported where it is read
        return None
    return status.st_dev, status.st_ino, status.st_mtime_ns


class Batch:
    """The highest exit status of the inputs processed so far.

    The counts of findings without a message of their own are reported at the end, also that of a `with` block that an
    error or a signal ends.
    """

    def __init__(self) -> None:
        self._statuses: set[int] = set()  # inputs are named and measured by two threads, which one number would mix up
        self._in_a_row, self._unreported = 0, 0
        self._records: dict[tuple[str, str], tuple[str, int]] = {}
        """By file, and finding but for its numbers: what was found in the first such record, and their number."""
        self._repeated = 0

    @property
    def status(self) -> int:
        """The highest exit status so far."""
        return max(self._statuses, default=0)

    def __enter__(self) -> None:
        pass

    def __exit__(self, *_: object) -> None:
        self._report_counts()

    def report(self, problem: DataError | NoInputError) -> None:
        """Report a problem on stderr; a file that exists is always named.

        A finding that the records of one file share is reported for the first of them, and counted at the end.
        """
        self.record_status(problem.status)
        record = _RECORD.fullmatch(problem.location)
        if record is not None:
            finding = ": ".join(filter(None, [record["key"], problem.finding]))
            key = record["file"], _NUMBER.sub("N", finding)  # such as the column of an error in JSON
            first, count = self._records.get(key, (finding, 0))
            self._records[key] = first, count + 1
            if count:
                return
        self._in_a_row += 1
        is_line = isinstance(problem, NoInputError) or problem.location.startswith("standard input")
        if self._in_a_row > MAX_UNNAMED and is_line:
            self._unreported += 1
        else:
            messages.error(problem)

    def _report_count(self) -> None:
        """Report how many problems had no message of their own, once a valid input or the end has come."""
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
            self.report(problem)

    def valid_inputs(self, items: "Iterable[Input | Problem]", *, repeats_allowed: bool = True) -> "Iterator[Input]":
        """Yield the inputs in order; report those that are errors on stderr.

        One that was given before is named, too, unless `repeats_allowed` is false: the caller then rejects it.
        """
        given: set[Hashable] = set()
        for item in items:
            if isinstance(item, DataError | NoInputError):
                self.report(item)
            else:
                if repeats_allowed:
                    self._name_repeated(item, given)
                yield item

    def _name_repeated(self, item: "Input", given: set[Hashable]) -> None:
        """Report the first input that was given before, and count the others: their results count twice.

        A file of the same name that was written again meanwhile is another input.
        """
        identity = _identity(item)
        if identity is None:
            return
        if identity not in given:
            if len(given) < MAX_REMEMBERED:
                given.add(identity)
            return
        if not self._repeated:
            place = item if isinstance(item, Path) else item.location
            messages.echo(f"{place}: is given twice, and so is its result; give each input once")
        self._repeated += 1

    def results(
        self, work: "Callable[[Input], Result]", items: "Iterable[Input | Problem]", jobs: int = 1
    ) -> "Iterator[Result]":
        """What `work` returns for each valid input, in their order; the others are reported on stderr.

        With several jobs `work` must be a function that worker processes can import. The first result is yielded as
        soon as it is there, even if inputs are still awaited.
        """
        from ringpose.processes import outcomes

        return self.reported(outcomes(work, self.valid_inputs(items), jobs))

    def reported(self, outcomes: "Iterable[Result | Exception]") -> "Iterator[Result]":
        """Yield the results in order; exceptions about single inputs are reported on stderr, others are raised."""
        from ringpose.processes import WorkerKilled

        for outcome in outcomes:
            with self.guarded():
                if isinstance(outcome, WorkerKilled):
                    place = getattr(outcome.item, "location", outcome.item)
                    raise DataError(str(place), "killed the process that computed it")
                if isinstance(outcome, Exception):
                    raise outcome
                yield outcome

    def record_status(self, status: int) -> None:
        """Include one exit status in that of the batch."""
        self._statuses.add(status)

    def _report_counts(self) -> None:
        self._report_count()
        for (file, _), (finding, count) in self._records.items():
            if count > 1:
                records = "record" if count == 2 else "records"
                messages.echo(f"{file}: the same in {count - 1} further {records}: {finding}")
        if self._repeated > 1:
            inputs = "input is" if self._repeated == 2 else "inputs are"
            messages.echo(f"{self._repeated - 1} further {inputs} given twice; give each input once")
        self._records, self._repeated = {}, 0

    def finish(self) -> None:
        """Exit the command with the highest status."""
        self._report_counts()
        raise typer.Exit(self.status)


class _Screen:
    """A terminal on stderr; write errors are ignored, so that the work continues if the terminal is closed."""

    encoding = "utf-8"

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream

    def isatty(self) -> bool:
        """True: `with_progress` has checked it."""
        return True

    def fileno(self) -> int:
        """File descriptor, from which rich reads the terminal's size."""
        return self._stream.fileno()

    def write(self, text: str) -> int:
        """Write, ignoring errors."""
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Flush, ignoring errors."""
        with suppress(OSError):
            self._stream.flush()


def with_progress(items: Iterable[Item], what: str, quiet: bool = False) -> Iterator[Item]:
    """The items; their number is shown on stderr as they come, if this is a terminal."""
    return iter(items) if quiet or sys.stderr is None or not sys.stderr.isatty() else _counted(items, what)


def _progress(*columns: Any) -> "Progress":
    """A progress display with these columns on stderr, which goes away at its end."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(file=cast("IO[str]", _Screen(sys.stderr)))
    return Progress(*columns, console=console, transient=True, redirect_stdout=False)


def _counted(items: Iterable[Item], what: str) -> Iterator[Item]:
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    shares_terminal = sys.stdout is not None and sys.stdout.isatty()
    with _progress(SpinnerColumn(), TextColumn("{task.completed:.0f} " + what), TimeElapsedColumn()) as progress:
        task = progress.add_task(what, total=None)
        for item in items:
            if shares_terminal:  # else the line of a result continues that of the progress
                progress.stop()
            yield item
            if shares_terminal:
                progress.start()
            progress.advance(task)


def with_total(items: Iterable[Item], what: str, total: int, done: int = 0) -> Iterator[Item]:
    """Yield the items and show on the terminal how many of `total` are done, the rate, and the time left."""
    from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeRemainingColumn

    left = TimeRemainingColumn(elapsed_when_finished=True)
    rate = TextColumn("{task.fields[rate]}")
    with _progress(BarColumn(), MofNCompleteColumn(), TextColumn(what), rate, left) as progress:
        task = progress.add_task(what, total=total, completed=done, rate="")
        begun_s = monotonic()
        for number, item in enumerate(items, start=1):
            yield item
            progress.update(task, advance=1, rate=f"{number / max(monotonic() - begun_s, 1e-3):.3g}/s")
