"""Figures and their limits."""

import json
import math

import numpy as np
import pytest
from benchmarks.accuracy import accuracy_figures, pose_accuracy
from benchmarks.limits import Figure, Section, Verdict, section_record, section_text
from benchmarks.speed import start_figures
from benchmarks.stripe_images import Kind, exact_break_points, stripe_image, stripe_rig, switched_shot

from ringpose.pose.pipeline import estimate_pose
from ringpose.types.detection import Detection
from ringpose.types.options import Method
from ringpose.types.pose import RingPose


@pytest.mark.parametrize(
    ("measured", "limits", "verdict"),
    [
        (0.15, {"max_value": 0.15}, Verdict.OK),
        (0.16, {"max_value": 0.15}, Verdict.MISSED),
        (0.79, {"min_value": 0.8, "max_value": 1.25}, Verdict.MISSED),
        (1.0, {"min_value": 0.8, "max_value": 1.25}, Verdict.OK),
        (math.nan, {"max_value": 0.15}, Verdict.MISSED),
        (7.0, {}, Verdict.NONE),
    ],
)
def test_a_figure_is_compared_with_its_limits(measured, limits, verdict):
    assert Figure(name="a", measured=measured, **limits).verdict is verdict


@pytest.fixture
def section():
    figures = [
        Figure(name="first", measured=0.1234, unit="px", max_value=0.2),
        Figure(name="second", measured=math.nan, max_value=1.0),
        Figure(name="third", measured=2.0, min_value=0.8, max_value=1.25),
    ]
    return Section(title="things", figures=figures)


def test_a_section_is_plain_columns(section):
    assert [line.split() for line in section_text(section).splitlines()] == [
        ["things"],
        ["measured", "limit", "verdict", "unit"],
        ["first", "0.123", "<=", "0.2", "ok", "px"],
        ["second", "-", "<=", "1", "MISSED"],
        ["third", "2", "0.8", "..", "1.25", "MISSED"],
    ]


def test_a_section_has_the_same_as_values(section):
    record = json.loads(json.dumps(section_record(section), allow_nan=False))

    assert record["section"] == "things"
    assert [(figure["measured"], figure["max"], figure["verdict"]) for figure in record["figures"]] == [
        (0.1234, 0.2, "ok"),
        (None, 1.0, "MISSED"),
        (2.0, 1.25, "MISSED"),
    ]
    assert section.missed == 2


def test_starts_are_compared_with_the_first():
    figures = start_figures({"reference": lambda: None, "ringpose x --help": lambda: None, "line": lambda: None}, 3)

    assert [(figure.name, figure.max_value, figure.unit) for figure in figures] == [
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


@pytest.mark.slow
def test_exact_break_points_miss_only_the_limits_on_nees():
    def exact(image):
        return Detection(shot="a", stamp_s=0.0, break_points=exact_break_points(image))

    _, figures = accuracy_figures(1, exact)

    missed = {figure.name.split(": ")[1] for figure in figures if figure.verdict is Verdict.MISSED}
    assert [figure.measured for figure in figures if "found" in figure.name] == [1.0] * 6
    assert missed == {"NEES"}


@pytest.mark.slow
def test_the_pose_reaches_its_bound():
    assert all(0.8 < figure.measured < 1.2 for figure in pose_accuracy(400))
