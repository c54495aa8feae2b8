"""One estimate against one truth."""

from dataclasses import replace

import numpy as np
import pytest
from known_poses import FOCAL_PX, PRINCIPAL_PX, estimate_of, on_ring, truth_of
from ring_scenes import make_camera

from ringpose.bench.score import JUDGED, QUANTITIES, Judgement, Outcome, score
from ringpose.bench.score import estimate_of as bench_estimate_of
from ringpose.errors import DataError
from ringpose.geometry.rotations import tilted
from ringpose.types.pose import PoseFlag, PoseLine, RingVelocity
from ringpose.types.rig import Camera
from ringpose.types.truth import Truth, TruthFrame

NOTHING = Truth(shot="a", expect="no_target")
NO_POSE = bench_estimate_of(PoseLine(shot="a", stamp_s=0.0, pose=None), "x")
SMALL = np.eye(3) * 1e-6
"""A standard deviation of 1 mm."""


MOVING = {"velocity_m_s": np.array([0.05, 0.0, -0.02]), "angular_velocity_rad_s": np.array([0.01, 0.02, 3.0])}


@pytest.fixture
def camera() -> Camera:
    return make_camera((1600, 1200), (FOCAL_PX, FOCAL_PX), PRINCIPAL_PX)


def velocity_of(truth: Truth, sigmas: float = 0.0) -> RingVelocity:
    """The true velocity, without the spin about the normal, but for an error of so many standard deviations."""
    return RingVelocity(
        center_m_s=truth.velocity_m_s + np.array([0.0, sigmas * 0.01, 0.0]),
        rate_rad_s=truth.angular_velocity_rad_s * np.array([1.0, 1.0, 0.0]),
        covariance=np.diag([0.01, 0.01, 0.01, 0.02, 0.02]) ** 2,
    )


def test_the_truth_itself_has_no_errors():
    truth = truth_of(**MOVING)

    result = score(truth, estimate_of(line={"velocity": velocity_of(truth)}), "paper", None)

    assert result.outcome is Outcome.OK
    assert set(result.errors) - {"velocity_nees"} == {name for name in QUANTITIES if "nees" not in name}
    assert max(map(abs, result.errors.values())) < 1e-12


def test_errors_are_those_put_in_and_that_of_the_center_is_given_by_axis_with_its_sign_and_as_a_length():
    truth = truth_of()
    estimate = estimate_of(
        center_m=truth.center_m + np.array([0.002, -0.003, 0.006]),
        normal=tilted(truth.normal, np.array([np.tan(0.02), 0.0])),
        radius_inner_m=0.401,
        radius_outer_m=0.497,
        grasp_m=on_ring(0.1, 0.455),
    )

    errors = score(truth, estimate, "paper", None).errors

    names = [*(f"center_{axis}_m" for axis in "xyz"), "center_m", "normal_rad"]
    found = [errors[name] for name in [*names, "radius_inner_m", "radius_outer_m", "grasp_m"]]
    np.testing.assert_allclose(found, [0.002, -0.003, 0.006, 0.007, 0.02, 0.001, -0.003, 0.005], atol=1e-12)


def test_quantities_without_a_value_are_not_scored():
    errors = score(truth_of(), estimate_of(radius_inner_m=np.nan, center_m=np.full(3, np.nan)), "paper", None).errors

    assert {name for name in errors if "center" in name or "inner" in name} == set()
    assert {"radius_outer_m", "normal_rad"} <= errors.keys()


@pytest.mark.parametrize(
    ("flag", "outcome"),
    [
        (PoseFlag.RADIUS_WEAK, Outcome.DEGRADED),
        (PoseFlag.RADIUS_UNVERIFIED, Outcome.OK),
        (PoseFlag.RIG_UNCHECKED, Outcome.OK),
    ],
)
def test_a_flag_makes_a_pose_degraded_unless_it_is_harmless(flag, outcome):
    result = score(truth_of(), estimate_of(flags=flag), "paper", None)

    assert (result.outcome, result.status) == (outcome, str(outcome))
    with_unknown_flag = score(truth_of(), replace(estimate_of(), status="degraded"), "ml", None)
    assert (with_unknown_flag.outcome, with_unknown_flag.status) == (Outcome.DEGRADED, "degraded")


