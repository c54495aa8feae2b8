"""When the next shot is due."""

import time
from collections.abc import Iterable, Iterator
from typing import TypeVar

Item = TypeVar("Item")


def paced(items: Iterable[Item], rate_hz: float | None) -> Iterator[Item]:
    """The items, none before its time: item k not before k / rate after the first; a late one delays no other.

    Without a rate they come as they are asked for.
    """
    began_s: float | None = None
    for number, item in enumerate(items):
        if rate_hz is not None:
            now_s = time.monotonic()
            began_s = now_s if began_s is None else began_s
            time.sleep(max(0.0, began_s + number / rate_hz - now_s))
        yield item
