"""Times in turns, figures beside their limits."""

import json
import math

import cv2
import numpy as np
import pytest

from ringpose.bench.speed import exact_break_points, start_gates, switched_shot
from ringpose.bench.speed_accuracy import accuracy_gates
from ringpose.bench.speed_gates import Gate, GateSection, Verdict, section_record, section_text
from ringpose.bench.speed_times import median_times_s, one_core
from ringpose.bench.stripe_images import Kind, stripe_image, stripe_rig
from ringpose.pose.pipeline import estimate_pose
from ringpose.types.detection import Detection
from ringpose.types.options import Method
from ringpose.types.pose import RingPose


class Clock:
    """Time passes only in `passes`."""

    def __init__(self):
        self.now_s = 0.0
        self.order = []

    def __call__(self):
        return self.now_s

    def passes(self, name, *times_s):
        remaining = iter(times_s)

        def call():
            self.order.append(name)
            self.now_s += next(remaining)

        return call


def test_the_median_counts_and_the_first_call_warms_up():
    clock = Clock()
    calls = {"a": clock.passes("a", 50.0, 1.0, 9.0, 2.0), "b": clock.passes("b", 5.0, 5.0, 5.0, 5.0)}

    assert median_times_s(calls, 3, clock) == {"a": 2.0, "b": 5.0}


def test_calls_take_turns():
    clock = Clock()

    median_times_s({"a": clock.passes("a", *[1.0] * 3), "b": clock.passes("b", *[1.0] * 3)}, 2, clock)

    assert clock.order == ["a", "b"] * 3


def test_one_core_ends_with_the_block():
    cv2.setNumThreads(2)
    before = cv2.getNumThreads()

    with one_core():
        inside = cv2.getNumThreads()

    assert (inside, cv2.getNumThreads()) == (1, before)


@pytest.mark.parametrize(
    ("measured", "limits", "verdict"),
    [
        (0.15, {"most": 0.15}, Verdict.OK),
        (0.16, {"most": 0.15}, Verdict.MISSED),
        (0.79, {"least": 0.8, "most": 1.25}, Verdict.MISSED),
        (1.0, {"least": 0.8, "most": 1.25}, Verdict.OK),
        (math.nan, {"most": 0.15}, Verdict.MISSED),
        (None, {"most": 0.15}, Verdict.NOT_YET),
        (7.0, {}, Verdict.FREE),
    ],
)
def test_a_figure_keeps_its_limit_or_not(measured, limits, verdict):
    assert Gate(what="a", measured=measured, **limits).verdict is verdict


@pytest.fixture
def section():
    gates = [
        Gate(what="first", measured=0.1234, unit="px", most=0.2),
        Gate(what="second", measured=None, most=1.0),
        Gate(what="third", measured=2.0, least=0.8, most=1.25),
    ]
    return GateSection(title="things", gates=gates)


def test_a_section_is_plain_columns(section):
    assert [line.split() for line in section_text(section).splitlines()] == [
        ["things"],
        ["measured", "limit", "verdict", "unit"],
        ["first", "0.123", "<=", "0.2", "ok", "px"],
        ["second", "-", "<=", "1", "not", "yet"],
        ["third", "2", "0.8", "..", "1.25", "MISSED"],
    ]


def test_a_section_has_the_same_as_values(section):
    record = section_record(section)

    assert record["section"] == "things"
    assert [(gate["measured"], gate["most"], gate["verdict"]) for gate in record["gates"]] == [
        (0.1234, 0.2, "ok"),
        (None, 1.0, "not yet"),
        (2.0, 1.25, "MISSED"),
    ]
    assert json.dumps(record["gates"][1]["measured"]) == "null"


def test_starts_are_compared_with_the_first():
    section = start_gates({"reference": lambda: None, "ringpose x --help": lambda: None, "line": lambda: None}, 3)

    assert [(gate.what, gate.most, gate.unit) for gate in section.gates] == [
        ("ringpose x --help", 1.3, "x reference"),
        ("line", 2.0, "x reference"),
    ]


def test_a_switched_shot_has_no_laser_then_each():
    assert switched_shot(np.zeros((4, 2, 2), np.uint8)).lasers.tolist() == [0, 1, 2, 4]


def test_exact_break_points_give_the_exact_radii():
    image = stripe_image(Kind.DARK, 0, stripe_rig(0.4))

    pose = estimate_pose(exact_break_points(image), image.rig, Method.PAPER_CONSTRAINED)

    assert isinstance(pose, RingPose)
    assert (pose.radius_inner_m, pose.radius_outer_m) == pytest.approx((0.567, 0.597), abs=1e-5)


def exact(image):
    return Detection(shot="a", stamp_s=0.0, break_points=exact_break_points(image))


def nothing_wrong(gates):
    return [gate.measured for gate in gates if "found" in gate.what] == [1.0] * 6


@pytest.mark.slow
def test_exact_break_points_miss_only_the_limits_on_honesty():
    _, gates = accuracy_gates(1, exact)

    missed = {gate.what.split(": ")[1] for gate in gates if gate.verdict is Verdict.MISSED}
    assert nothing_wrong(gates)
    assert missed == {"squared errors in sigmas"}
