"""Background acquisition: the newest shot is yielded, and dropped ones are counted."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from benchmarks.stripe_images import Kind, switched_frames, switched_shot
from recorded_shots import make_shot

from ringpose.capture.latest_frame import EarlyStripes, NewestShots
from ringpose.detect.difference_images import laser_images
from ringpose.detect.pipeline import Prior, detect
from ringpose.errors import DeviceError
from ringpose.files.records import line_of
from ringpose.files.records.detections import detection_record
from ringpose.types.image import Shot


def shot(name: str) -> Shot:
    return make_shot(np.zeros((1, 2, 2), np.uint8), [0], name=name)


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


@pytest.fixture(scope="module")
def switched():
    image, frames = switched_frames(Kind.FOIL, 0)
    shot = switched_shot(np.concatenate([frames[1:], frames[1:2]]))
    return replace(shot, lasers=np.array([0, 1, 2, 4, 0], np.uint8)), image.rig


def early_stripes(shot: Shot) -> EarlyStripes:
    """Stripes of the frames, which arrive one after the other."""
    early = EarlyStripes()
    for frame in shot.frames:
        early.add(frame, shot.saturation_dn)
    return early


def test_stripes_found_before_the_shot_is_complete_give_the_same_detection(switched):
    complete, rig = switched
    early = early_stripes(complete)

    found = detect(complete, rig, Prior(stripes_of=early.stripes_of))

    assert line_of(detection_record(found)) == line_of(detection_record(detect(complete, rig)))


def test_a_frame_that_is_nearer_to_a_later_background_is_searched_with_that_one(switched):
    complete, _ = switched
    early = early_stripes(complete)

    assert [early.stripes_of(image) is not None for image in laser_images(complete, 3)] == [True, True, False]


def test_a_frame_is_not_searched_for_another_shot(switched):
    complete, _ = switched
    early = early_stripes(complete)
    later = replace(complete, stamp_s=complete.stamp_s + 10.0)

    assert not any(early.stripes_of(image) for image in laser_images(later, 3))
