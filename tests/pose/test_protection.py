"""Protection levels: how far a pose may be off, at a risk."""

from dataclasses import replace
from math import inf

import numpy as np
import pytest
from ring_scenes import face_points_of, make_scene, with_stripes
from ring_streams import ASSUMED, moved, poses_before, within_stability
from scipy.optimize import brentq
from scipy.stats import norm

from ringpose.estimate.covariance import CENTER, GRASP, difference_from, joint_covariance, quantities
from ringpose.estimate.explanation import explain
from ringpose.estimate.factors.prior import Prior
from ringpose.estimate.faults import END_SD_PX
from ringpose.estimate.measurements import measurements_of
from ringpose.estimate.pose_errors import mahalanobis_squared, tilt_error_rad
from ringpose.estimate.ring_estimate import estimate_ring
from ringpose.estimate.separation import solution_separation
from ringpose.geometry.rotations import angle_between
from ringpose.measure.stream import pose_line, pose_result
from ringpose.pose.protection import UNCOVERED_PROBABILITY, overbound, protection_level, protection_of
from ringpose.types.assumptions import USUAL, AssumptionOptions, Assumptions, motion_prior
from ringpose.types.detection import Detection
from ringpose.types.pose import PoseFlag
from ringpose.types.protection import WRONG_SIGMAS, Separation

STAMPS_S = 100.0 + np.arange(3) / 10


def detection_of(points) -> Detection:
    return Detection(shot="a", stamp_s=100.0, break_points=points, ring_edges=None)


ROUND = Assumptions(ring_tolerance_m=1e-4)
NO_FLAG = PoseFlag(0)


def levels(points, rig, flags=NO_FLAG, assumptions=ROUND, risk=1e-5):
    result = pose_result(points, rig, assumptions=assumptions)
    return protection_of(result.separation(), result.pose, risk, result.flags | flags)


def shifted(points, laser, edge, shift_px):
    """A break point moved along its stripe."""
    position = points.position_px.copy()
    position[laser, edge, 0] += shift_px
    return replace(points, position_px=position)


@pytest.fixture
def scene():
    return make_scene("B", distance_m=0.5, tilt_rad=(0.15, -0.1))


@pytest.fixture
def points(scene, rng):
    return face_points_of(scene, 0.3, 0.02, rng)


# Eq. (15.3)


@pytest.mark.parametrize("allowed", [1e-2, 1e-4, 9e-6])
def test_the_level_of_one_solution_is_the_quantile_of_a_normal_distribution(allowed):
    level = protection_level(np.ones(1), np.zeros(1), np.array([2.0]), allowed)

    assert level == pytest.approx(2.0 * norm.isf(allowed / 2), rel=1e-5)


def test_an_error_of_the_mixture_exceeds_the_level_as_often_as_allowed(rng):
    weight, difference, sigma = rng.dirichlet(np.ones(5)), rng.normal(0.0, 3.0, 5), rng.uniform(0.5, 2.0, 5)
    difference[0] = 0.0

    def exceeded(level):
        tails = norm.sf((level - np.abs(difference)) / sigma) + norm.sf((level + np.abs(difference)) / sigma)
        return weight @ tails

    level = protection_level(weight, difference, sigma, 1e-4)

    assert level == pytest.approx(brentq(lambda level: exceeded(level) - 1e-4, 0.0, 100.0), rel=1e-5)


def test_no_level_holds_for_a_risk_below_what_no_hypothesis_covers(scene, points):
    found = levels(points, scene.rig, risk=UNCOVERED_PROBABILITY)

    assert (found.grasp_normal_m, found.normal_rad) == (inf, inf)
    assert np.isinf(found.center_m).all()


def test_a_smaller_risk_has_a_larger_level(scene, points):
    small, large = levels(points, scene.rig, risk=1e-5), levels(points, scene.rig, risk=1e-3)

    assert small.grasp_normal_m > large.grasp_normal_m
    assert small.normal_rad > large.normal_rad
    assert (small.center_m > large.center_m).all()


# The solutions under the hypotheses


