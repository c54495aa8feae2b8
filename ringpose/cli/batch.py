"""Batches of inputs: an invalid input is reported on stderr and skipped, and the highest exit status is returned."""

import re
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeVar

import typer

from ringpose.cli import messages
from ringpose.errors import DataError, NoInputError

if TYPE_CHECKING:
    from ringpose.files.inputs import Input, Problem


Result = TypeVar("Result")


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
        found = item.stat()
    except (OSError, ValueError):  # reported where it is read
        return None
    return found.st_dev, found.st_ino, found.st_mtime_ns


class Batch:
    """The highest exit status of the inputs processed so far.

    The counts of findings without a message of their own are reported at the end, also that of a `with` block that an
    error or a signal ends.
    """

    def __init__(self) -> None:
        self.status = 0
        self._in_a_row, self._unreported = 0, 0
        self._records: dict[tuple[str, str], tuple[str, int]] = {}
        """By file, and finding but for its numbers: what was found in the first such record, and their number."""
        self._repeated = 0

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
            found = ": ".join(filter(None, [record["key"], problem.found]))
            finding = record["file"], _NUMBER.sub("N", found)  # such as the column of an error in JSON
            first, count = self._records.get(finding, (found, 0))
            self._records[finding] = first, count + 1
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
        self.status = max(self.status, status)

    def _report_counts(self) -> None:
        self._report_count()
        for (file, _), (found, count) in self._records.items():
            if count > 1:
                records = "record" if count == 2 else "records"
                messages.echo(f"{file}: the same in {count - 1} further {records}: {found}")
        if self._repeated > 1:
            inputs = "input is" if self._repeated == 2 else "inputs are"
            messages.echo(f"{self._repeated - 1} further {inputs} given twice; give each input once")
        self._records, self._repeated = {}, 0

    def finish(self) -> None:
        """Exit the command with the highest status."""
        self._report_counts()
        raise typer.Exit(self.status)
