"""Moving the scene moves the pose."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ring_scenes import make_scene, pixels_of

from ringpose.pose.closed_form import FORMS, constrained_form, paper_form
from ringpose.pose.closed_form import closed_form_pose as estimate_pose

BOTH_METHODS = pytest.mark.parametrize("method", list(FORMS))
EDGES = np.array([0, 1, 0, 1, 0, 1])
ANGLES = st.tuples(*[st.floats(-0.2, 0.2)] * 3)


def noisy_points(scene, seed=1, sigma_m=1e-4):
    """The scene's points, each up to a tenth of a millimetre beside its place."""
    return scene.points_m.reshape(1, 6, 3) + sigma_m * np.random.default_rng(seed).normal(size=(1, 6, 3))


@BOTH_METHODS
@given(angles=ANGLES)
def test_turning_rig_and_ring_about_the_camera_turns_the_pose(method, angles):
    still = make_scene("B")
    turn = cv2.Rodrigues(np.array(angles))[0]
    lasers = replace(still.rig.lasers, normal=still.rig.lasers.normal @ turn.T)
    position_px = pixels_of(still.points_m @ turn.T, still.rig.camera)

    pose = estimate_pose(
        replace(still.break_points(), position_px=position_px), replace(still.rig, lasers=lasers), method
    )

    turned = np.concatenate([turn @ still.ring.center_m, turn @ still.ring.normal])
    np.testing.assert_allclose(np.concatenate([pose.center_m, pose.normal]), turned, rtol=0, atol=1e-9)


@given(angles=ANGLES, shift=st.tuples(*[st.floats(-0.1, 0.1)] * 3))
def test_moving_noisy_points_moves_the_constrained_center(angles, shift):
    points = noisy_points(make_scene("B"))
    turn, shift_m = cv2.Rodrigues(np.array(angles))[0], np.array(shift)

    before = constrained_form(points, EDGES).center_m[0]
    after = constrained_form(points @ turn.T + shift_m, EDGES).center_m[0]

    np.testing.assert_allclose(after, turn @ before + shift_m, rtol=0, atol=1e-9)


@pytest.mark.parametrize("form", [paper_form, constrained_form])
@given(angles=ANGLES)
def test_turning_noisy_points_about_the_camera_turns_the_center(form, angles):
    points = noisy_points(make_scene("B"))
    turn = cv2.Rodrigues(np.array(angles))[0]

    before = form(points, EDGES).center_m[0]
    after = form(points @ turn.T, EDGES).center_m[0]

    np.testing.assert_allclose(after, turn @ before, rtol=0, atol=1e-6)


@given(factor=st.floats(0.1, 10.0))
def test_the_constrained_center_knows_no_unit(factor):
    points = noisy_points(make_scene("B"))

    before = constrained_form(points, EDGES).center_m[0]
    after = constrained_form(factor * points, EDGES).center_m[0]

    np.testing.assert_allclose(after, factor * before, rtol=1e-9)


def test_the_papers_center_depends_on_the_unit():
    points = noisy_points(make_scene("B"))

    in_millimetres = paper_form(points, EDGES).center_m[0]
    in_metres = paper_form(points / 1000.0, EDGES).center_m[0] * 1000.0

    assert np.linalg.norm(in_millimetres - in_metres) > 0.01


@BOTH_METHODS
@given(order=st.permutations([0, 1, 2]))
def test_the_order_of_the_lasers_does_not_matter_to_true_points(method, order):
    scene = make_scene("B")
    lasers = replace(
        scene.rig.lasers,
        normal=scene.rig.lasers.normal[order],
        distance_m=scene.rig.lasers.distance_m[order],
    )
    position_px = scene.position_px[order]

    pose = estimate_pose(
        replace(scene.break_points(), position_px=position_px), replace(scene.rig, lasers=lasers), method
    )

    np.testing.assert_allclose(pose.center_m, scene.ring.center_m, rtol=0, atol=1e-10)


@BOTH_METHODS
@given(count=st.integers(4, 7))
def test_more_lasers_than_three_give_the_true_center(method, count):
    rig = make_scene("B").rig
    tilt = np.linspace(-0.2, 0.2, count)
    lasers = replace(
        rig.lasers,
        names=tuple(f"laser_{number}" for number in range(count)),
        normal=np.stack([0.0 * tilt, np.cos(tilt), np.sin(tilt)], axis=-1),
        distance_m=np.full(count, -0.05),
        projector_m=np.full((count, 3), np.nan),
    )
    scene = make_scene(replace(rig, lasers=lasers), distance_m=0.6)

    pose = estimate_pose(scene.break_points(), scene.rig, method)

    np.testing.assert_allclose(pose.center_m, scene.ring.center_m, rtol=0, atol=1e-10)
