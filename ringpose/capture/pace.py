"""When the next shot is due."""

import time
from collections.abc import Callable, Iterable, Iterator
from typing import TypeVar

Item = TypeVar("Item")


def paced(
    items: Iterable[Item],
    rate_hz: float | None,
    duration_s: float | None = None,
    wait: Callable[[float], None] | None = None,
) -> Iterator[Item]:
    """The items, none before its time: item k not before k / rate after the first; a late one delays no other.

    Without a rate they come as they are asked for. None comes later than `duration_s` after the first.
    """
    began_s: float | None = None
    for number, item in enumerate(items):
        now_s = time.monotonic()
        began_s = now_s if began_s is None else began_s
        due_s = now_s if rate_hz is None else max(now_s, began_s + number / rate_hz)
        if duration_s is not None and due_s > began_s + duration_s:
            return
        if due_s > now_s:
            (wait or time.sleep)(due_s - now_s)
        yield item
