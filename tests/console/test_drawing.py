"""The elements of the scene lie where rig and ring are."""

from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest
from known_poses import pose_of
from ring_scenes import PROJECTED, make_camera

from ringpose.console.drawing import (
    PALE,
    Ball,
    Circle,
    Ellipsoid,
    Path,
    bounds,
    bounds_of_target,
    recorded_elements,
    rig_elements,
    rings,
    stripes,
    target_edges,
    target_surfaces,
)
from ringpose.files.scenes.scene import read_scene
from ringpose.geometry.rays import project
from ringpose.simulate.placement import ring_views, target_placement
from ringpose.types.rig import Rig
from ringpose.types.truth import Truth

RIG = Rig(camera=make_camera((800, 600), (889.0, 890.0), (410.0, 290.0)), lasers=PROJECTED)
RING = Truth(
    shot="",
    expect="pose",
    center_m=np.array([0.57, 0.03, 0.5]),
    normal=np.array([0.0, 0.0, -1.0]),
    radius_inner_m=0.567,
    radius_outer_m=0.597,
)


def named(elements, kind):
    return [element for element in elements if isinstance(element, kind)]


def test_the_corners_of_the_frustum_are_those_of_the_image():
    frustum, *_ = rig_elements(RIG, 0, RING.center_m)

    np.testing.assert_allclose(
        project(frustum.corners_m, RIG.camera), [[0, 0], [800, 0], [800, 600], [0, 600]], atol=1e-9
    )


@pytest.mark.parametrize("turned", [False, True])
def test_corners_of_a_light_plane_lie_in_it_and_masked_lasers_have_none(turned):
    lasers = PROJECTED
    if turned:  # planes along the columns
        exchange = [1, 0, 2]
        lasers = replace(lasers, normal=lasers.normal[:, exchange], projector_m=lasers.projector_m[:, exchange])
    _, *planes = rig_elements(replace(RIG, lasers=lasers), 0b101, RING.center_m)

    assert [plane.name for plane in planes] == [lasers.names[0], lasers.names[2]]
    for plane, laser in zip(planes, (0, 2), strict=True):
        np.testing.assert_allclose(plane.vertices_m @ lasers.normal[laser], lasers.distance_m[laser], atol=1e-9)


def test_stripes_lie_in_the_rings_face_between_its_edges():
    lines = stripes(RIG, 0b111, RING.center_m, RING.normal, (RING.radius_inner_m, RING.radius_outer_m))

    for stroke in lines.strokes:
        offset_m = stroke.points_m - RING.center_m
        np.testing.assert_allclose(offset_m @ RING.normal, 0.0, atol=1e-9)
        np.testing.assert_allclose(np.linalg.norm(offset_m, axis=1), [RING.radius_inner_m, RING.radius_outer_m])


def test_a_ring_of_which_only_the_normal_is_known_has_neither_circles_nor_stripes():
    elements = recorded_elements(RIG, None, replace(RING, center_m=None), None)

    assert [element.strokes for element in elements] == [()]


def test_what_is_measured_has_its_grasp_point_and_its_ellipsoid_and_is_pale_once_outdated():
    pose = pose_of(covariance_center_m2=np.diag([1e-6, 4e-6, 9e-8]))
    fresh, outdated = rings(pose, None, None), rings(pose, None, None, is_outdated=True)

    (grasp,), (center,) = named(fresh, Ball), named(fresh, Ellipsoid)
    np.testing.assert_array_equal(grasp.center_m, pose.grasp_m)
    np.testing.assert_allclose(center.half_axes_m.T @ center.half_axes_m, 9 * pose.covariance_center_m2)
    assert named(outdated, Ellipsoid)[0].opacity == PALE
    assert np.ptp(named(outdated, Ball)[0].color) < np.ptp(grasp.color)


def test_bounds_include_camera_and_rings():
    target_m, middle_m, radius_m = bounds([None, RING])

    np.testing.assert_array_equal(target_m, RING.center_m)
    assert np.linalg.norm(middle_m) < radius_m
    assert np.linalg.norm(RING.center_m - middle_m) + RING.radius_outer_m < radius_m


def test_the_whole_target_and_the_camera_are_in_the_bounds(example_target):
    scene, placement = example_target
    surfaces = target_surfaces(scene)

    about = bounds_of_target(surfaces, placement)

    vertices_m = np.concatenate([placement.points_camera(each.vertices_m) for each in surfaces])
    for point_m in (*vertices_m, np.zeros(3)):
        assert np.linalg.norm(point_m - about.middle_m) <= about.radius_m + 1e-9
    assert about.radius_m < np.linalg.norm(np.ptp(vertices_m, axis=0))


def test_edges_of_a_target_lie_on_its_surfaces(example_target):
    scene, _ = example_target
    vertices_m = np.concatenate([each.vertices_m for each in target_surfaces(scene)])

    strokes = target_edges(scene).strokes

    ends_m = np.concatenate([stroke.points_m for stroke in strokes if isinstance(stroke, Path)])
    circles = [stroke for stroke in strokes if isinstance(stroke, Circle)]
    on_circles_m = np.array([circle.center_m + circle.axes_m[0] for circle in circles])
    assert len(ends_m) >= 24
    assert len(circles) >= 4
    for point_m in (*ends_m, *on_circles_m):
        assert np.linalg.norm(vertices_m - point_m, axis=1).min() < 1e-9


@pytest.fixture(scope="module")
def example_target():
    scene = read_scene(FilePath(__file__).parents[2] / "examples" / "scene.yaml")
    return scene, target_placement(scene, ring_views(scene)[0])
