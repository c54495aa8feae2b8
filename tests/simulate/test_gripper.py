"""A gripper before the camera: hides features from the camera, stops the light of a laser, and is seen in images."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from ringpose.files.scenes.scene import read_scene
from ringpose.simulate.features import Deviations, drawn_features
from ringpose.simulate.pipeline import simulated_shot
from ringpose.simulate.placement import ring_views
from ringpose.types.detection import BreakPointFlag, NoBreakPoints
from ringpose.types.target import MATERIALS, Box, Part

EXAMPLE = Path(__file__).parents[2] / "examples" / "scene.yaml"


@pytest.fixture(scope="module")
def scene():
    whole = read_scene(EXAMPLE)
    return replace(whole, views=ring_views(whole)[:1], approaches=())


def finger_at(point_m, size_m=0.004):
    """A small black box about a point in the camera frame."""
    half_m = np.full(3, size_m / 2)
    return Part(
        name="finger",
        shape=Box(low_m=-half_m, high_m=half_m),
        materials=(MATERIALS["black"],) * 6,
        translation_m=np.asarray(point_m, dtype=np.float64),
    )


def points_of(scene):
    return next(drawn_features(scene, Deviations(noise=False))).detection.break_points


def in_space(scene, laser, edge):
    """The break point of a laser on an edge."""
    from ringpose.geometry.rays import rays

    lasers = scene.rig.lasers
    ray = rays(points_of(scene).position_px[laser, edge], scene.rig.camera)
    return ray * lasers.distance_m[laser] / (ray @ lasers.normal[laser])


def test_a_break_point_behind_the_gripper_is_not_seen_and_flagged(scene):
    finger = finger_at(0.6 * in_space(scene, 1, 0))
    points = points_of(replace(scene, gripper=(finger,)))

    hidden = np.zeros((3, 2), dtype=bool)
    hidden[1, 0] = True
    np.testing.assert_array_equal(points.seen, points_of(scene).seen & ~hidden)
    assert points.flags[1, 0] & BreakPointFlag.OCCLUDED
    assert np.isfinite(points.face_start_undistorted_px[1]).all()  # the rest of the stripe is seen


def test_a_break_point_in_the_shadow_of_the_gripper_is_not_lit(scene):
    point_m, from_m = in_space(scene, 0, 1), scene.rig.lasers.projector_m[0]
    finger = finger_at(from_m + 0.4 * (point_m - from_m))
    points = points_of(replace(scene, gripper=(finger,)))

    assert points.flags[0, 1] & BreakPointFlag.OCCLUDED
    assert not points.seen[0, 1]
    assert points.seen.sum() == points_of(scene).seen.sum() - 1


def test_a_gripper_beside_or_behind_the_ring_hides_nothing(scene):
    beside = finger_at(np.array([0.3, 0.3, 0.3]))
    behind = finger_at(1.5 * in_space(scene, 1, 0))

    np.testing.assert_array_equal(points_of(replace(scene, gripper=(beside, behind))).seen, points_of(scene).seen)


def test_behind_a_closed_hand_there_are_no_stripes(scene):
    hand = finger_at(np.array([0.0, 0.0, 0.1]), size_m=0.15)

    assert points_of(replace(scene, gripper=(hand,))) is NoBreakPoints.NO_STRIPE


def test_images_show_the_gripper_where_drawn_features_are_hidden(scene):
    finger = finger_at(0.6 * in_space(scene, 1, 0))
    (shot, truth), (with_it, truth_with_it) = (
        simulated_shot(each, each.views, 0) for each in (scene, replace(scene, gripper=(finger,)))
    )
    column, row = np.round(truth.break_points_px[1, 0]).astype(int)
    around = (slice(None), slice(row - 1, row + 2), slice(column - 1, column + 2))

    assert np.isfinite(truth.break_points_px[1, 0]).all()
    assert np.isnan(truth_with_it.break_points_px[1, 0]).all()
    assert with_it.images[around].max() < 0.5 * shot.images[around].max()
