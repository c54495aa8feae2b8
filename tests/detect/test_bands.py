"""Bands about predicted stripes."""

import numpy as np
from benchmarks.stripe_images import Kind, exact_break_points, moved, stripe_image

from ringpose.detect.pipeline import BAND_PX, BEYOND_ENDS_PX, predicted_bands
from ringpose.detect.stripes import find_stripes

IMAGE = stripe_image(Kind.DARK, 0)


def test_bands_hold_the_ends_of_predicted_stripes_and_what_surrounds_them():
    bands = predicted_bands(exact_break_points(IMAGE), (0, 1, 2), IMAGE.rig.camera)

    assert bands is not None
    first, last = IMAGE.break_points_px.min(axis=1), IMAGE.break_points_px.max(axis=1)
    around = np.array([BEYOND_ENDS_PX, BAND_PX])
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
    points.face_start_px[1] = np.nan

    assert predicted_bands(points, (1,), IMAGE.rig.camera) is None