@pytest.mark.parametrize(("sigmas", "wrong"), [(4.9, ()), (5.1, ("velocity",))])
def test_a_velocity_is_wrong_from_five_standard_deviations(sigmas, wrong):
    truth = truth_of(**MOVING)

    result = score(truth, estimate_of(line={"velocity": velocity_of(truth, sigmas)}), "ml", None)

    assert result.wrong == wrong
    assert result.errors["velocity_m_s"] == pytest.approx(sigmas * 0.01)
    assert result.errors["velocity_nees"] == pytest.approx(sigmas**2 / 5)
    assert result.errors["rate_rad_s"] < 1e-12
    without_truth = score(truth_of(), estimate_of(line={"velocity": velocity_of(truth, sigmas)}), "ml", None)
    assert "velocity" not in without_truth.judgements


def test_a_spin_about_the_true_normal_is_not_an_error_of_a_pose_whose_normal_is_off():
    truth = truth_of(**MOVING)
    off = estimate_of(normal=tilted(truth.normal, np.array([0.002, 0.0])), line={"velocity": velocity_of(truth)})

    assert score(truth, off, "ml", None).errors["rate_rad_s"] < 1e-6  # of a spin of 3 rad/s


def turned(angle_rad: float) -> np.ndarray:
    return np.array([-np.sin(angle_rad), 0.0, -np.cos(angle_rad)])


@pytest.mark.parametrize(
    ("stamp_s", "line"),
    [
        (100.0, {"stamp_s": 99.0, "pose_stamp_s": 100.1}),
        (None, {"stamp_s": 100.0, "pose_stamp_s": 100.1}),
        (100.0, {"stamp_s": 100.1}),
    ],
)
def test_the_truth_is_moved_to_the_instant_at_which_the_pose_holds(stamp_s, line):
    rates = {"velocity_m_s": np.array([0.05, 0.0, -0.02]), "angular_velocity_rad_s": np.array([0.0, 0.1, 3.0])}
    truth = truth_of(stamp_s=stamp_s, **rates)
    there = {"center_m": truth.center_m + 0.1 * truth.velocity_m_s, "normal": turned(0.01)}

    errors = score(truth, estimate_of(line=line, **there), "ml", None).errors

    assert errors["center_m"] < 1e-12
    assert errors["normal_rad"] < 1e-12


@pytest.mark.parametrize(
    ("estimate", "expect", "outcome"),
    [
        (NO_POSE, "pose", Outcome.MISSED),
        (NO_POSE, "partial", Outcome.PARTIAL_NONE),
        (NO_POSE, "no_target", Outcome.NO_TARGET),
        (None, "pose", Outcome.LOST),
    ],
)
def test_a_shot_without_a_pose_is_missed_only_if_one_is_expected(estimate, expect, outcome):
    result = score(truth_of(expect=expect), estimate, "paper", None)

    assert result.outcome is outcome
    assert result.errors == {}


def test_nees_are_those_of_the_covariances():
    off_m = truth_of().center_m + np.array([0, 0.0049, 0])
    covariance = np.diag([1e-4, 4e-4, 1, 1, 1, 1, 1])
    estimate = estimate_of(center_m=off_m, covariance=covariance, covariance_center_m2=SMALL)
    truth = truth_of(normal=tilted(estimate.line.pose.normal, np.array([0.01, 0.04])))

    errors = score(truth, estimate, "paper", None).errors

    assert errors["normal_nees"] == pytest.approx((1 + 4) / 2)
    assert errors["center_nees"] == pytest.approx(4.9**2 / 3)


def test_of_a_partial_shot_normal_and_grasp_are_scored_and_a_center_that_is_reported_is_judged():
    unjudged = score(truth_of(expect="partial"), estimate_of(center_m=np.zeros(3)), "paper", None)
    wrong = estimate_of(center_m=np.zeros(3), covariance_center_m2=SMALL)
    judged = score(truth_of(expect="partial"), wrong, "paper", None)

    assert (unjudged.outcome, set(unjudged.errors)) == (Outcome.PARTIAL, {"normal_rad", "grasp_m"})
    assert (judged.outcome, judged.wrong) == (Outcome.WRONG, ("center",))


SIGMAS = np.array([0.002, 0.002, 0.001, 0.001, 0.001, 0.003, 0.004])
"""Of a covariance: tilts in radians, the rest in metres."""


