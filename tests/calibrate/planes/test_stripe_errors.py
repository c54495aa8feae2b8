"""Errors of lines fitted to correlated centres."""

import numpy as np
import pytest

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
