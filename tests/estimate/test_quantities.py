"""Angles, grasp point, normal and residual against independent constructions."""

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ring_scenes import make_scene, nees

from ringpose.pose.closed_form import FORMS
from ringpose.pose.closed_form import closed_form_pose as estimate_pose
from ringpose.types.options import Method

BOTH_METHODS = pytest.mark.parametrize("method", list(FORMS))


def angle_to_plane_rad(direction, first, second):
    """Angle between a direction and the plane of two others."""
    across = np.cross(first, second)
    return np.arcsin(abs(direction @ across) / np.linalg.norm(direction) / np.linalg.norm(across))


@BOTH_METHODS
@given(pitch=st.floats(-0.3, 0.3), yaw=st.floats(-0.3, 0.3))
def test_pitch_and_yaw_are_the_turns_that_made_the_ring(method, pitch, yaw):
    # away-pointing axis: z, first pitched about x, then yawed about y
    away = cv2.Rodrigues(np.array([0.0, yaw, 0.0]))[0] @ cv2.Rodrigues(np.array([-pitch, 0.0, 0.0]))[0][:, 2]
    turn = np.cross([0.0, 0.0, 1.0], away)
    sine = np.linalg.norm(turn)
    axis = turn * (np.arctan2(sine, away[2]) / sine if sine > 0 else 1.0)
    scene = make_scene("B", tilt_rad=(axis[0], axis[1]))

    pose = estimate_pose(scene.break_points(), scene.rig, method)

    np.testing.assert_allclose([pose.pitch_rad, pose.yaw_rad], [pitch, yaw], rtol=0, atol=1e-10)


@given(tilt=st.tuples(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3)))
def test_pitch_is_the_papers_angle_between_normal_and_horizontal_plane(tilt):
    scene = make_scene("B", tilt_rad=tilt)

    pose = estimate_pose(scene.break_points(), scene.rig)

    expected = angle_to_plane_rad(pose.normal, np.array([1.0, 0, 0]), np.array([0, 0, 1.0]))
    assert abs(pose.pitch_rad) == pytest.approx(expected, abs=1e-9)


@given(distance_m=st.floats(0.25, 1.0), turn_rad=st.floats(-0.3, 0.3), side=st.sampled_from([-1, 1]))
def test_the_grasp_point_is_on_the_middle_of_the_band(distance_m, turn_rad, side):
    scene = make_scene("B", distance_m=distance_m, turn_rad=turn_rad, side=side)

    pose = estimate_pose(scene.break_points(), scene.rig)

    outward = pose.grasp_m - scene.ring.center_m
    found = [np.linalg.norm(outward), outward @ scene.ring.normal]
    np.testing.assert_allclose(found, [scene.ring.radius_m.mean(), 0.0], rtol=0, atol=1e-9)


@pytest.mark.parametrize(("rig", "distance_m"), [("A", 0.2), ("A", 0.5), ("A", 1.0), ("B", 0.25), ("B", 1.0)])
def test_the_grasp_point_is_known_where_the_center_is_not(rng, rig, distance_m):
    scene = make_scene(rig, distance_m=distance_m)

    poses = [estimate_pose(scene.break_points(0.3, rng), scene.rig) for _ in range(40)]

    assert max(2 * nees(pose, scene.ring)["grasp"] for pose in poses) < 5.0**2


def test_the_grasp_point_is_amid_the_break_points():
    scene = make_scene("B")

    pose = estimate_pose(scene.break_points(), scene.rig)

    middle = scene.points_m.reshape(-1, 3).mean(axis=0) - scene.ring.center_m
    across = np.cross(pose.grasp_m - scene.ring.center_m, middle)
    assert np.linalg.norm(across) < 1e-9


def test_the_papers_grasp_point_is_the_mean_of_the_six():
    scene = make_scene("B")

    pose = estimate_pose(scene.break_points(), scene.rig, Method.PAPER)

    np.testing.assert_allclose(pose.grasp_m, scene.points_m.reshape(-1, 3).mean(axis=0), rtol=0, atol=1e-10)


@pytest.mark.parametrize("offset_px", [0.5, 2.0])
def test_the_residual_is_what_the_pose_leaves_unexplained(offset_px):
    # both ends of a stripe moved apart along it: the plane stays, a wider band explains all but the middle's share
    scene = make_scene("B")
    break_points = scene.break_points()
    along = scene.position_px[1, 1] - scene.position_px[1, 0]
    along /= np.linalg.norm(along)
    break_points.position_px[1] += offset_px * np.stack([-along, along])

    pose = estimate_pose(break_points, scene.rig)

    # mean radius takes a third of the middle's shift: residuals (1, 1, 2)/3 on both edges, rms sqrt(2)/3
    assert pose.residual_rms_px == pytest.approx(np.sqrt(2) / 3 * offset_px, rel=0.05)
