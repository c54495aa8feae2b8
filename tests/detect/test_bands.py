"""Bands about predicted stripes, and the lasers that a prediction assigns to them."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.stripe_images import Kind, exact_break_points, moved, stripe_image
from drawn_scene import DrawnScene, draw_shot, drawn_rig, true_break_points
from ring_scenes import break_points_of, with_lines

from ringpose.detect.difference_images import laser_images
from ringpose.detect.pipeline import BAND_PX, BEYOND_COLUMNS, Prior, detect, predicted_bands
from ringpose.detect.stripes import find_stripes
from ringpose.geometry.rays import undistorted_pixels
from ringpose.types.detection import UNLABELLED
from ringpose.types.image import Frame

IMAGE = stripe_image(Kind.DARK, 0)


def test_bands_hold_the_ends_of_predicted_stripes_and_what_surrounds_them():
    bands = predicted_bands(exact_break_points(IMAGE), (0, 1, 2), IMAGE.rig.camera)

    assert bands is not None
    first, last = IMAGE.break_points_px.min(axis=1), IMAGE.break_points_px.max(axis=1)
    around = np.array([BAND_PX + BEYOND_COLUMNS, BAND_PX])
    np.testing.assert_allclose(bands[:, ::2], first - around, atol=1)
    np.testing.assert_allclose(bands[:, 1::2], last + around + 1, atol=1)


def test_bands_find_the_centres_that_the_whole_frame_has_there():
    bands = predicted_bands(moved(exact_break_points(IMAGE)), (0, 1, 2), IMAGE.rig.camera)

    near, whole = find_stripes(IMAGE.image, bands=bands), find_stripes(IMAGE.image)

    places = {tuple(place) for place in np.round(whole.position_px, 2).tolist()}
    found = [tuple(place) for place in np.round(near.position_px, 2).tolist()]
    assert len(found) > 400
    assert np.mean([place in places for place in found]) > 0.8


def test_without_predicted_stripes_there_are_no_bands():
    points = exact_break_points(IMAGE)
    points.face_start_undistorted_px[1] = np.nan

    assert predicted_bands(points, (1,), IMAGE.rig.camera) is None


@pytest.fixture
def drawn(rng):
    """A rig, a frame with all lasers on, and the prediction of its stripes."""
    rig, scene = drawn_rig(), DrawnScene()
    shot, truth_px = draw_shot(scene, rig, [7], rng), true_break_points(scene, rig)
    ends_px = undistorted_pixels(truth_px, rig.camera)[:, ::-1]  # the outer edge is the left one
    predicted = with_lines(break_points_of(truth_px, 1.0), ends_px, 2.0)
    return rig, shot, predicted


def test_a_prediction_assigns_the_stripes_of_a_frame_with_all_lasers_on(drawn):
    rig, shot, predicted = drawn

    found = detect(shot, rig, Prior(predicted=predicted))

    np.testing.assert_allclose(found.break_points.position_px, predicted.position_px, atol=0.2)
    assert set(found.stripes.laser.tolist()) - {UNLABELLED} == {0, 1, 2}
    x = found.stripes.position_px[found.stripes.laser[found.stripes.piece] != UNLABELLED, 0]
    assert predicted.position_px[..., 0].min() - 2.0 < x.min()  # what is on the body is not assigned
    assert x.max() < predicted.position_px[..., 0].max() + 2.0


def test_the_end_of_a_stripe_behind_a_gap_is_assigned_though_the_prediction_ends_before(drawn):
    rig, shot, predicted = drawn
    scene_px = predicted.position_px
    short_px, gap_px = 9.0, 4
    images = shot.images.copy()
    for column, row in np.rint(scene_px[:, 0]).astype(int):  # the inner edge is the right one
        images[0, row - 15 : row + 16, column - 12 - gap_px : column - 12] = 10
    predicted = replace(predicted, face_end_undistorted_px=predicted.face_end_undistorted_px - [short_px, 0.0])

    found = detect(replace(shot, images=images), rig, Prior(predicted=predicted))

    x = found.stripes.position_px[found.stripes.laser[found.stripes.piece] != UNLABELLED, 0]
    assert x.max() == pytest.approx(scene_px[:, 0, 0].max(), abs=2.0)


@pytest.mark.parametrize("wrong", ["exchanged lasers", "far away"])
def test_a_wrong_prediction_is_replaced_by_a_search_of_the_whole_frame(drawn, wrong):
    rig, shot, predicted = drawn
    truth_px = predicted.position_px
    if wrong == "far away":
        predicted = moved(predicted, 200.0)
    else:
        names = ("position_px", "face_start_undistorted_px", "face_end_undistorted_px")
        predicted = replace(predicted, **{name: getattr(predicted, name)[::-1] for name in names})

    found = detect(shot, rig, Prior(predicted=predicted))

    np.testing.assert_allclose(found.break_points.position_px, truth_px, atol=0.2)


def test_the_background_of_an_earlier_shot_is_subtracted_from_a_shot_without_one(drawn):
    rig, shot, _ = drawn
    earlier = Frame(image=np.full_like(shot.images[0], 10), lasers=0, stamp_s=-0.1, exposure_s=0.004)

    (found,), (without,) = laser_images(shot, 3, earlier), laser_images(shot, 3)

    assert found.dark is earlier.image
    assert found.dark_stamp_s == pytest.approx(-0.098)
    assert without.dark is None
    edges = detect(shot, rig, Prior(background=earlier)).ring_edges
    assert edges is None or set(edges.stamp_s.tolist()) == {shot.mid_exposure_s(0)}  # not those of the earlier frame
