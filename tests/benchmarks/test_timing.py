"""Times taken in turns and by stage, and the first lines of processes whose start is timed."""

import json

import cv2
import pytest
from benchmarks.limits import Figure
from benchmarks.stages import REST, STAGES, stage_times_s
from benchmarks.stripe_images import Kind, shot_of, stripe_image
from benchmarks.timing import median_times_s, one_core, start_calls

from ringpose.detect.stripes import find_stripes


def test_calls_take_turns_and_medians_count_without_the_first_round():
    now_s, order = [0.0], []

    def passes(name, *times_s):
        remaining = iter(times_s)

        def call():
            order.append(name)
            now_s[0] += next(remaining)

        return call

    calls = {"a": passes("a", 50.0, 1.0, 9.0, 2.0), "b": passes("b", 5.0, 5.0, 5.0, 5.0)}

    assert median_times_s(calls, 3, lambda: now_s[0]) == {"a": 2.0, "b": 5.0}
    assert order == ["a", "b"] * 4


def test_one_core_ends_with_the_block():
    before = cv2.getNumThreads()
    cv2.setNumThreads(2)

    with one_core():
        inside = cv2.getNumThreads()
    after = cv2.getNumThreads()
    cv2.setNumThreads(before)

    assert (inside, after) == (1, 2)


def test_a_time_by_the_clock_misses_its_limit_on_an_idle_machine_only():
    idle, busy = (Figure(name="start", measured=2.0, max_value=1.0, is_judged=judged) for judged in (True, False))

    assert (idle.is_kept, busy.is_kept) == (False, True)
    assert str(idle).startswith("MISSED")
    assert "not judged" in str(busy)


def test_the_time_of_a_stage_is_that_of_its_function_and_of_what_it_calls():
    image = stripe_image(Kind.DARK, 0).image

    times_s = stage_times_s(lambda: find_stripes(image), 40)

    assert set(times_s) == {*STAGES, REST}
    assert times_s["stripes"] > 0.5 * sum(times_s.values()) > 0.0


@pytest.mark.slow
def test_starts_are_timed_until_the_help_or_a_good_pose_is_written(tmp_path):
    image = stripe_image(Kind.DARK, 0)

    lines = {name: call() for name, call in start_calls(tmp_path, shot_of(image), image.rig).items()}

    assert lines["import numpy, cv2"] == ""
    assert "Usage" in lines["ringpose pose --help"]
    poses = [json.loads(lines[f"first pose of a {source}"]) for source in ("detection", "shot")]
    assert [pose["status"] for pose in poses] == ["ok", "ok"]
