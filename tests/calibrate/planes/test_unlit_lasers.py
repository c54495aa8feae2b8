"""Lasers that the shots name but never show."""

from dataclasses import replace

import numpy as np
import pytest

from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes
from ringpose.errors import DataError

MODEL = PlanesModel(names=("left", "middle", "right"))
NOTHING = np.empty((0, 2))


def test_a_laser_that_is_on_and_never_seen_is_named_with_the_shots(rng, stripe_views, true_poses, true_camera):
    views = [
        replace(view, stripes_px=(*view.stripes_px[:2], NOTHING), lit=frozenset({0, 1, 2}))
        for view in stripe_views(true_poses(rng, 4), rng)
    ]

    with pytest.raises(
        DataError, match='laser "right": no stripe on the board in any of the 4 shots whose frames have'
    ):
        calibrate_planes(views, true_camera, MODEL)


def test_a_laser_that_is_named_and_never_on_is_told_apart(rng, stripe_views, true_poses, true_camera):
    views = [
        replace(view, stripes_px=(*view.stripes_px[:2], NOTHING), lit=frozenset({0, 1}))
        for view in stripe_views(true_poses(rng, 4), rng)
    ]

    with pytest.raises(DataError, match='laser "right": on in no frame of any shot; light it'):
        calibrate_planes(views, true_camera, MODEL)


def test_fewer_stripes_than_lasers_in_every_frame_say_how_many(rng, stripe_views, true_poses, true_camera):
    views = [
        replace(view, stripes_px=(NOTHING,) * 3, max_stripes=2, lit=frozenset({0, 1, 2}))
        for view in stripe_views(true_poses(rng, 4), rng)
    ]

    with pytest.raises(
        DataError, match=r"no frame shows more than 2 stripes on the board, there are 3 lasers \(left, mid"
    ):
        calibrate_planes(views, true_camera, replace(MODEL, order=(2, 1, 0)))


def test_no_stripe_anywhere_says_so(rng, stripe_views, true_poses, true_camera):
    views = [replace(view, stripes_px=(NOTHING,) * 3) for view in stripe_views(true_poses(rng, 2), rng)]

    with pytest.raises(DataError, match="no shot shows a stripe on the board; see that the lasers are lit"):
        calibrate_planes(views, true_camera, MODEL)
