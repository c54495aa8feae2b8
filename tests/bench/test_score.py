"""One answer against one truth."""

import numpy as np
import pytest

from ringpose.bench.score import QUANTITIES, Answer, Outcome, score
from ringpose.geometry.rotations import tilted
from ringpose.types.ring_pose import PoseFlag
from ringpose.types.truth import Truth

NOTHING = Truth(shot="a", expect="no_target")
NO_POSE = Answer(shot="a", method="paper", pose=None)
SMALL = np.eye(3) * 1e-6
"""A standard deviation of 1 mm."""


def test_the_truth_itself_has_no_errors(truth_of, answer_of):
    result = score(truth_of(), answer_of(), "paper", None)

    assert result.outcome is Outcome.OK
    assert set(result.errors) == {name for name in QUANTITIES if "nees" not in name}
    assert max(map(abs, result.errors.values())) < 1e-12


def test_a_center_error_is_given_by_axis_with_its_sign_and_as_a_length(truth_of, answer_of):
    off = truth_of().center_m + np.array([0.002, -0.003, 0.006])

    errors = score(truth_of(), answer_of(center_m=off), "paper", None).errors

    axes = [errors[f"center_{axis}_m"] for axis in "xyz"]
    np.testing.assert_allclose([*axes, errors["center_m"]], [0.002, -0.003, 0.006, 0.007], atol=1e-15)


def test_normal_radius_and_grasp_errors_are_those_put_in(truth_of, answer_of, on_ring):
    answer = answer_of(
        normal=tilted(truth_of().normal, np.array([np.tan(0.02), 0.0])),
        radius_inner_m=0.401,
        radius_outer_m=0.497,
        grasp_m=on_ring(0.1, 0.455),
    )

    errors = score(truth_of(), answer, "paper", None).errors

    found = [errors[name] for name in ("normal_rad", "radius_inner_m", "radius_outer_m", "grasp_m")]
    np.testing.assert_allclose(found, [0.02, 0.001, -0.003, 0.005], atol=1e-12)


def test_a_radius_that_was_not_seen_is_not_scored(truth_of, answer_of):
    errors = score(truth_of(), answer_of(radius_inner_m=np.nan), "paper", None).errors

    assert "radius_inner_m" not in errors
    assert "radius_outer_m" in errors


def test_a_center_that_is_not_given_is_not_scored(truth_of, answer_of):
    errors = score(truth_of(), answer_of(center_m=np.full(3, np.nan)), "paper", None).errors

    assert {name for name in errors if "center" in name} == set()
    assert "normal_rad" in errors


def test_a_flag_makes_a_pose_degraded(truth_of, answer_of):
    assert score(truth_of(), answer_of(flags=PoseFlag.RADIUS_WEAK), "paper", None).outcome is Outcome.DEGRADED


@pytest.mark.parametrize(
    ("expect", "outcome"),
    [("pose", Outcome.MISSED), ("partial", Outcome.PARTIAL_NONE), ("no_target", Outcome.NO_TARGET)],
)
def test_no_pose_is_a_miss_only_where_one_is_to_be_had(truth_of, expect, outcome):
    result = score(truth_of(expect=expect), NO_POSE, "paper", None)

    assert result.outcome is outcome
    assert result.errors == {}


def test_a_shot_without_a_line_is_lost(truth_of):
    assert score(truth_of(), None, "paper", None).outcome is Outcome.LOST


def test_a_pose_of_nothing_is_wrong(answer_of):
    result = score(NOTHING, answer_of(), "paper", None)

    assert result.outcome is Outcome.WRONG
    assert result.errors == {}


@pytest.mark.parametrize(("off_mm", "outcome"), [(4.9, Outcome.OK), (5.1, Outcome.WRONG)])
def test_a_center_beyond_five_of_its_sigmas_is_wrong(truth_of, answer_of, off_mm, outcome):
    answer = answer_of(center_m=truth_of().center_m + np.array([0, off_mm / 1000, 0]), covariance_center_m2=SMALL)

    result = score(truth_of(), answer, "paper", None)

    assert result.outcome is outcome
    assert result.errors["center_nees"] == pytest.approx(off_mm**2 / 3)


def test_a_center_that_is_flagged_is_degraded_however_far_off(truth_of, answer_of):
    answer = answer_of(center_m=np.zeros(3), covariance_center_m2=SMALL, flags=PoseFlag.CENTER_WEAK)

    assert score(truth_of(), answer, "paper", None).outcome is Outcome.DEGRADED


def test_a_flag_of_something_else_does_not_excuse_the_center(truth_of, answer_of):
    answer = answer_of(center_m=np.zeros(3), covariance_center_m2=SMALL, flags=PoseFlag.RADIUS_WEAK)

    assert score(truth_of(), answer, "paper", None).outcome is Outcome.WRONG


def test_the_normals_covariance_gives_its_nees(truth_of, answer_of):
    covariance = np.diag([1e-4, 4e-4, 1, 1, 1, 1, 1])
    answer = answer_of(normal=truth_of().normal, covariance=covariance)
    truth = truth_of(normal=tilted(answer.pose.normal, np.array([0.01, 0.04])))

    errors = score(truth, answer, "paper", None).errors

    assert errors["normal_nees"] == pytest.approx((1 + 4) / 2)


def test_a_partial_shot_is_scored_on_normal_and_grasp_alone(truth_of, answer_of):
    answer = answer_of(center_m=np.zeros(3), covariance_center_m2=SMALL)

    result = score(truth_of(expect="partial"), answer, "paper", None)

    assert result.outcome is Outcome.PARTIAL
    assert set(result.errors) == {"normal_rad", "grasp_m"}


HALF_BAND_RAD = 0.1 / 0.9
"""Half the width of the band of 0.4 to 0.5 m, seen from the centre: 0.05 m at 0.45 m."""


@pytest.mark.parametrize(
    ("angle_rad", "outcome"),
    [
        (-0.2 - 0.99 * HALF_BAND_RAD, Outcome.OK),
        (0.3 + 0.99 * HALF_BAND_RAD, Outcome.OK),
        (-0.2 - 1.01 * HALF_BAND_RAD, Outcome.WRONG),
        (0.3 + 1.01 * HALF_BAND_RAD, Outcome.WRONG),
        (np.pi, Outcome.WRONG),
    ],
)
def test_a_grasp_point_outside_the_arc_that_the_stripes_span_is_wrong(
    truth_of, answer_of, on_ring, camera, angle_rad, outcome
):
    answer = answer_of(grasp_m=on_ring(angle_rad, 0.45))

    assert score(truth_of(), answer, "paper", camera).outcome is outcome


def test_a_break_point_that_is_not_seen_spans_nothing(truth_of, answer_of, on_ring, camera):
    seen = truth_of().break_points_px.copy()
    seen[2] = np.nan
    answer = answer_of(grasp_m=on_ring(0.3, 0.45))

    assert score(truth_of(break_points_px=seen), answer, "paper", camera).outcome is Outcome.WRONG


def test_without_a_camera_the_arc_goes_unchecked(truth_of, answer_of, on_ring):
    assert score(truth_of(), answer_of(grasp_m=on_ring(np.pi, 0.45)), "paper", None).outcome is Outcome.OK
