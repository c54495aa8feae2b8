"""Pacing of shots, with a fake clock that advances only by waiting."""

import pytest

from ringpose.capture import latest_frame as pace


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


def test_items_are_yielded_at_the_rate(clock):
    came_s = [clock.now_s for _ in pace.paced(range(4), 2.0)]

    assert came_s == pytest.approx([100.0, 100.5, 101.0, 101.5])


def test_a_late_item_does_not_delay_others(clock):
    came_s = []
    for item in pace.paced(range(4), 2.0):
        came_s.append(clock.now_s)
        clock.now_s += 0.8 if item == 1 else 0.0

    assert came_s == pytest.approx([100.0, 100.5, 101.3, 101.5])


def test_without_a_rate_there_is_no_wait(clock):
    assert list(pace.paced("abc", None)) == ["a", "b", "c"]
    assert clock.slept_s == []


@pytest.mark.parametrize(("rate_hz", "count"), [(2.0, 3), (0.5, 1), (10.0, 11)])
def test_no_item_is_yielded_or_awaited_after_the_duration(clock, rate_hz, count):
    came = list(pace.paced(range(100), rate_hz, 1.0))

    assert len(came) == count
    assert clock.now_s <= 101.0


def test_a_duration_ends_items_without_a_rate(clock):
    came = []
    for item in pace.paced(range(100), None, 1.0):
        came.append(item)
        clock.now_s += 0.3

    assert came == [0, 1, 2, 3]


def test_the_wait_function_can_be_given(clock):
    waited_s = []

    list(pace.paced(range(3), 2.0, wait=waited_s.append))

    assert waited_s == pytest.approx([0.5, 1.0])
