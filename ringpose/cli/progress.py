"""How far a command has come: on stderr, and only if a person looks at it."""

import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from typing import IO, TypeVar, cast

_Item = TypeVar("_Item")


class _Screen:
    """A terminal; when it goes away the work goes on without it."""

    encoding = "utf-8"

    def __init__(self, stream: IO[str]) -> None:
        self._stream = stream

    def isatty(self) -> bool:
        """Known before it is made."""
        return True

    def fileno(self) -> int:
        """For its size."""
        return self._stream.fileno()

    def write(self, text: str) -> int:
        """Lost if nobody can see it."""
        with suppress(OSError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        """Lost if nobody can see it."""
        with suppress(OSError):
            self._stream.flush()


def counted(items: Iterable[_Item], what: str, quiet: bool = False) -> Iterator[_Item]:
    """The items, their number on stderr while they pass; nothing is shown where stderr is no terminal."""
    if quiet or sys.stderr is None or not sys.stderr.isatty():
        yield from items
        return

    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.completed:.0f} " + what), TimeElapsedColumn())
    with Progress(
        *columns, console=Console(file=cast("IO[str]", _Screen(sys.stderr))), transient=True, redirect_stdout=False
    ) as progress:
        task = progress.add_task(what, total=None)
        for item in items:
            yield item
            progress.advance(task)
