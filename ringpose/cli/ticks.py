"""A fixed rate: what has arrived since the last tick, without waiting for more."""

import queue
import threading
from collections.abc import Iterable, Iterator
from time import monotonic, sleep
from typing import Generic, TypeVar

Item = TypeVar("Item")


class Ticks(Generic[Item]):
    """Yields at each tick the list of the items that have arrived; ends with the tick after the last item.

    A thread reads the items, so that a silent source does not delay a tick. A tick that is late by more than a period
    is left out rather than made up for.
    """

    def __init__(self, items: Iterable[Item], period_s: float) -> None:
        self._period_s = period_s
        self._arrived: queue.SimpleQueue[Item] = queue.SimpleQueue()
        self._ended = threading.Event()
        self._failure: BaseException | None = None
        threading.Thread(target=self._read, args=(items,), daemon=True).start()

    def _read(self, items: Iterable[Item]) -> None:
        try:
            for item in items:
                self._arrived.put(item)
        except BaseException as failure:  # raised again by the main thread
            self._failure = failure
        finally:
            self._ended.set()

    def __iter__(self) -> Iterator[list[Item]]:
        tick_s = monotonic()
        while True:
            tick_s += self._period_s
            sleep(max(tick_s - monotonic(), 0.0))
            tick_s = max(tick_s, monotonic() - self._period_s)
            last = self._ended.is_set()
            yield self._taken()
            if last:
                if self._failure is not None:
                    raise self._failure
                return

    def _taken(self) -> list[Item]:
        items: list[Item] = []
        while True:
            try:
                items.append(self._arrived.get_nowait())
            except queue.Empty:
                return items