@pytest.mark.parametrize("end", range(6))
def test_a_linear_step_gives_the_solution_without_an_end(scene, points, end):
    """The break point's own variance raised by that of a wrong end, and the ring estimated anew."""
    laser, edge = divmod(end, 2)
    measured, prior = measurements_of(points, scene.rig), Prior(assumptions=Assumptions(ring_tolerance_m=1e-4))
    best = explain(measured, prior, labelled=True, edges_named=True)
    values = quantities(best.estimate)
    covariance_px2 = points.covariance_px2.copy()
    covariance_px2[laser, edge, 0, 0] += END_SD_PX**2
    doubted = measurements_of(replace(points, covariance_px2=covariance_px2), scene.rig)
    other = estimate_ring(doubted, prior)
    others = quantities(other)

    separation = solution_separation(best, values)

    row = separation.names.index(f"end {4 * laser + edge}")
    change = difference_from(other, others, best.estimate, values)
    covariance = joint_covariance(other, others)
    across = np.array([values.normal, values.outward])
    expected = [*(across @ covariance[GRASP, GRASP] @ across.T).diagonal(), *covariance[CENTER, CENTER].diagonal()]
    own = np.sqrt(expected)
    found = separation.covariance[row].diagonal()[[0, 1, 4, 5, 6]]
    assert np.abs(separation.difference[row, 4:7] - change[CENTER]) == pytest.approx(
        np.zeros(3), abs=0.3 * own[2:].max()
    )
    assert np.sqrt(found) == pytest.approx(own, rel=0.25)


def test_hypotheses_have_probabilities_that_add_up_to_one(scene, points):
    best = explain(measurements_of(points, scene.rig), Prior(), labelled=True, edges_named=True)

    separation = solution_separation(best, quantities(best.estimate))

    assert separation.weight.sum() == pytest.approx(1.0)
    assert separation.names[0] == ""
    assert separation.weight[0] > 0.9
    assert not separation.difference[0].any()


# What a line reports


def test_a_single_shot_of_a_moving_ring_shows_in_its_level_how_far_its_centre_may_be_off(scene):
    timed = replace(face_points_of(scene, 0.1, 0.01), stamp_s=STAMPS_S)
    moving = Assumptions(ring_tolerance_m=1e-4, motion=motion_prior())

    still, unknown = levels(timed, scene.rig), levels(timed, scene.rig, assumptions=moving)

    assert unknown.center_m.max() > max(0.1, still.center_m.max())
    assert unknown.grasp_normal_m > still.grasp_normal_m


def test_two_stripes_show_that_one_of_them_may_be_on_another_surface(scene, points):
    three, two = levels(points, scene.rig), levels(with_stripes(points, 0, 1), scene.rig)

    assert two.grasp_normal_m > 5 * three.grasp_normal_m
    assert three.grasp_normal_m < 0.005


@pytest.mark.parametrize(
    ("flag", "without"),
    [
        (PoseFlag.INCONSISTENT, {"grasp", "normal", "center"}),
        (PoseFlag.ASSIGNMENT_AMBIGUOUS, {"grasp", "normal", "center"}),
        (PoseFlag.SIDE_UNKNOWN, {"center"}),
        (PoseFlag.NORMAL_WEAK, {"normal", "center"}),
        (PoseFlag.CENTER_WEAK, set()),
        (PoseFlag.RADIUS_UNVERIFIED, set()),
    ],
)
def test_what_a_flag_forbids_has_no_level_unless_a_level_describes_it(scene, flag, without):
    found = levels(face_points_of(scene, 0.1, 0.01), scene.rig, flag)

    known = {"grasp": found.grasp_radial_m, "normal": found.normal_rad, "center": found.center_m.max()}
    assert {name for name, level in known.items() if level == inf} == without


@pytest.mark.parametrize("shift_px", [1.5, 3.0, 6.0, 20.0])
def test_the_levels_cover_a_displaced_end_whether_it_shows_or_not(scene, points, shift_px):
    for laser in range(3):
        for edge in range(2):
            line = pose_line(detection_of(shifted(points, laser, edge, shift_px)), scene.rig, options=USUAL)
            if line.protection is None:
                continue
            error_m = line.pose.center_m - scene.ring.center_m
            normal = scene.ring.normal
            assert not (np.abs(error_m) > line.protection.center_m).any()
            assert not angle_between(line.pose.normal[None], normal[None])[0] > line.protection.normal_rad
            height_m = abs(float((line.pose.grasp_m - scene.ring.center_m) @ normal))
            assert not height_m > line.protection.grasp_normal_m


# A rig in doubt, Eq. (15.4)


