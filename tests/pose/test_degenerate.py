"""Unsolvable cases give a reason, never an exception or a warning."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ring_scenes import break_points_of, face_points_of, make_scene, pixels_of, with_stripes, without

from ringpose.errors import DataError
from ringpose.measure import stream
from ringpose.pose.closed_form import FORMS
from ringpose.pose.closed_form import closed_form_pose as estimate_pose
from ringpose.types.options import Method
from ringpose.types.pose import KnownRadii, NoPose, PoseFlag, RingPose

BOTH_METHODS = pytest.mark.parametrize("method", list(FORMS))
WITH_AND_WITHOUT_COVARIANCE = pytest.mark.parametrize("sigma_px", [np.nan, 0.3])


@pytest.fixture
def scene():
    return make_scene("B", distance_m=0.5)


def with_lasers(rig, normal, distance_m):
    return replace(rig, lasers=replace(rig.lasers, normal=normal, distance_m=distance_m))


@BOTH_METHODS
@WITH_AND_WITHOUT_COVARIANCE
@pytest.mark.parametrize(
    "missing",
    [
        [(0, 0), (1, 1)],
        [(0, 0), (0, 1)],
        [(0, 0), (0, 1), (1, 0), (1, 1)],
        [(laser, edge) for laser in range(3) for edge in range(2)],
    ],
    ids=["one of each edge", "a laser", "two lasers", "all"],
)
def test_an_edge_seen_by_two_lasers_is_too_few(scene, method, sigma_px, missing):
    break_points = without(scene.break_points(sigma_px), *missing)

    assert estimate_pose(break_points, scene.rig, method) is NoPose.TOO_FEW_BREAK_POINTS


@BOTH_METHODS
@pytest.mark.parametrize("edge", [0, 1])
@pytest.mark.parametrize("seen_of_other", [0, 1, 2])
def test_three_lasers_on_one_edge_give_the_center(scene, method, edge, seen_of_other):
    missing = [(laser, 1 - edge) for laser in range(seen_of_other, 3)]

    pose = estimate_pose(without(scene.break_points(), *missing), scene.rig, method)

    np.testing.assert_allclose(pose.center_m, scene.ring.center_m, rtol=0, atol=1e-10)


@BOTH_METHODS
def test_without_one_edge_its_radius_and_the_middle_of_the_band_are_not_known_and_flagged(scene, method):
    pose = estimate_pose(without(scene.break_points(), (0, 0), (1, 0), (2, 0)), scene.rig, method)

    assert np.isnan(pose.radius_inner_m)
    assert np.isnan(pose.grasp_m).all() == (method is Method.PAPER_CONSTRAINED)
    assert PoseFlag.RADIUS_WEAK in pose.flags


@BOTH_METHODS
@WITH_AND_WITHOUT_COVARIANCE
def test_coincident_lasers_give_points_on_a_line(scene, method, sigma_px):
    same = with_lasers(scene.rig, scene.rig.lasers.normal[[1, 1, 1]], scene.rig.lasers.distance_m[[1, 1, 1]])
    break_points = scene.break_points(sigma_px)
    break_points.position_px[:] = break_points.position_px[1]

    assert estimate_pose(break_points, same, method) is NoPose.COLLINEAR


@BOTH_METHODS
@WITH_AND_WITHOUT_COVARIANCE
def test_a_ring_along_its_light_plane_predicts_no_break_points(scene, rng, method, sigma_px):
    same = with_lasers(scene.rig, scene.rig.lasers.normal[[1, 1, 1]], scene.rig.lasers.distance_m[[1, 1, 1]])
    noisy = scene.break_points(sigma_px)
    noisy.position_px[:] = noisy.position_px[1] + 0.3 * rng.normal(size=(3, 2, 2))

    assert estimate_pose(noisy, same, method) is NoPose.NOT_FINITE


@BOTH_METHODS
def test_a_short_arc_of_one_edge_is_a_line_within_its_errors(method):
    scene = make_scene("A", distance_m=0.2)
    break_points = without(scene.break_points(0.3), (0, 0), (1, 0), (2, 0))

    assert estimate_pose(break_points, scene.rig, method) is NoPose.COLLINEAR


@BOTH_METHODS
def test_parallel_lasers_beside_each_other_are_a_good_rig(method):
    rig = make_scene("B").rig
    parallel = with_lasers(rig, np.tile([0.0, 1.0, 0.0], (3, 1)), np.array([-0.1, -0.05, 0.05]))
    scene = make_scene(parallel, distance_m=0.5)

    pose = estimate_pose(scene.break_points(), parallel, method)

    np.testing.assert_allclose(pose.center_m, scene.ring.center_m, rtol=0, atol=1e-10)


@BOTH_METHODS
@WITH_AND_WITHOUT_COVARIANCE
def test_a_ray_along_its_light_plane_is_not_triangulated(scene, method, sigma_px):
    break_points = scene.break_points(sigma_px)
    along = np.cross(scene.rig.lasers.normal[1], [1.0, 0.0, 0.0])
    break_points.position_px[1, 0] = pixels_of(along * np.sign(along[2]), scene.rig.camera)

    assert estimate_pose(break_points, scene.rig, method) is NoPose.UNTRIANGULATED


@BOTH_METHODS
def test_a_point_behind_the_camera_is_not_triangulated(scene, method):
    swapped = with_lasers(scene.rig, scene.rig.lasers.normal, -scene.rig.lasers.distance_m)

    assert estimate_pose(scene.break_points(), swapped, method) is NoPose.UNTRIANGULATED


@BOTH_METHODS
@WITH_AND_WITHOUT_COVARIANCE
@pytest.mark.parametrize("value", [np.inf, -np.inf, 1e300, (100.0, np.nan)])
def test_a_pixel_that_is_not_finite_is_not_triangulated(scene, method, sigma_px, value):
    break_points = scene.break_points(sigma_px)
    break_points.position_px[2, 1] = value

    assert estimate_pose(break_points, scene.rig, method) is NoPose.UNTRIANGULATED


@BOTH_METHODS
@WITH_AND_WITHOUT_COVARIANCE
def test_a_ring_seen_edge_on_is_a_reason(scene, method, sigma_px):
    # points of one plane through the camera: any points of the light planes on one line in the image
    rays = np.stack([np.linspace(-0.05, 0.05, 6), np.linspace(-0.12, -0.2, 6), np.ones(6)], axis=-1)
    position_px = pixels_of(rays, scene.rig.camera)
    parallel = with_lasers(scene.rig, np.tile([0.0, 1.0, 0.0], (3, 1)), np.array([-0.1, -0.11, -0.12]))

    reason = estimate_pose(break_points_of(position_px.reshape(3, 2, 2), sigma_px), parallel, method)

    assert reason is NoPose.EDGE_ON


@BOTH_METHODS
def test_points_on_a_line_in_space_lie_on_a_line(scene, method):
    start, step = np.array([0.02, 0.0, 0.5]), np.array([0.01, 0.3, 0.1])
    m, d = scene.rig.lasers.normal, scene.rig.lasers.distance_m
    points = start + ((d - m @ start) / (m @ step))[:, None] * step
    both_edges = np.repeat(pixels_of(points, scene.rig.camera)[:, None], 2, axis=1)

    assert estimate_pose(break_points_of(both_edges), scene.rig, method) is NoPose.COLLINEAR


@pytest.mark.parametrize("method", Method)
def test_break_points_of_another_rig_are_bad_data(scene, method):
    one_laser = replace(
        scene.rig.lasers,
        names=("middle",),
        normal=scene.rig.lasers.normal[1:2],
        distance_m=scene.rig.lasers.distance_m[1:2],
        projector_m=scene.rig.lasers.projector_m[1:2],
    )

    with pytest.raises(DataError, match="3 lasers, the rig has 1"):
        stream.estimate_pose(scene.break_points(), replace(scene.rig, lasers=one_laser), method)


@BOTH_METHODS
@WITH_AND_WITHOUT_COVARIANCE
@given(
    pixels=st.lists(
        st.one_of(st.just(float("nan")), st.floats(-50.0, 1700.0), st.sampled_from([0.0, 800.0])),
        min_size=12,
        max_size=12,
    )
)
def test_any_pixels_give_a_finite_pose_or_a_reason(method, sigma_px, pixels):
    rig = make_scene("B").rig

    pose = estimate_pose(break_points_of(np.array(pixels).reshape(3, 2, 2), sigma_px), rig, method)

    assert isinstance(pose, NoPose) or is_finite(pose)


def is_finite(pose: RingPose) -> bool:
    values = [*pose.center_m, *pose.normal, pose.condition_number, pose.residual_rms_px]
    return bool(np.isfinite(values).all())


def test_two_unlabelled_stripes_that_may_be_on_a_straight_bar_have_no_pose_but_may_continue_a_track():
    scene = make_scene("A", distance_m=0.5)
    three = face_points_of(scene, 0.3, 0.05)
    switched = with_stripes(three, 0, 2)
    two = replace(switched, labelled=False)
    radii = KnownRadii(radius_m=scene.ring.radius_m, sd_m=np.full(2, 0.0005))

    alone, *others = (stream.pose_result(points, scene.rig) for points in (two, switched, three))
    known = stream.pose_result(two, scene.rig, known=radii)

    assert alone.pose is NoPose.UNCONFIRMED
    assert alone.measurement is not None
    for other in others:
        assert isinstance(other.pose, RingPose)
        assert {PoseFlag.NORMAL_WEAK, PoseFlag.GRASP_WEAK} <= set(other.flags)
    assert isinstance(known.pose, RingPose)
