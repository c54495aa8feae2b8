"""Pages of calibrations: what was seen in each view, nothing twice."""

import re
from dataclasses import replace

import cv2
import numpy as np
import pytest
from known_views import TRUE_CAMERA, stripe_views, true_poses

from ringpose.calibrate.planes.pipeline import PlanesModel, calibrate_planes
from ringpose.calibrate.planes.quality import PlanesAssessment, planes_verdict
from ringpose.report.boards import thumbnail
from ringpose.report.planes import planes_report
from ringpose.report.views import DrawnView, views_picture

NAMES = ("left", "middle", "right")


@pytest.fixture
def views(rng):
    return stripe_views(true_poses(rng, 4), rng, 0.05, 0.1)


@pytest.mark.slow
def test_a_page_of_planes_shows_verdict_planes_and_views_once_and_no_log(views):
    calibration = calibrate_planes(views, TRUE_CAMERA, PlanesModel(names=NAMES))
    calibration = replace(calibration, remarks=(("v9", "stripe of left left out: 3 mm beside the plane"),))
    assessment = PlanesAssessment(calibration=calibration, verdict=planes_verdict(calibration))

    html = planes_report(assessment, views, {"v0": np.zeros((300, 400), np.uint8)})

    text = re.sub(r'<img alt="[^>]*>', "", html)
    assert html.count("data:image/png;base64,") == 5
    assert assessment.verdict.advice != ()
    assert all(text.count(sentence) == 1 for sentence in (*assessment.verdict.advice, "3 mm beside the plane"))
    assert "advice:" not in text
    for title in ("Light planes", "Views", "Left out or missing", "left to middle"):
        assert title in text


@pytest.mark.slow
def test_a_page_of_planes_states_the_bows_of_those_that_are_bent(rng):
    bent = stripe_views(true_poses(rng, 4), rng, center_px=0.15, bow_per_rad=[0.0114, 0.0, 0.0])
    calibration = calibrate_planes(bent, TRUE_CAMERA, PlanesModel(names=NAMES))

    html = planes_report(PlanesAssessment(calibration=calibration, verdict=planes_verdict(calibration)), bent, {})

    assert "bow 1/rad" in html
    assert f"{calibration.bows['left'].per_rad:.5f}" in html


def test_a_picture_of_a_view_shows_its_image_and_rejected_corners_in_red(views):
    image = np.tile(np.linspace(0, 250, 1600).astype(np.uint8), (1200, 1))
    calibration = calibrate_planes(views, TRUE_CAMERA, PlanesModel(names=NAMES))
    left_out = np.zeros(16, bool)

    def drawn(rejected):
        left_out[3] = rejected
        view = DrawnView(
            board=views[0].board, pose=calibration.poses[0], residual_px=np.full((16, 2), 0.1), left_out=left_out
        )
        picture = views_picture([view], TRUE_CAMERA, {"v0": thumbnail(image)})
        return cv2.imdecode(np.frombuffer(picture.png, np.uint8), cv2.IMREAD_COLOR)

    without, rejected = drawn(False), drawn(True)
    red = [((each[..., 2] > 180) & (each[..., :2].max(axis=-1) < 90)).sum() for each in (without, rejected)]
    assert red[0] == 0
    assert red[1] > 10
    grey = without[without.shape[0] // 2, : without.shape[1] // 3].astype(int)
    assert grey[20:60].mean() + 80 < grey[-60:-20].mean()


def test_a_thumbnail_is_a_small_image_of_eight_bits():
    small = thumbnail(np.full((1200, 1600), 40000, np.uint16))

    assert (small.shape, small.dtype) == ((400, 533), np.uint8)
