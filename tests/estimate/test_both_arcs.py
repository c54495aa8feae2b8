"""Rings of which both arcs are in view: what the opposite arc adds, and what is rejected there."""

from dataclasses import replace

import numpy as np
import pytest
from calibrated import assert_calibrated
from ring_scenes import RIGS, Ring, face_points_of, scene_of, without

from ringpose.measure.stream import pose_result
from ringpose.types.pose import KnownRadii, PoseFlag, PoseResult, RingPose

SIGMA_PX, LINE_PX = 0.3, 0.05
"""Errors of the ends and of the lines of MATH section 15's example."""

RADIUS_M = np.array([0.13, 0.15])


def whole_ring(center_m=(0.01, -0.038, 0.5), tilt=(0.12, -0.08)):
    """A ring wholly in view of rig B, which all stripes cross twice."""
    normal = np.array([tilt[0], tilt[1], -1.0])
    return Ring(center_m=np.array(center_m), normal=normal / np.linalg.norm(normal), radius_m=RADIUS_M)


def seen_on_both_arcs(ring, rng=None, beyond=None):
    """Break points on the left arc, with those of `beyond` (or the ring) on the opposite one."""
    rig = RIGS["B"]
    left = scene_of(rig, ring, ring.crossings_m(rig.lasers)[:, :, 0])
    right = scene_of(rig, ring, (beyond or ring).crossings_m(rig.lasers)[:, :, 1])
    points, opposite = (face_points_of(scene, SIGMA_PX, LINE_PX, rng) for scene in (left, right))
    return replace(points, opposite=opposite)


def pose_of(points) -> tuple[PoseResult, RingPose]:
    result = pose_result(points, RIGS["B"])
    assert isinstance(result.pose, RingPose), result.pose
    return result, result.pose


def center_sd_m(pose):
    return np.sqrt(np.diag(pose.covariance_center_m2))


def test_exact_ends_on_both_arcs_give_the_ring_and_a_grasp_point_on_the_first():
    ring = whole_ring()

    _, pose = pose_of(seen_on_both_arcs(ring))

    np.testing.assert_allclose(pose.center_m, ring.center_m, atol=1e-8)
    np.testing.assert_allclose(pose.normal, ring.normal, atol=1e-7)
    np.testing.assert_allclose([pose.radius_inner_m, pose.radius_outer_m], RADIUS_M, atol=1e-8)
    from_center_m = pose.grasp_m - ring.center_m
    assert from_center_m[0] < -0.1
    np.testing.assert_allclose(np.linalg.norm(from_center_m), RADIUS_M.mean(), atol=1e-7)


def test_the_opposite_arc_makes_centre_and_radius_several_times_more_certain():
    points = seen_on_both_arcs(whole_ring())

    _, both = pose_of(points)
    _, one = pose_of(replace(points, opposite=None))

    assert center_sd_m(one).max() > 5.0 * center_sd_m(both).max()
    assert one.covariance[6, 6] > 25.0 * both.covariance[6, 6]
    assert center_sd_m(both).max() < 0.1e-3  # 0.04 mm in the example


def test_errors_of_rings_seen_on_both_arcs_are_as_stated():
    rng, ring, squares = np.random.default_rng(1), whole_ring(), []
    for _ in range(60):
        _, pose = pose_of(seen_on_both_arcs(ring, rng))
        error = pose.center_m - ring.center_m
        squares.append(error @ np.linalg.solve(pose.covariance_center_m2, error) / 3)

    assert_calibrated(squares, 3)


def test_either_arc_may_be_the_first():
    points = seen_on_both_arcs(whole_ring(), np.random.default_rng(2))

    _, left = pose_of(points)
    _, right = pose_of(points.arcs_exchanged())

    np.testing.assert_allclose(left.center_m, right.center_m, atol=1e-3 * center_sd_m(left).min())
    np.testing.assert_allclose(left.covariance_center_m2, right.covariance_center_m2, rtol=1e-3)
    assert left.grasp_m[0] < whole_ring().center_m[0] < right.grasp_m[0]


def test_a_displaced_end_on_the_opposite_arc_is_rejected_and_named():
    ring = whole_ring()
    points = seen_on_both_arcs(ring, np.random.default_rng(3))
    displaced = points.opposite.position_px.copy()
    displaced[1, 1, 0] += 30.0

    result, pose = pose_of(replace(points, opposite=replace(points.opposite, position_px=displaced)))

    (rejection,) = result.rejected
    assert (rejection.what, rejection.laser, rejection.edge, rejection.opposite) == ("point", "middle", "outer", True)
    assert (np.abs(pose.center_m - ring.center_m) < 5.0 * center_sd_m(pose)).all()


