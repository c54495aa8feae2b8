"""Background acquisition: the newest shot is yielded, and dropped ones are counted."""

import threading
from dataclasses import replace

import numpy as np
import pytest

from ringpose.capture.latest_frame import NewestShots
from ringpose.errors import DeviceError
from ringpose.types.image import Shot


def shot(name: str) -> Shot:
    return Shot(
        name=name,
        images=np.zeros((1, 2, 2), np.uint8),
        lasers=np.array([0], np.uint8),
        stamp_s=np.array([0.0]),
        exposure_s=np.array([0.01]),
    )


class Bursts:
    """Yields the requested number of shots at once, then waits for the next request."""

    def __init__(self) -> None:
        self.requested = threading.Semaphore(0)
        self.taken = threading.Semaphore(0)
        self.number = 0

    def __iter__(self):
        return self

    def __next__(self) -> Shot:
        if self.number:
            self.taken.release()
        self.requested.acquire()
        self.number += 1
        return shot(f"s{self.number}")

    def take(self, count: int) -> None:
        for _ in range(count):
            self.requested.release()
        for _ in range(count):
            self.taken.acquire()


def test_shots_lost_to_changing_light_are_counted_as_dropped():
    spoiled = replace(shot("a"), meta={"attempts_lost": {"ambient_changed": [30.0, -29.0]}})

    with NewestShots(iter([spoiled])) as newest:
        (live,) = newest

    assert live.dropped == 2


def test_a_fast_consumer_gets_every_shot():
    bursts = Bursts()

    with NewestShots(bursts) as newest:
        seen = []
        for _ in range(3):
            bursts.take(1)
            live = next(newest)
            seen.append((live.shot.name, live.dropped))
        bursts.requested.release()

    assert seen == [("s1", 0), ("s2", 0), ("s3", 0)]


def test_a_slow_consumer_gets_the_newest_shot_and_the_number_of_dropped_ones():
    bursts = Bursts()

    with NewestShots(bursts) as newest:
        bursts.take(1)
        first = next(newest)
        bursts.take(4)
        second = next(newest)
        bursts.take(1)
        third = next(newest)
        bursts.requested.release()

    assert [(live.shot.name, live.dropped) for live in (first, second, third)] == [("s1", 0), ("s5", 3), ("s6", 0)]


def test_the_last_shot_is_yielded_before_the_end():
    with NewestShots(iter([shot("only")])) as newest:
        names = [live.shot.name for live in newest]

    assert names == ["only"]


def test_exceptions_are_raised_in_the_consumer():
    def failing():
        yield shot("a")
        raise DeviceError("camera", "is gone")

    with NewestShots(failing()) as newest:
        first = next(newest)
        with pytest.raises(DeviceError, match="is gone"):
            next(newest)

    assert first.shot.name == "a"


def test_leaving_the_block_ends_the_acquisition():
    def endless():
        while True:
            yield shot("a")

    with NewestShots(endless()) as newest:
        live = next(newest)

    assert live.shot.name == "a"
    assert "shots" not in {thread.name for thread in threading.enumerate()}
