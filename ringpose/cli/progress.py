"""How far a command has come: on stderr, and only if a person looks at it."""

import sys
from collections.abc import Iterable, Iterator
from typing import TypeVar

_Item = TypeVar("_Item")


def counted(items: Iterable[_Item], what: str, quiet: bool = False) -> Iterator[_Item]:
    """The items, their number on stderr while they pass; nothing is shown where stderr is no terminal."""
    if quiet or sys.stderr is None or not sys.stderr.isatty():
        yield from items
        return

    from rich.console import Console
    from rich.progress import Progress, SpinnerColumn, TextColumn, TimeElapsedColumn

    columns = (SpinnerColumn(), TextColumn("{task.completed:.0f} " + what), TimeElapsedColumn())
    with Progress(*columns, console=Console(stderr=True), transient=True, redirect_stdout=False) as progress:
        task = progress.add_task(what, total=None)
        for item in items:
            yield item
            progress.advance(task)