def test_stripes_beyond_the_ring_on_another_surface_are_rejected_together():
    ring = whole_ring()
    nearer = replace(ring, center_m=ring.center_m - [0.0, 0.0, 0.01])

    result, pose = pose_of(seen_on_both_arcs(ring, np.random.default_rng(4), beyond=nearer))

    assert {each.laser for each in result.rejected} == {"left", "middle", "right"}
    assert all(each.opposite and each.what == "stripe" for each in result.rejected)
    assert (np.abs(pose.center_m - ring.center_m) < 5.0 * center_sd_m(pose)).all()
    assert not np.isnan(pose.grasp_m).any()


def test_a_stripe_beside_the_hole_has_an_outer_end_on_each_arc():
    ring = whole_ring()
    points = seen_on_both_arcs(ring, np.random.default_rng(5))
    beside, nothing = without(points, (0, 0)), np.full((3, 2), np.nan)
    opposite = without(points.opposite, (0, 0))
    line = np.where(np.arange(3)[:, None] == 0, np.nan, opposite.face_start_undistorted_px)
    end = np.where(np.arange(3)[:, None] == 0, np.nan, opposite.face_end_undistorted_px)
    sigma = np.where(np.arange(3)[:, None] == 0, nothing, opposite.face_sigma_px)
    opposite = replace(opposite, face_start_undistorted_px=line, face_end_undistorted_px=end, face_sigma_px=sigma)

    result, pose = pose_of(replace(beside, opposite=opposite))

    assert not result.rejected
    assert (np.abs(pose.center_m - ring.center_m) < 5.0 * center_sd_m(pose)).all()


@pytest.mark.parametrize("laser", [0, 2])
def test_two_stripes_on_both_arcs_show_one_ring(laser):
    ring = whole_ring()
    points = seen_on_both_arcs(ring, np.random.default_rng(6))
    missing = np.arange(3) == laser
    ends = np.repeat(missing[:, None], 2, axis=1)

    result, pose = pose_of(
        replace(points.without(ends, missing), opposite=points.opposite.without(ends, missing)),
    )

    assert not result.rejected
    assert (np.abs(pose.center_m - ring.center_m) < 5.0 * center_sd_m(pose)).all()


def one_stripe(points):
    """The stripe of the left laser alone, which passes 90 mm beside the centre."""
    others = np.arange(3) != 0
    ends = np.repeat(others[:, None], 2, axis=1)
    return replace(points.without(ends, others), opposite=points.opposite.without(ends, others))


def radii(radius_m):
    return KnownRadii(radius_m=radius_m, sd_m=np.full(2, 1e-4))


def test_one_stripe_on_both_arcs_does_not_contradict_the_true_radii():
    points = seen_on_both_arcs(whole_ring(), np.random.default_rng(7))

    result = pose_result(one_stripe(points), RIGS["B"], known=radii(RADIUS_M))
    contradicted = pose_result(points, RIGS["B"], known=radii(0.7 * RADIUS_M))

    assert PoseFlag.RADIUS_INCONSISTENT not in result.flags  # its ends show the radii only if it passed the centre
    assert PoseFlag.RADIUS_INCONSISTENT in contradicted.flags


def test_one_stripe_on_both_arcs_shows_a_ring_whose_radii_are_given():
    rng, ring, weak = np.random.default_rng(8), whole_ring(), 0
    for _ in range(20):
        points = one_stripe(seen_on_both_arcs(ring, rng))
        result = pose_result(points, RIGS["B"], known=radii(RADIUS_M))
        weak += PoseFlag.GRASP_WEAK in result.flags
        from_center_m = result.pose.grasp_m - ring.center_m
        outward = from_center_m / np.linalg.norm(from_center_m)
        sd_m = np.sqrt(outward @ result.pose.covariance_grasp_m2 @ outward)
        assert sd_m < 2e-3
        assert abs(from_center_m @ outward - RADIUS_M.mean()) < 5.0 * sd_m  # whichever side of the stripe it is on
        assert abs(from_center_m @ ring.normal) < 1e-3
        assert {PoseFlag.NORMAL_WEAK, PoseFlag.CENTER_WEAK, PoseFlag.RADIUS_WEAK} <= set(result.flags)

        # without radii these may be the ends on two bars of equal width
        assert PoseFlag.GRASP_WEAK in pose_result(points, RIGS["B"]).flags
    assert weak <= 2


def with_moved_end(points):
    moved = points.opposite.position_px.copy()
    moved[0, 1, 0] += 12.0
    return replace(points, opposite=replace(points.opposite, position_px=moved))


@pytest.mark.parametrize(
    ("changed", "scale"),
    [(with_moved_end, 1.0), (lambda points: points, 0.9), (lambda points: replace(points, opposite=None), 1.0)],
    ids=["end elsewhere", "other ring", "one arc"],
)
def test_ends_of_one_stripe_that_do_not_fit_the_given_radii_leave_its_grasp_point_weak(changed, scale):
    points = changed(one_stripe(seen_on_both_arcs(whole_ring(), np.random.default_rng(9))))

    result = pose_result(points, RIGS["B"], known=radii(scale * RADIUS_M))

    assert PoseFlag.GRASP_WEAK in result.flags
