"""Shots with exchanged lasers are reported and left out; good shots are not."""

from dataclasses import replace

import numpy as np
import pytest
from known_views import TRUE_CAMERA, stripe_views, true_poses

from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes
from ringpose.errors import DataError
from ringpose.types.calibration import StripeView
from ringpose.types.options import PlanesMethod

NAMES = ("left", "middle", "right")
MODEL = PlanesModel(names=NAMES, method=PlanesMethod.TOTAL_LEAST_SQUARES)  # stripes are labelled before the fit
NOTHING = np.empty((0, 2))


def exchanged(view: StripeView, way: tuple[int, ...]) -> StripeView:
    """The view with each laser's stripe under the name of another."""
    return replace(view, stripes_px=tuple(view.stripes_px[laser] for laser in way))


@pytest.fixture
def good(rng):
    """Six shots with errors of corners and stripes."""
    return stripe_views(true_poses(rng, 6), rng, 0.05, 0.05)


@pytest.mark.parametrize(
    ("way", "place", "text"),
    [
        pytest.param((0, 2, 1), 0, "middle and right are exchanged against the other shots", marks=pytest.mark.slow),
        pytest.param((1, 0, 2), 3, "left and middle are exchanged against the other shots", marks=pytest.mark.slow),
        ((1, 2, 0), 0, "left shows the stripe of middle, middle shows the stripe of right"),
        pytest.param(
            (2, 0, 1), 3, "left shows the stripe of right, middle shows the stripe of left", marks=pytest.mark.slow
        ),
        ((2, 1, 0), 5, "left and right are exchanged against the other shots"),
    ],
)
def test_the_shot_with_exchanged_lasers_is_left_out_and_they_are_named(way, place, text, good):
    others = [*good[:place], *good[place + 1 :]]

    found = calibrate_planes([*good[:place], exchanged(good[place], way), *good[place + 1 :]], TRUE_CAMERA, MODEL)

    ((name, reason),) = found.contradicting
    assert name == f"v{place}"
    assert text in reason
    expected = calibrate_planes(others, TRUE_CAMERA, MODEL)
    np.testing.assert_array_equal(found.planes.normal, expected.planes.normal)


def test_two_exchanged_shots_of_six_are_named_even_if_one_shows_two_lasers(good):
    half = replace(good[2], stripes_px=(good[2].stripes_px[1], good[2].stripes_px[0], NOTHING))

    found = calibrate_planes(
        [good[0], good[1], half, good[3], exchanged(good[4], (1, 2, 0)), good[5]], TRUE_CAMERA, MODEL
    )

    assert [name for name, _ in found.contradicting] == ["v2", "v4"]


def test_two_equally_frequent_orders_are_rejected_with_their_shots(good):
    views = [exchanged(view, (1, 0, 2)) if index < 3 else view for index, view in enumerate(good)]

    with pytest.raises(DataError, match=r"v., v., v.: left and middle are exchanged against v., v., v.: as many"):
        calibrate_planes(views, TRUE_CAMERA, MODEL)


@pytest.mark.parametrize("depths_m", [None, (0.45, 0.55), (0.4, 0.45, 0.5, 0.6)], ids=str)
@pytest.mark.parametrize("number", [2, 3, pytest.param(6, marks=pytest.mark.slow)])
def test_good_shots_are_not_suspected(number, depths_m, good, rng):
    facing = [(np.eye(3), np.array([-0.15, -0.12, depth])) for depth in depths_m or ()]
    views = stripe_views(facing, rng, 0.05, 0.05) if facing else good

    assert calibrate_planes(views[:number], TRUE_CAMERA, MODEL).contradicting == ()


@pytest.mark.parametrize("number", [4, 6])
def test_a_stripe_beside_all_planes_is_left_out_and_not_taken_for_an_exchange(number, good):
    stray = replace(good[1], stripes_px=(good[1].stripes_px[0] + [0.0, 40.0], *good[1].stripes_px[1:]))

    found = calibrate_planes([good[0], stray, *good[2:number]], TRUE_CAMERA, MODEL)

    assert found.contradicting == ()
    assert [(name, reason[:23]) for name, reason in found.remarks] == [("v1", "stripe of left left out")]


def test_six_lasers_are_searched_too(good):
    names = tuple("abcdef")
    views = [replace(view, stripes_px=tuple(px + 12.0 * k for k in (0, 1) for px in view.stripes_px)) for view in good]
    views[2] = exchanged(views[2], (0, 4, 2, 3, 1, 5))

    found = calibrate_planes(views, TRUE_CAMERA, replace(MODEL, names=names))

    assert [(name, reason[:19]) for name, reason in found.contradicting] == [("v2", "b and e are exchang")]


def test_lasers_that_are_exchanged_in_all_shots_are_not_detected(good):
    found = calibrate_planes([exchanged(view, (2, 1, 0)) for view in good], TRUE_CAMERA, MODEL)

    assert found.contradicting == ()


def test_an_order_that_single_frames_contradict_is_refused(good):
    with pytest.raises(DataError, match=r"left,middle,right contradicts v0, .* show right, middle, left"):
        calibrate_planes(good, TRUE_CAMERA, replace(MODEL, order=(0, 1, 2)))
    assert len(calibrate_planes(good, TRUE_CAMERA, replace(MODEL, order=(2, 1, 0))).lasers) == 3


def test_a_shot_whose_stripes_do_not_lie_on_the_planes_is_named_and_left_out(good):
    aside = replace(good[3], stripes_px=tuple(px + np.array([0.0, 90.0]) for px in good[3].stripes_px))

    found = calibrate_planes([*good[:3], aside, *good[4:]], TRUE_CAMERA, MODEL)

    assert found.contradicting[0][0] == "v3"
    assert (
        "beside the planes of the other shots; left out: was the camera or a laser moved" in found.contradicting[0][1]
    )


def test_corners_that_miss_all_boards_ask_for_the_right_camera(good):
    other = replace(TRUE_CAMERA, camera_matrix=TRUE_CAMERA.camera_matrix * [[1.8, 1, 1], [1, 1.8, 1], [1, 1, 1]])

    with pytest.raises(
        DataError, match=r"corners miss the boards by .* give the file of the camera that took these shots"
    ):
        calibrate_planes(good, other, MODEL)