def sigmas_off(pose, ring) -> float:
    """The larger Mahalanobis distance of normal and centre from the truth."""
    of_normal = mahalanobis_squared(tilt_error_rad(pose.normal, ring.normal), pose.covariance[:2, :2])
    return max(of_normal, mahalanobis_squared(pose.center_m - ring.center_m, pose.covariance_center_m2)) ** 0.5


def first_shots(rig, rng, turn_rad, count):
    """Distances from the truth of `ok` shots after a light plane has turned: as estimated, and as reported."""
    for number in range(count):
        direction = rng.uniform(0.0, 2.0 * np.pi)
        tilts = turn_rad * np.array([np.cos(direction), np.sin(direction)])
        ((seen, points),) = poses_before(moved(within_stability(rig, rng), number % 3, tilts), rng, 1)
        line = pose_line(replace(detection_of(points), still=True), rig)
        if line.status == "ok":
            estimated = pose_result(points, rig, assumptions=ASSUMED).pose
            yield sigmas_off(estimated, seen.ring), sigmas_off(line.pose, seen.ring)


def test_a_turned_plane_that_does_not_show_is_within_the_covariance_of_a_first_shot(scene, rng):
    estimated, reported = zip(*first_shots(scene.rig, rng, 1.5e-3, 36), strict=True)

    assert max(estimated) > WRONG_SIGMAS
    assert max(reported) < WRONG_SIGMAS


def test_a_rig_that_has_not_changed_is_hardly_in_doubt(scene, rng):
    estimated, reported = zip(*first_shots(scene.rig, rng, 0.0, 24), strict=True)

    assert len(reported) == 24
    ratio = np.array(estimated) / reported
    assert np.median(ratio) == pytest.approx(1.01, abs=0.02)


def moved_plane_separation(weight):
    """The accepted solution, one in which a plane has moved, and one with a wrong end."""
    covariance = np.stack([np.eye(8), np.eye(8), np.eye(8)])
    covariance[1, 0, 0] = 4.0
    return Separation(
        faults=("plane 0", "end 0"),
        sets=((), (0,), (1,)),
        weight=np.array(weight),
        difference=np.array([np.zeros(8), 3.0 * np.eye(8)[0], np.full(8, 30.0)]),
        covariance=covariance,
        across=np.eye(3)[:2],
        radius_m=1.0,
    )


def test_an_error_of_five_raised_standard_deviations_is_as_rare_as_that_of_a_gaussian(scene, points):
    pose = pose_result(points, scene.rig, assumptions=ROUND).pose

    # what is no plane does not count
    limit = WRONG_SIGMAS * overbound(moved_plane_separation([0.5, 0.001, 0.499]), pose)

    tails = norm.sf(limit) + norm.sf(limit), norm.sf((limit - 3.0) / 2.0) + norm.sf((limit + 3.0) / 2.0)
    assert np.dot([0.5, 0.001], tails) / 0.501 == pytest.approx(2.0 * norm.sf(WRONG_SIGMAS), rel=1e-4)


def test_the_factor_is_finite_where_the_accepted_solution_has_no_weight_any_more(scene, points):
    pose = pose_result(points, scene.rig, assumptions=ROUND).pose

    limit = WRONG_SIGMAS * overbound(moved_plane_separation([0.0, 1.0, 0.0]), pose)

    assert norm.sf((limit - 3.0) / 2.0) == pytest.approx(2.0 * norm.sf(WRONG_SIGMAS), rel=1e-3)
    assert np.isfinite(overbound(moved_plane_separation([0.0, 0.0, 1.0]), pose))


@pytest.mark.parametrize("case", ["exact rig", "two stripes"])
def test_a_rig_that_counts_as_exact_or_is_not_checked_is_not_in_doubt(scene, points, case):
    options = AssumptionOptions(rig_stability=0.0 if case == "exact rig" else 1.0)
    seen = points if case == "exact rig" else with_stripes(points, 0, 1)
    stability = options.about_shot(scene.rig.stability, still=True).stability

    line = pose_line(replace(detection_of(seen), still=True), scene.rig, options=options)

    pose = pose_result(seen, scene.rig, assumptions=replace(ROUND, stability=stability)).pose
    assert line.pose.covariance[:3, :3] == pytest.approx(pose.covariance[:3, :3], rel=1e-6)
