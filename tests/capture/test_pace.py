"""Shots in time; the clock is a fake that only sleeping moves."""

import pytest

from ringpose.capture import pace


class Clock:
    def __init__(self) -> None:
        self.now_s = 100.0
        self.slept_s: list[float] = []

    def monotonic(self) -> float:
        return self.now_s

    def sleep(self, duration_s: float) -> None:
        self.slept_s.append(duration_s)
        self.now_s += duration_s


@pytest.fixture
def clock(monkeypatch):
    fake = Clock()
    monkeypatch.setattr(pace, "time", fake)
    return fake


def test_items_come_at_the_rate(clock):
    came_s = [clock.now_s for _ in pace.paced(range(4), 2.0)]

    assert came_s == pytest.approx([100.0, 100.5, 101.0, 101.5])


def test_a_late_item_delays_no_other(clock):
    came_s = []
    for item in pace.paced(range(4), 2.0):
        came_s.append(clock.now_s)
        clock.now_s += 0.8 if item == 1 else 0.0

    assert came_s == pytest.approx([100.0, 100.5, 101.3, 101.5])


def test_without_a_rate_nothing_sleeps(clock):
    assert list(pace.paced("abc", None)) == ["a", "b", "c"]
    assert clock.slept_s == []