def off_by(sigmas: float, name: str, truth: Truth) -> dict:
    """Changes of the true pose that put one quantity off by so many standard deviations, with all covariances."""
    changes = {
        "center": {"center_m": truth.center_m + np.array([0, 0, sigmas * 0.001])},
        "normal": {"normal": tilted(truth.normal, np.array([sigmas * 0.002, 0.0]))},
        "grasp along the normal": {"grasp_m": truth.center_m + np.array([0.45, 0, sigmas * 0.0005])},
        "grasp radially": {"grasp_m": truth.center_m + np.array([0.45 + sigmas * 0.0005, 0, 0])},
        "grasp along the band": {"grasp_m": truth.center_m + np.array([0.45 * np.cos(0.05), 0.45 * np.sin(0.05), 0])},
        "radius_inner": {"radius_inner_m": 0.4 - sigmas * 0.003},
        "radius_outer": {"radius_outer_m": 0.5 + sigmas * 0.004},
    }[name]
    covariances = {
        "covariance": np.diag(SIGMAS**2),
        "covariance_center_m2": SMALL,
        "covariance_grasp_m2": SMALL / 4,
    }
    return {**covariances, **changes}


NAMED = ["center", "normal", "grasp along the normal", "grasp radially", "radius_inner", "radius_outer"]


@pytest.mark.parametrize("name", NAMED)
def test_a_quantity_is_wrong_from_five_standard_deviations_and_grossly_from_six(name):
    truth, quantity = truth_of(), name.split()[0]

    correct, wrong, gross = (score(truth, estimate_of(**off_by(s, name, truth)), "ml", None) for s in (4.9, 5.1, 6.1))

    assert correct.distances[quantity] == pytest.approx(4.9, rel=1e-3)
    assert set(correct.judgements.values()) == {Judgement.CORRECT}
    assert (correct.outcome, wrong.outcome) == (Outcome.OK, Outcome.WRONG)
    assert (wrong.wrong, wrong.gross) == ((quantity,), ())
    assert (gross.wrong, gross.gross) == ((quantity,), (quantity,))


def test_where_along_the_band_the_grasp_point_lies_is_not_judged():
    result = score(truth_of(), estimate_of(**off_by(9.0, "grasp along the band", truth_of())), "ml", None)

    assert result.wrong == ()
    assert result.distances["grasp"] < 1e-9


EXCUSES = {
    PoseFlag.CENTER_WEAK: {"center"},
    PoseFlag.SIDE_UNKNOWN: {"center"},
    PoseFlag.GRASP_WEAK: {"grasp"},
    PoseFlag.VELOCITY_WEAK: {"velocity"},
    PoseFlag.NORMAL_WEAK: {"normal"},
    PoseFlag.RADIUS_WEAK: {"radius_inner", "radius_outer"},
    PoseFlag.RADIUS_INCONSISTENT: {"center", "radius_inner", "radius_outer"},
    PoseFlag.RADIUS_UNVERIFIED: {"center", "radius_inner", "radius_outer"},
    PoseFlag.INCONSISTENT: set(JUDGED),
    PoseFlag.ASSIGNMENT_AMBIGUOUS: set(JUDGED),
}
"""The quantities that a flag names; the other flags name none."""


@pytest.mark.parametrize("flag", PoseFlag)
def test_a_flag_excuses_the_quantities_that_it_names_and_no_other(flag):
    named = EXCUSES.get(flag, set())
    truth = truth_of(**MOVING)
    changes = {key: value for name in NAMED for key, value in off_by(9.0, name, truth).items() if "cov" not in key}
    covariances = {key: value for key, value in off_by(0.0, "center", truth).items() if "cov" in key}
    line = {"velocity": velocity_of(truth, sigmas=9.0)}

    result = score(truth, estimate_of(**covariances, **changes, flags=flag, line=line), "ml", None)

    assert set(result.wrong) == set(JUDGED) - named
    assert result.outcome is (Outcome.WRONG if result.wrong else Outcome.DEGRADED)
    assert {name for name, found in result.judgements.items() if found is Judgement.FLAGGED} == named


def test_a_quantity_without_a_covariance_is_not_judged_but_the_grasp_point_is():
    covariance = np.diag(SIGMAS**2)
    covariance[5, :] = covariance[:, 5] = np.nan

    none = score(truth_of(), estimate_of(center_m=np.zeros(3)), "paper", None).judgements
    without_a_row = score(truth_of(), estimate_of(covariance=covariance), "ml", None).judgements

    assert none.pop("grasp") is Judgement.CORRECT
    assert set(none.values()) == {Judgement.NO_COVARIANCE}
    assert without_a_row["radius_inner"] is Judgement.NO_COVARIANCE
    assert without_a_row["radius_outer"] is without_a_row["normal"] is Judgement.CORRECT


