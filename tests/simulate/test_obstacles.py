"""What interrupts a stripe, or makes a second one, in rendered images and in their truth."""

import re
from dataclasses import replace

import numpy as np
import pytest

from ringpose.errors import DataError
from ringpose.simulate.features import drawn_features
from ringpose.simulate.pipeline import illuminated_ring, render_ring_view, view_truth
from ringpose.simulate.renderer import layers, pixel_rays
from ringpose.types.obstacles import Blanket, Cable, Heads
from ringpose.types.rig import LaserBow
from ringpose.types.scene import Ghost
from ringpose.types.target import sloping


def crossing_rad(scene, view, laser):
    """Angle on the ring, in the target frame, of the middle of a laser's stripe: the intersection of planes."""
    placement, planes = illuminated_ring(scene, view).placement, scene.rig.lasers
    angles = np.linspace(-0.5, 0.5, 100001)
    points = np.stack([0.582 * np.cos(angles), 0.582 * np.sin(angles), np.full(angles.size, 0.06)], axis=1)
    off = placement.points_camera(points) @ planes.normal[laser] - planes.distance_m[laser]
    return float(angles[np.argmin(np.abs(off))])


def break_points_px(scene, view):
    return view_truth(scene, view, illuminated_ring(scene, view)).break_points_px


def test_the_ghost_of_a_line_is_a_fainter_copy_at_its_offset(scene, view):
    with_ghost = replace(scene, lasers=replace(scene.lasers, ghost=Ghost(rows_px=-12.0, ratio=0.25)))

    plain, doubled = (render_ring_view(each, view, 0).electrons(2, 1e-3) for each in (scene, with_ghost))

    copy = np.zeros_like(plain)
    copy[:-12] = 0.25 * plain[12:]
    np.testing.assert_allclose(doubled, plain + copy, rtol=1e-5, atol=1e-3)
    dark = [render_ring_view(each, view, 0).electrons(0, 1e-3) for each in (scene, with_ghost)]
    np.testing.assert_array_equal(*dark)


def test_a_break_point_under_a_blanket_is_null_and_the_others_remain(scene, view):
    at_rad = crossing_rad(scene, view, 1)
    covered = replace(scene, obstacles=(Blanket(kind="blanket", angle_rad=at_rad, length_m=0.04),))

    points_px, plain_px = break_points_px(covered, view), break_points_px(scene, view)

    assert np.isnan(points_px[1, 1]).all()
    expected_px = plain_px.copy()
    expected_px[1, 1] = np.nan
    np.testing.assert_array_equal(points_px, expected_px)


@pytest.mark.parametrize("kind", ["cable", "heads"])
def test_what_lies_on_the_middle_of_the_face_interrupts_one_stripe_between_its_break_points(clean_scene, view, kind):
    at_rad = crossing_rad(clean_scene, view, 1)
    obstacle = {
        "cable": Cable(kind="cable", angle_rad=at_rad, width_m=0.014, length_m=0.03),
        "heads": Heads(kind="heads", height_m=0.02, width_m=0.009, angle_rad=at_rad, count=1),
    }[kind]
    covered = replace(clean_scene, obstacles=(obstacle,))

    plain, interrupted = (
        layers(illuminated_ring(each, view), pixel_rays(each.rig.camera)).laser for each in (clean_scene, covered)
    )

    points_px = break_points_px(clean_scene, view)
    np.testing.assert_array_equal(break_points_px(covered, view), points_px)
    column, row = points_px[1].mean(axis=0).round().astype(int)
    assert interrupted[1, row, column] < 0.2 * plain[1, row, column]
    for share in (0.1, 0.9):
        column, row = (points_px[1, 0] + share * (points_px[1, 1] - points_px[1, 0])).round().astype(int)
        assert interrupted[1, row, column] == pytest.approx(plain[1, row, column], rel=0.01)
    for laser in (0, 2):
        np.testing.assert_allclose(interrupted[laser], plain[laser], rtol=0.05, atol=0.01 * plain[laser].max())


def test_heads_stand_on_the_middle_circle_at_their_spacing_all_around(ring):
    heads = Heads(kind="heads", height_m=0.02, width_m=0.009, spacing_m=0.06, angle_rad=0.3).parts(ring)

    places_m = np.array([each.translation_m for each in heads])
    assert len(heads) == int(2 * np.pi * 0.582 / 0.06)
    np.testing.assert_allclose(np.hypot(*places_m[:, :2].T), 0.582, atol=1e-12)
    chords_m = np.linalg.norm(np.diff(places_m, axis=0), axis=1)
    np.testing.assert_allclose(chords_m, 2 * 0.582 * np.sin(0.06 / 0.582 / 2), atol=1e-12)
    np.testing.assert_allclose(places_m[0, :2], [0.582 * np.cos(0.3), 0.582 * np.sin(0.3)], atol=1e-12)
    np.testing.assert_allclose(places_m[:, 2], 0.06, atol=1e-4)


def test_a_view_of_the_body_has_nothing_on_its_ring(scene, view):
    body = replace(view, target="body")
    covered = replace(scene, obstacles=(Cable(kind="cable", angle_rad=0.0),))

    plain, other = (layers(illuminated_ring(each, body), pixel_rays(each.rig.camera)) for each in (scene, covered))

    np.testing.assert_array_equal(plain.laser, other.laser)


def test_a_sloping_face_keeps_its_radii_and_its_height_in_the_middle(ring):
    cone = sloping(ring, 0.03)

    inner_m, outer_m = cone.edge_heights_m
    assert (cone.radius_inner_m, cone.radius_outer_m) == (0.567, 0.597)
    assert cone.height_m == pytest.approx(0.06, abs=1e-15)
    assert np.arctan2(outer_m - inner_m, 0.03) == pytest.approx(0.03, abs=1e-12)


@pytest.mark.parametrize(
    "key", ["lasers.ghost", "lasers.bow_per_rad", "rig (bent light planes)", "ring.slope_rad", "obstacles"]
)
def test_features_are_not_drawn_of_what_only_images_show(scene, key):
    changed = {
        "lasers.ghost": {"lasers": replace(scene.lasers, ghost=Ghost(rows_px=-15.0, ratio=0.1))},
        "lasers.bow_per_rad": {"lasers": replace(scene.lasers, bow_per_rad=0.01)},
        "rig (bent light planes)": {"rig": replace(scene.rig, bows={"left": LaserBow(per_rad=0.01, sd_per_rad=0.0)})},
        "ring.slope_rad": {"ring": sloping(scene.ring, 0.03)},
        "obstacles": {"obstacles": (Cable(kind="cable", angle_rad=0.0),)},
    }[key]

    with pytest.raises(DataError, match=rf"the scene's {re.escape(key)}: .*render images"):
        next(drawn_features(replace(scene, **changed)))
