"""Batches of inputs: an invalid input is reported on stderr and skipped, and the highest exit status is returned."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

from ringpose.cli import messages
from ringpose.errors import DataError, NoInputError

if TYPE_CHECKING:
    from ringpose.files.inputs import Input, Problem


class Batch:
    """The highest exit status of the inputs processed so far."""

    def __init__(self) -> None:
        self.status = 0

    @contextmanager
    def guarded(self) -> Iterator[None]:
        """Process one input: invalid or missing data end the block, not the batch.

        Other errors (full disk, absent device) are not caught, since they would recur for the remaining inputs.
        """
        try:
            yield
        except (DataError, NoInputError) as problem:
            messages.error(problem)
            self.record_status(problem.status)

    def valid_inputs(self, items: "Iterable[Input | Problem]") -> "Iterator[Input]":
        """Yield the inputs in order; report those that are errors on stderr."""
        for item in items:
            if isinstance(item, DataError | NoInputError):
                messages.error(item)
                self.record_status(item.status)
            else:
                yield item

    def record_status(self, status: int) -> None:
        """Include one exit status in that of the batch."""
        self.status = max(self.status, status)

    def finish(self) -> None:
        """Exit the command with the highest status."""
        raise typer.Exit(self.status)
