"""Method `ml`: exact without noise, efficient and consistent with it, for complete and partial data."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ring_scenes import face_points_of, make_scene, visible_edges_of, with_stripes, without

from ringpose.measure.stream import estimate_pose, pose_result
from ringpose.types.pose import KnownRadii, NoPose, PoseFlag

KNOWN = KnownRadii(radius_m=np.array([0.567, 0.597]), sd_m=np.array([1e-4, 1e-4]))
POINT_PX, LINE_PX = 0.3, 0.01
"""Of a break point, and of the middle of a stripe's line: 0.1 px a column, a hundred independent columns."""


def without_line(points, laser):
    """Without a stripe's line."""
    start, end = points.face_start_undistorted_px.copy(), points.face_end_undistorted_px.copy()
    start[laser], end[laser] = np.nan, np.nan
    return replace(points, face_start_undistorted_px=start, face_end_undistorted_px=end)


@given(
    distance_m=st.floats(0.25, 1.0),
    tilt=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)),
    turn_rad=st.floats(-0.3, 0.3),
    side=st.sampled_from([-1, 1]),
    size=st.sampled_from(["R597", "R1194"]),
)
def test_true_stripes_and_points_give_the_true_ring(distance_m, tilt, turn_rad, side, size):
    scene = make_scene("B", distance_m=distance_m, tilt_rad=tilt, turn_rad=turn_rad, side=side, size=size)

    pose = estimate_pose(face_points_of(scene, 1e-3, 1e-4), scene.rig)

    found = np.concatenate([pose.center_m, pose.normal, [pose.radius_inner_m, pose.radius_outer_m]])
    true = np.concatenate([scene.ring.center_m, scene.ring.normal, scene.ring.radius_m])
    np.testing.assert_allclose(found, true, rtol=0, atol=1e-8)
    outward = pose.grasp_m - scene.ring.center_m
    on_band = [np.linalg.norm(outward), outward @ scene.ring.normal]
    np.testing.assert_allclose(on_band, [scene.ring.radius_m.mean(), 0.0], rtol=0, atol=1e-9)


@pytest.mark.parametrize("missing", [[], [(0, 0)], [(0, 0), (1, 1)], [(0, 0), (1, 0), (2, 0)]], ids=len)
def test_break_points_alone_give_the_true_center(missing):
    scene = make_scene("B", distance_m=0.5)

    pose = estimate_pose(without(scene.break_points(1e-3), *missing), scene.rig)

    np.testing.assert_allclose(pose.center_m, scene.ring.center_m, rtol=0, atol=1e-8)


def test_without_one_edge_the_other_radius_and_the_grasp_point_are_not_known():
    scene = make_scene("B", distance_m=0.5)

    pose = estimate_pose(without(face_points_of(scene, 0.01, 0.001), (0, 0), (1, 0), (2, 0)), scene.rig)

    assert (np.isnan(pose.radius_inner_m), np.isnan(pose.radius_outer_m)) == (True, False)
    assert np.isnan(pose.grasp_m).all()


def test_two_stripes_give_the_normal_and_with_the_radius_the_center():
    scene = make_scene("B", distance_m=0.25)
    points = with_stripes(face_points_of(scene, POINT_PX, LINE_PX), 0, 1)

    alone, known = (estimate_pose(points, scene.rig, known=known) for known in (None, KNOWN))

    assert np.linalg.norm(alone.normal - scene.ring.normal) < 1e-6
    assert PoseFlag.CENTER_WEAK in alone.flags
    np.testing.assert_allclose(known.center_m, scene.ring.center_m, rtol=0, atol=1e-8)


def test_one_stripe_gives_a_grasp_point_without_a_normal():
    scene = make_scene("B", distance_m=0.25)
    points = with_stripes(face_points_of(scene, POINT_PX, LINE_PX), 1)

    pose = estimate_pose(points, scene.rig)

    offset = pose.grasp_m - scene.points_m[1].mean(axis=0)
    assert np.linalg.norm(offset) < 0.5e-3
    assert np.isnan(pose.normal).all()
    assert PoseFlag.NORMAL_WEAK in pose.flags


