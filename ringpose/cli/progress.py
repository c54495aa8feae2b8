"""Progress display on stderr, shown only if stderr is a terminal."""

import sys
from collections.abc import Iterable, Iterator
from contextlib import suppress
from time import monotonic
from typing import IO, TYPE_CHECKING, Any, TypeVar, cast

if TYPE_CHECKING:
    from rich.progress import Progress

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


def _progress(*columns: Any) -> "Progress":
    """A progress display with these columns on stderr, which goes away at its end."""
    from rich.console import Console
    from rich.progress import Progress

    console = Console(file=cast("IO[str]", _Screen(sys.stderr)))
    return Progress(*columns, console=console, transient=True, redirect_stdout=False)


def _counted(items: Iterable[_Item], what: str) -> Iterator[_Item]:
    from rich.progress import SpinnerColumn, TextColumn, TimeElapsedColumn

    with _progress(SpinnerColumn(), TextColumn("{task.completed:.0f} " + what), TimeElapsedColumn()) as progress:
        task = progress.add_task(what, total=None)
        for item in items:
            yield item
            progress.advance(task)


def with_total(items: Iterable[_Item], what: str, total: int, done: int = 0) -> Iterator[_Item]:
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