@pytest.mark.parametrize(("off_m", "judgement"), [(0.0549, Judgement.CORRECT), (0.0551, Judgement.WRONG)])
def test_a_grasp_point_5_mm_beside_the_band_is_wrong_whatever_its_covariance(off_m, judgement):
    estimate = estimate_of(grasp_m=truth_of().center_m + np.array([0.45 + off_m, 0, 0]), covariance_grasp_m2=np.eye(3))

    result = score(truth_of(), estimate, "ml", None)

    assert result.judgements["grasp"] is judgement
    assert result.gross == (("grasp",) if judgement is Judgement.WRONG else ())


def test_every_quantity_of_a_pose_of_nothing_is_wrong_unless_a_flag_names_it():
    unflagged = score(NOTHING, estimate_of(), "paper", None)
    flagged = score(NOTHING, estimate_of(flags=PoseFlag.RADIUS_WEAK), "paper", None)

    assert set(unflagged.gross) == set(unflagged.wrong) == set(JUDGED) - {"velocity"}
    assert set(flagged.wrong) == {"center", "normal", "grasp"}
    assert (unflagged.outcome, unflagged.errors) == (Outcome.WRONG, {})
    every_flagged = score(NOTHING, estimate_of(flags=PoseFlag.INCONSISTENT), "paper", None)
    assert (every_flagged.outcome, every_flagged.wrong) == (Outcome.DEGRADED, ())


def test_a_normal_that_is_turned_over_is_wrong():
    covariance = np.diag(SIGMAS**2)

    results = [
        score(truth_of(), estimate_of(normal=normal, covariance=covariance), "ml", None)
        for normal in (-truth_of().normal, np.array([1.0, 0.0, 0.0]))
    ]

    assert [result.gross for result in results] == [("normal",), ("normal",)]


@pytest.mark.parametrize(("stamp_s", "share"), [(100.0, 0.0), (100.03, 0.3), (100.1, 1.0), (100.15, 1.5), (99.9, -1.0)])
def test_a_truth_with_frames_is_interpolated_to_the_instant_of_the_pose(stamp_s, share):
    center_m = truth_of().center_m
    frames = [
        TruthFrame(stamp_s=100.0 + 0.1 * n, center_m=center_m + np.array([0.01 * n, 0, 0]), normal=turned(0.02 * n))
        for n in range(2)
    ]
    there = {"center_m": center_m + np.array([0.01 * share, 0, 0]), "normal": turned(0.02 * share)}

    errors = score(
        truth_of(frames=tuple(frames)), estimate_of(line={"pose_stamp_s": stamp_s}, **there), "ml", None
    ).errors

    assert errors["center_m"] < 1e-12
    assert errors["normal_rad"] < 1e-9


def test_a_pose_far_from_the_frames_of_its_truth_is_of_another_clock():
    frame = TruthFrame(stamp_s=100.0, center_m=truth_of().center_m, normal=truth_of().normal)

    with pytest.raises(DataError, match="clock"):
        score(truth_of(frames=(frame,)), estimate_of(line={"pose_stamp_s": 1.7e9}), "ml", None)


HALF_BAND_RAD = 0.1 / 0.9
"""Half the width of the band of 0.4 to 0.5 m, seen from the centre: 0.05 m at 0.45 m."""


@pytest.mark.parametrize(
    ("angle_rad", "outcome"),
    [
        (-0.2 - 0.99 * HALF_BAND_RAD, Outcome.OK),
        (0.3 + 0.99 * HALF_BAND_RAD, Outcome.OK),
        (-0.2 - 1.01 * HALF_BAND_RAD, Outcome.WRONG),
        (0.3 + 1.01 * HALF_BAND_RAD, Outcome.WRONG),
        (np.pi / 2, Outcome.WRONG),
        (np.pi, Outcome.OK),  # the stripes cross the opposite arc, which is in the image
    ],
)
def test_a_grasp_point_outside_the_arc_that_the_stripes_span_is_wrong(camera, angle_rad, outcome):
    estimate, only_first = estimate_of(grasp_m=on_ring(angle_rad, 0.45)), truth_of().break_points_px.copy()
    only_first[1:] = np.nan

    assert score(truth_of(), estimate, "paper", camera).outcome is outcome
    assert score(truth_of(), estimate, "paper", None).outcome is Outcome.OK
    if angle_rad > 0:  # a break point that is not seen spans nothing
        assert score(truth_of(break_points_px=only_first), estimate, "paper", camera).outcome is Outcome.WRONG
