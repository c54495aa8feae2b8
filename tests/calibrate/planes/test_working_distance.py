"""Verdict on poses at the working distance, and the gain from following its advice."""

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from known_views import DISTANCES_M, NORMALS, TRUE_CAMERA, stripe_views

from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes
from ringpose.calibrate.planes.quality import planes_verdict
from ringpose.types.calibration import Grade

MODEL = PlanesModel(names=("left", "middle", "right"))


def across(lasers: tuple[int, ...], depth_m: float, tilts_rad: Sequence[float]):
    """A board at a depth and tilted, its middle on the stripes' mean there."""
    turn = cv2.Rodrigues(np.array([*tilts_rad, 0.01]))[0]
    middle = np.array([0.0, np.mean((DISTANCES_M - NORMALS[:, 2] * depth_m)[list(lasers)]), depth_m])
    return turn, middle - turn @ [0.15, 0.12, 0.0]


@pytest.fixture(scope="module")
def near_views():
    """Views of boards at 0.41 to 0.55 m, their stripes with the noise of speckle."""
    rng = np.random.default_rng(1)
    depths = np.linspace(0.41, 0.55, 8).tolist()
    places = [across((0, 1, 2), depth, rng.uniform(-0.3, 0.3, 2)) for depth in depths]
    return stripe_views(places, rng, 0.01, 0.09)


@pytest.fixture(scope="module")
def advised_views():
    """Two boards a laser at 1 m, tilted by 15 degrees, which no other stripe crosses."""
    rng = np.random.default_rng(2)
    views = []
    for laser in range(3):
        for angle in (-0.26, 0.26):
            (view,) = stripe_views([across((laser,), 1.0, (angle, 0.1))], rng, 0.01, 0.09)
            alone = tuple(px if index == laser else px[:0] for index, px in enumerate(view.stripes_px))
            views.append(replace(view, stripes_px=alone))
    return views


def center_finding(views, camera, working_distance_m=1.0):
    calibration = calibrate_planes(views, camera, MODEL)
    verdict = planes_verdict(calibration, working_distance_m=working_distance_m)
    return next(finding for finding in verdict.findings if finding.name == "ring_center_sd_m")


def test_the_error_of_poses_far_beyond_the_boards_is_reported_in_millimetres(near_views):
    finding = center_finding(near_views, TRUE_CAMERA)

    assert finding.grade is Grade.IMPROVABLE
    assert f"poses 1.00 m away will be off by {1e3 * finding.value:.1f} mm" in finding.advice
    assert "add six views of the board about 1.00 m away" in finding.advice


def test_poses_at_the_distance_of_the_boards_are_graded_good(near_views):
    assert center_finding(near_views, TRUE_CAMERA, None).grade is Grade.GOOD


@pytest.mark.slow
def test_following_the_advice_brings_poses_within_the_limit(near_views, advised_views):
    assert center_finding([*near_views, *advised_views], TRUE_CAMERA).grade is Grade.GOOD
