"""Ticks at a fixed rate, by a clock of which the test decides what time it is."""

import threading
from collections.abc import Iterator

import pytest

from ringpose.cli import live_input


class Clock:
    """Advances only while somebody sleeps."""

    def __init__(self) -> None:
        self.now_s = 1000.0

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        self.now_s += duration_s


@pytest.fixture
def clock(monkeypatch) -> Clock:
    made = Clock()
    monkeypatch.setattr(live_input, "monotonic", made.monotonic)
    monkeypatch.setattr(live_input, "sleep", made.sleep)
    return made


@pytest.fixture
def silent() -> Iterator[Iterator[int]]:
    """A source of which nothing arrives before the end of the test."""
    ended = threading.Event()

    def items() -> Iterator[int]:
        ended.wait()
        yield from ()

    yield items()
    ended.set()


def test_ticks_come_at_the_rate_while_nothing_arrives(clock, silent):
    ticks = live_input.at_ticks(silent, 0.05)

    times_s = [clock.now_s for _ in range(5) if next(ticks) == []]

    assert times_s == pytest.approx([1000.05, 1000.10, 1000.15, 1000.20, 1000.25])


def test_ticks_that_are_late_by_more_than_a_period_are_left_out(clock, silent):
    ticks = live_input.at_ticks(silent, 0.05)
    next(ticks)
    clock.now_s += 1.0

    times_s = [clock.now_s for _ in range(3) if next(ticks) == []]

    assert times_s == pytest.approx([1001.05, 1001.05, 1001.10])
