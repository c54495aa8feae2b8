"""Near-singular equations stay finite and near the points; well-conditioned ones are not damped."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ring_scenes import break_points_of, make_scene

from ringpose.pose.closed_form import FORMS, SINGULAR_BELOW, constrained_form, damped_center, paper_form
from ringpose.pose.closed_form import closed_form_pose as estimate_pose
from ringpose.types.pose import PoseFlag

BOTH_FORMS = pytest.mark.parametrize("form", [paper_form, constrained_form])
EDGES = np.array([0, 1, 0, 1, 0, 1])


def points_on_arcs(height_m, spacing_m=0.005, band_m=0.03):
    """Six points of two nearly straight parallel edges 0.5 m away; the arcs are `height_m` high."""
    along = np.array([-spacing_m, 0.0, spacing_m])
    across = height_m * np.array([0.0, 1.0, 0.0])
    edges = [np.stack([across + x, along, 0.5 + 0.1 * (across + x)], axis=-1) for x in (0.0, band_m)]
    return np.stack(edges, axis=1).reshape(1, 6, 3)


@BOTH_FORMS
@given(height_m=st.floats(0.0, 5e-6))
def test_a_straight_arc_is_damped(form, height_m):
    assert form(points_on_arcs(height_m), EDGES).damped[0]


@BOTH_FORMS
@given(height_m=st.floats(-1e-5, 1e-5))
def test_the_center_of_a_straight_arc_stays_within_what_an_arc_at_the_limit_allows(form, height_m):
    points = points_on_arcs(height_m)

    center = form(points, EDGES).center_m[0]

    spacing_m = 0.005
    assert np.linalg.norm(center - points[0].mean(axis=0)) < spacing_m / SINGULAR_BELOW


@BOTH_FORMS
def test_the_center_of_a_line_is_among_its_points(form):
    points = points_on_arcs(0.0)

    center = form(points, EDGES).center_m[0]

    assert np.linalg.norm(center - points[0].mean(axis=0)) < 0.005


def test_damping_sets_in_without_a_jump():
    quotients = SINGULAR_BELOW * np.array([1 - 1e-9, 1 + 1e-9])
    angle = np.arctan(quotients)
    rows = np.stack([np.stack([np.cos(angle), np.sin(angle)], -1), np.stack([np.cos(angle), -np.sin(angle)], -1)], 1)

    centers, _ = damped_center(rows, np.array([[1.0, 0.5], [1.0, 0.5]]))

    np.testing.assert_allclose(centers[0], centers[1], rtol=1e-7)


@given(share=st.floats(0.01, 0.99))
def test_the_weakest_direction_keeps_the_square_of_its_share(share):
    angle = np.arctan(share * SINGULAR_BELOW)
    rows = np.array([[[np.cos(angle), np.sin(angle)], [np.cos(angle), -np.sin(angle)]]])
    undamped = 1.0 / (2.0 * np.sin(angle))

    center, _ = damped_center(rows, np.array([[0.5, -0.5]]))

    assert center[0, 1] == pytest.approx(share**2 * undamped, rel=1e-5)


@pytest.mark.parametrize("method", list(FORMS))
@given(distance_m=st.floats(0.2, 1.0), turn_rad=st.floats(-0.3, 0.3), size=st.sampled_from(["R597", "R1194"]))
def test_the_narrow_rig_is_not_damped(method, distance_m, turn_rad, size):
    scene = make_scene("A", distance_m=distance_m, turn_rad=turn_rad, size=size)

    pose = estimate_pose(scene.break_points(), scene.rig, method)

    assert pose.condition_number * SINGULAR_BELOW < 1.0


@pytest.mark.parametrize("method", list(FORMS))
def test_a_damped_pose_says_that_center_and_radii_are_weak(method):
    rig = make_scene("B").rig
    step = np.array([0.1, 1.0, 0.2])
    edges = []
    for start in (np.array([0.02, 0.0, 0.5]), np.array([0.05, 0.0, 0.5])):
        way = (rig.lasers.distance_m - rig.lasers.normal @ start) / (rig.lasers.normal @ step)
        line = start + way[:, None] * step
        camera = rig.camera
        edges.append(
            cv2.projectPoints(line, np.zeros(3), np.zeros(3), camera.camera_matrix, camera.distortion_coefficients)[0]
        )

    pose = estimate_pose(break_points_of(np.stack(edges, axis=1).reshape(3, 2, 2), 1e-6), rig, method)

    assert pose.condition_number * SINGULAR_BELOW > 1.0
    assert pose.flags == PoseFlag.CENTER_WEAK | PoseFlag.RADIUS_WEAK
