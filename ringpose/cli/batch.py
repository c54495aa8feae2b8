"""Many inputs, of which some may be bad: each is named on stderr, the rest goes on, the worst status is returned."""

from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

from ringpose.cli import messages
from ringpose.errors import DataError, NoInputError

if TYPE_CHECKING:
    from ringpose.files.inputs import Input, Problem


class Batch:
    """The worst exit status met so far."""

    def __init__(self) -> None:
        self.status = 0

    @contextmanager
    def item(self) -> Iterator[None]:
        """One input: bad data ends the block, not the batch. Anything else that fails would fail for the rest too."""
        try:
            yield
        except (DataError, NoInputError) as problem:
            messages.error(problem)
            self.met(problem.status)

    def good(self, items: "Iterable[Input | Problem]") -> "Iterator[Input]":
        """The inputs that are no errors, as they come; the errors are named on stderr."""
        for item in items:
            if isinstance(item, DataError | NoInputError):
                messages.error(item)
                self.met(item.status)
            else:
                yield item

    def met(self, status: int) -> None:
        """Remember a status."""
        self.status = max(self.status, status)

    def finish(self) -> None:
        """Leave the command with the worst status met."""
        raise typer.Exit(self.status)
