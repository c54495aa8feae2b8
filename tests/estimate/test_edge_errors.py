"""Errors of neighbours on a visible edge are correlated over a length, and are nuisance parameters."""

from dataclasses import replace

import numpy as np
import pytest
from calibrated import DRAWS, assert_calibrated
from ring_scenes import face_points_of, make_scene, visible_edges_of, with_stripes

from ringpose.estimate.factors.edges import CORRELATION_LENGTH_PX, common_errors_px, karhunen_loeve_terms
from ringpose.measure.stream import estimate_pose
from ringpose.types.pose import HARMLESS_FLAGS, PoseFlag

ALONG_PX = np.linspace(-300.0, 900.0, 101)


@pytest.mark.parametrize("length_px", [10.0, 50.0, 400.0])
def test_errors_of_an_edge_are_those_of_a_series_that_is_alike_over_a_length(length_px):
    along_px = np.linspace(0.0, length_px, 41)

    found = karhunen_loeve_terms(along_px)

    alike = np.exp(-np.abs(along_px[:, None] - along_px) / CORRELATION_LENGTH_PX)
    np.testing.assert_allclose(found @ found.T, alike, rtol=0, atol=0.15)


def test_means_over_a_long_edge_err_as_those_of_such_a_series():
    found = karhunen_loeve_terms(ALONG_PX).mean(axis=0)

    alike = np.exp(-np.abs(ALONG_PX[:, None] - ALONG_PX) / CORRELATION_LENGTH_PX)
    assert found @ found == pytest.approx(alike.mean(), rel=0.02)


def test_edges_err_independently_of_each_other():
    edges = visible_edges_of(make_scene("B", distance_m=0.5), 100, 0.3)

    errors = common_errors_px(edges)

    together = errors @ errors.T
    assert np.abs(together[:50, 50:]).max() == 0.0
    assert together[:50, :50].min() > 0.0


def test_an_edge_errs_differently_in_two_frames():
    edges = visible_edges_of(make_scene("B", distance_m=0.5), 100, 0.3)
    twice = replace(edges, stamp_s=np.repeat([0.0, 0.1, 0.0, 0.1], 25))

    differences = common_errors_px(twice)[:25] - common_errors_px(twice)[25:50]

    assert (differences**2).sum(axis=1).min() > 2 * 0.02**2


def test_an_edge_that_bends_alike_spoils_no_shot():
    scene = make_scene("B", distance_m=0.5)
    edges = visible_edges_of(scene, 200, 0.1)
    bend_px = 0.15 * np.tile(np.cos(np.linspace(0.0, 4.0 * np.pi, 100)), 2)
    bent = replace(edges, position_px=edges.position_px + bend_px[:, None] * edges.normal)

    pose = estimate_pose(face_points_of(scene, 0.3, 0.01), scene.rig, ring_edges=bent)

    assert pose.flags & ~HARMLESS_FLAGS == PoseFlag(0)
    error_m = pose.center_m - scene.ring.center_m
    assert error_m @ np.linalg.solve(pose.covariance_center_m2, error_m) < 3.0


@DRAWS
def test_poses_from_edges_that_err_alike_scatter_as_told(rng, draws):
    scene = make_scene("B", distance_m=0.5)
    edges = visible_edges_of(scene, 120, 0.2)
    along_px = edges.position_px[:60, 1]
    alike = 0.16 * np.exp(-np.abs(along_px[:, None] - along_px) / CORRELATION_LENGTH_PX) + 0.84 * np.eye(60)
    root = 0.2 * np.linalg.cholesky(alike)
    squares = []
    for _ in range(draws):
        off_px = np.concatenate([root @ rng.normal(size=60), root @ rng.normal(size=60)])
        noisy = replace(edges, position_px=edges.position_px + off_px[:, None] * edges.normal)
        pose = estimate_pose(face_points_of(scene, 0.3, 0.01, rng), scene.rig, ring_edges=noisy)
        error_m = pose.center_m - scene.ring.center_m
        squares.append(error_m @ np.linalg.solve(pose.covariance_center_m2, error_m) / 3.0)

    assert_calibrated(squares, 3, at_most=True)


def test_one_stripe_and_a_visible_edge_tell_the_normal_as_well_as_they_say(rng):
    sigmas = []
    for _ in range(30):
        tilt_rad = tuple(rng.uniform(-0.2, 0.2, 2).tolist())
        scene = make_scene("B", distance_m=0.25, tilt_rad=tilt_rad)
        points = with_stripes(face_points_of(scene, 0.3, 0.01, rng), 1)
        both = visible_edges_of(scene, 44, 0.3, rng)
        outer = {name: getattr(both, name)[both.edge == 1] for name in ("position_px", "normal", "sigma_px", "edge")}
        pose = estimate_pose(points, scene.rig, ring_edges=replace(both, **outer))
        apart = np.linalg.norm(np.cross(pose.normal, scene.ring.normal))
        sigmas.append(apart / np.sqrt(np.trace(pose.covariance[:2, :2])))

    assert max(sigmas) < 4.0
