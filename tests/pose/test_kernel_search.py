"""The kernel's search begins and ends where the steps of `likelihood` do."""

from dataclasses import replace

import numpy as np
import pytest

from ringpose.kernels import _search
from ringpose.kernels.ring_search import Sought, started
from ringpose.pose.likelihood import Task, kernel_search, search_in_steps
from ringpose.pose.measurements import measurements_of
from ringpose.pose.pipeline import estimate_pose
from ringpose.pose.residual_rows import Beforehand
from ringpose.pose.rig_errors import rig_errors
from ringpose.pose.starting_state import starting_state, state_with_points_alone
from ringpose.types.covariance import ParameterCovariance
from ringpose.types.ring import KnownRadii
from ringpose.types.ring_pose import NoPose, RingPose

INNER_ONLY = KnownRadii(radius_m=np.array([0.567, np.nan]), sd_m=np.full(2, 1e-4))
BOTH = KnownRadii(radius_m=np.array([0.567, 0.597]), sd_m=np.full(2, 1e-4))
PARAMETERS = ("fx", "fy", "cx", "cy", "left.tilt_1", "middle.distance", "right.tilt_2")
SD = np.array([0.3, 0.3, 0.2, 0.2, 2e-4, 5e-5, 2e-4])


def with_covariance(rig):
    return replace(rig, covariance=ParameterCovariance(parameters=PARAMETERS, data=np.diag(SD**2)))


@pytest.fixture(params=[False, True], ids=["no edges", "visible edges"])
def noisy(scene_of, face_points, visible_edges, rng, request):
    """Measurements of a noisy shot with wrong ends, which robust weights count less."""
    scene = scene_of("B", distance_m=0.5)
    points = face_points(scene, 0.3, 0.01, rng)
    points.position_px[:, 0, 0] += 10.0, -15.0, 25.0
    edges = visible_edges(scene, 60, 0.3, rng) if request.param else None
    return scene.rig, measurements_of(points, scene.rig, edges)


@pytest.mark.parametrize("calibrated", [False, True], ids=["rig exact", "rig with its covariance"])
@pytest.mark.parametrize("radii", [None, INNER_ONLY, BOTH], ids=["radii unknown", "one radius", "both radii"])
def test_both_searches_end_at_the_same_ring(noisy, calibrated, radii):
    rig, measured = noisy
    rig = with_covariance(rig) if calibrated else rig
    sighted, before, errors = measured.sighted(rig.lasers), Beforehand(radii), rig_errors(rig)
    start = starting_state(measured, sighted, before)

    fits = [search(start, Task(measured, sighted, rig, errors), before) for search in (kernel_search, search_in_steps)]

    for name in ("residual", "weight", "normal_matrix", "inverse"):
        found, twin = (getattr(fit, name) for fit in fits)
        np.testing.assert_allclose(found, twin, rtol=1e-6, atol=1e-7 * np.abs(twin).max())
    np.testing.assert_allclose(fits[0].state.numbers, fits[1].state.numbers, rtol=1e-9, atol=1e-12)
    assert fits[0].weight.min() < 1.0
    assert (fits[0].rig_step is None) == (not calibrated and not len(measured.edges.edge))


def test_both_begin_at_the_same_ring(noisy):
    rig, measured = noisy
    sighted = measured.sighted(rig.lasers)

    found, twin = (start(measured, sighted, Beforehand()) for start in (starting_state, state_with_points_alone))

    np.testing.assert_allclose(found.numbers, twin.numbers, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("side", [-1, 1])
def test_both_turn_the_same_way_out_where_ends_are_in_the_middle(scene_of, face_points, side):
    scene = scene_of("B", distance_m=0.5, side=side)
    measured = measurements_of(face_points(scene, 0.3, 0.01), scene.rig)
    measured = replace(measured, points=replace(measured.points, x=measured.points.middle_x.copy()))
    sighted = measured.sighted(scene.rig.lasers)

    found, twin = (start(measured, sighted, Beforehand()) for start in (starting_state, state_with_points_alone))

    np.testing.assert_allclose(found.numbers, twin.numbers, rtol=1e-9, atol=1e-12)


def test_a_plane_behind_the_camera_is_no_start(noisy):
    rig, measured = noisy
    sighted = measured.sighted(rig.lasers)
    light = sighted.light * [1.0, 1.0, 1.0, -1.0]

    assert (
        started(sighted.rays, light, sighted.whitening, sighted.edge_sign_and_sigma, measured.points.middle_x) is None
    )


def test_points_at_the_end_of_the_world_are_left_out_or_no_ring(scene_of, face_points):
    scene = scene_of("B", distance_m=0.5)
    points = face_points(scene, 0.3, 0.01)
    points.position_px[0, 0] = 1e7, -1e7

    assert isinstance(estimate_pose(points, scene.rig), RingPose | NoPose)


def test_points_without_lines_that_are_known_impossibly_well_end_the_search_without_a_crash(scene_of, rng):
    scene = scene_of("B", distance_m=0.5)
    position = scene.position_px + 20.0 * rng.normal(size=scene.position_px.shape)
    points = replace(
        scene.break_points(1e-15), position_px=position, covariance_px2=np.tile(1e-30 * np.eye(2), (3, 2, 1, 1))
    )

    assert isinstance(estimate_pose(points, scene.rig), RingPose | NoPose)


@pytest.mark.parametrize("wrong", range(11))
def test_arrays_of_a_search_that_do_not_fit_are_refused(noisy, wrong):
    rig, measured = noisy
    sighted = measured.sighted(rig.lasers)
    sought = Sought(
        rays=sighted.rays,
        light=sighted.light,
        whitening=sighted.whitening,
        points=sighted.edge_sign_and_sigma,
        edge_rays=np.ones((4, 3)),
        edges=np.ones((4, 3)),
        radii=np.full((2, 2), np.nan),
    )
    arrays = [np.ones(9), *sought, np.ones((16, 2)), np.ones(16), np.ones(6)]
    arrays[wrong] = np.ascontiguousarray(arrays[wrong][:-1])

    with pytest.raises(ValueError, match="do not fit"):
        _search.search(*arrays, 0, 2)


@pytest.mark.parametrize("wrong", range(5))
def test_arrays_of_a_start_that_do_not_fit_are_refused(noisy, wrong):
    rig, measured = noisy
    sighted = measured.sighted(rig.lasers)
    arrays = [
        sighted.rays,
        sighted.light,
        sighted.whitening,
        sighted.edge_sign_and_sigma,
        measured.points.middle_x,
    ]
    arrays[wrong] = np.ascontiguousarray(arrays[wrong][:-1])

    with pytest.raises(ValueError, match="do not fit"):
        _search.start(*arrays)