def test_no_break_point_is_a_reason():
    scene = make_scene("B")
    every = [(laser, edge) for laser in range(3) for edge in range(2)]

    assert estimate_pose(without(face_points_of(scene, 0.3, 0.01), *every), scene.rig) is NoPose.TOO_FEW_BREAK_POINTS


@pytest.mark.parametrize("wrong", [0.97, 0.98, 1.02, 1.03])
@pytest.mark.parametrize("distance_m", [0.3, 0.5, 1.0])
def test_a_radius_that_is_wrong_by_more_than_one_percent_is_named(distance_m, wrong):
    scene = make_scene("B", distance_m=distance_m)
    points = face_points_of(scene, POINT_PX / 3, LINE_PX / 3)
    known = KnownRadii(radius_m=wrong * KNOWN.radius_m, sd_m=KNOWN.sd_m)

    pose = estimate_pose(points, scene.rig, known=known)

    assert pose.flags & (PoseFlag.RADIUS_INCONSISTENT | PoseFlag.RADIUS_UNVERIFIED)


def test_visible_edges_make_the_center_far_better_known_and_leave_it_true():
    scene = make_scene("B", distance_m=0.5)
    points = face_points_of(scene, POINT_PX, LINE_PX)

    poses = [estimate_pose(points, scene.rig, ring_edges=edges) for edges in (None, visible_edges_of(scene, 200, 0.3))]

    spread = [np.sqrt(np.trace(pose.covariance_center_m2)) for pose in poses]
    assert spread[0] > 3 * spread[1]
    np.testing.assert_allclose(poses[1].center_m, scene.ring.center_m, rtol=0, atol=1e-7)


def poses_of_samples(scene, known, rng, samples):
    """Of noisy shots; one in a thousand looks contradictory by chance, and is left out."""
    shots = [face_points_of(scene, POINT_PX, LINE_PX, rng) for _ in range(samples)]
    poses = [estimate_pose(points, scene.rig, known=known) for points in shots]
    complete = [pose for pose in poses if not isinstance(pose, NoPose) and PoseFlag.POINT_REJECTED not in pose.flags]
    complete = [pose for pose in complete if np.isfinite(pose.center_m).all()]
    assert len(complete) >= samples - max(1, samples // 300)
    return complete


@pytest.mark.parametrize(
    ("distance_m", "known", "samples"),
    [
        pytest.param(0.5, None, 150, id="some shots", marks=pytest.mark.slow),
        pytest.param(0.3, KNOWN, 2000, id="radii known", marks=pytest.mark.slow),
        pytest.param(1.0, None, 2000, id="radii unknown", marks=pytest.mark.slow),
    ],
)
def test_samples_scatter_as_the_covariance_says(rng, distance_m, known, samples):
    scene = make_scene("B", distance_m=distance_m)
    predicted = estimate_pose(face_points_of(scene, POINT_PX, LINE_PX), scene.rig, known=known)

    poses = poses_of_samples(scene, known, rng, samples)

    values = np.array([pose.grasp_m for pose in poses])
    root = np.linalg.cholesky(predicted.covariance_grasp_m2)
    white = np.linalg.solve(root, np.cov(values.T)) @ np.linalg.inv(root).T
    assert np.abs(np.linalg.eigvalsh(white) - 1).max() < 4 * np.sqrt(2 / (samples - 1))


def test_edges_that_contradict_a_shot_without_redundancy_are_flagged():
    """Shots with as many numbers of stripes and ends as a ring has parameters."""
    scene = make_scene("B", distance_m=0.5)
    for seed in (21, 96):
        rng = np.random.default_rng(seed)
        points = face_points_of(scene, 0.3, 0.03, rng)
        points = without(points, *zip(*np.nonzero(rng.random((3, 2)) < 0.5), strict=True))
        for laser in np.flatnonzero(rng.random(3) < 0.5):
            points = without_line(points, laser)
        edges = visible_edges_of(scene, int(rng.choice([4, 6, 20])), 0.3, rng)
        displaced_px = rng.normal(0, rng.choice([1, 5, 20]), len(edges.edge))[:, None] * edges.normal

        result = pose_result(points, scene.rig, ring_edges=replace(edges, position_px=edges.position_px + displaced_px))

        assert PoseFlag.INCONSISTENT in result.flags
