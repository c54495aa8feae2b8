"""Times taken in turns, and the shot that is timed."""

import cv2
import pytest

from ringpose.bench.speed import median_times_s, one_core, rendered_shot
from ringpose.detect.pipeline import detect
from ringpose.pose.pipeline import estimate_pose
from ringpose.types.options import Method
from ringpose.types.pose import RingPose


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
    cv2.setNumThreads(2)
    before = cv2.getNumThreads()

    with one_core():
        inside = cv2.getNumThreads()

    assert (inside, cv2.getNumThreads()) == (1, before)


@pytest.mark.slow
def test_the_timed_shot_shows_a_ring_half_a_metre_away():
    shot, rig = rendered_shot()

    points = detect(shot, rig, edges=False).break_points
    poses = {method: estimate_pose(points, rig, method) for method in Method}

    assert shot.images.shape == (1, 1200, 1600)
    assert [type(pose) for pose in poses.values()] == [RingPose] * len(Method)
    pose = poses[Method.ML]
    assert pose.normal[2] == pytest.approx(-1, abs=1e-3)
    assert pose.grasp_m[2] == pytest.approx(0.5, abs=1e-3)
