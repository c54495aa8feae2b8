"""Errors of stripe centres that are correlated along the stripe, or distorted by the lens."""

from dataclasses import replace

import numpy as np
import pytest
from known_views import TRUE_CAMERA, projected_px, stripe_views

from ringpose.calibrate.planes.joint_adjustment import joint_data
from ringpose.calibrate.planes.stripes.errors import center_sigma_px, shared_length


def test_six_short_stripes_of_equal_groups_of_four_centres_are_not_taken_for_independent(rng):
    """With four equal neighbours each, means of centres have four times the variance of independent ones."""
    stripes = [np.stack([np.arange(100.0), np.repeat(0.1 * rng.standard_normal(25), 4)], axis=-1) for _ in range(6)]

    assert 2.5 < shared_length(stripes) < 6.5


def test_centres_of_short_stripes_are_not_taken_for_independent(rng):
    stripes = [np.stack([np.arange(60.0), 0.1 * rng.standard_normal(60)], axis=-1) for _ in range(4)]

    assert shared_length(stripes) > 1.5


@pytest.mark.parametrize("kept", [1.0, 0.5], ids=["whole", "in pieces"])
def test_lines_of_correlated_centres_have_the_predicted_errors(kept, rng):
    """Sums of five neighbours, 18 stripes of one set together; in pieces of 40 with gaps as long."""
    normalised = []
    for _ in range(25):
        noise = np.convolve(rng.standard_normal(18 * 240), np.ones(5) / 50, "same").reshape(18, 240)
        seen = np.arange(240) % 80 < 80 * kept
        stripes = [np.stack([np.arange(240.0), own], axis=-1)[seen] for own in noise]
        length = shared_length(stripes)
        normalised += [own[:, 1].mean() / center_sigma_px(own, length) * np.sqrt(len(own)) for own in stripes]

    assert 0.9 < np.sqrt(np.mean(np.square(normalised))) < 1.1


def test_distortion_is_not_taken_for_correlated_errors(rng):
    """Lines across the image, above and below its middle, whose centres have independent errors of 0.03 px."""
    camera = replace(TRUE_CAMERA, distortion_coefficients=np.array([-0.3, 0.4, 0.0, 0.0, 0.3]))
    (view,) = stripe_views([(np.eye(3), np.array([-0.15, -0.12, 0.5]))], rng)
    x, stripes = np.arange(100.0, 1500.0), []
    for offset in (150.0, 500.0, 1000.0):
        straight = np.column_stack([x, 0.05 * x + offset, np.ones(len(x))])
        distorted = projected_px(straight @ np.linalg.inv(camera.camera_matrix).T, camera)
        stripes.append(distorted + 0.03 * rng.standard_normal((len(x), 1)) * [[0.0, 1.0]])

    data = joint_data([replace(view, stripes_px=tuple(stripes))], camera, corner_px=np.array([0.02]))

    assert data.center_px[0] == pytest.approx(0.03, rel=0.15)
