"""Progress display on stderr, shown only if stderr is a terminal."""

import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from time import monotonic
from typing import IO, TypeVar, cast

_Item = TypeVar("_Item")


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


def with_progress(items: Iterable[_Item], what: str, quiet: bool = False) -> Iterator[_Item]:
    """The items; their number is shown on stderr as they come, if this is a terminal."""
    return iter(items) if quiet or sys.stderr is None or not sys.stderr.isatty() else _counted(items, what)


def _counted(items: Iterable[_Item], what: str) -> Iterator[_Item]:
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


def with_total(items: Iterable[_Item], what: str, total: int, done: int = 0) -> Iterator[_Item]:
    """Yield the items and show on the terminal how many of `total` are done, the rate, and the time left."""
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

    rate = TextColumn("{task.fields[rate]}")
    columns = (
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn(what),
        rate,
        TimeRemainingColumn(elapsed_when_finished=True),
    )
    with Progress(
        *columns, console=Console(file=cast("IO[str]", _Screen(sys.stderr))), transient=True, redirect_stdout=False
    ) as progress:
        task = progress.add_task(what, total=total, completed=done, rate="")
        begun_s = monotonic()
        for number, item in enumerate(items, start=1):
            yield item
            progress.update(task, advance=1, rate=f"{number / max(monotonic() - begun_s, 1e-3):.3g}/s")
