"""How far lines of correlated centres err."""

import numpy as np

from ringpose.calibrate.stripe_errors import shared_length


def test_six_short_stripes_whose_centres_come_in_fours_are_not_taken_for_independent(rng):
    """Means of centres that come in fours have four times the variance of independent ones."""
    stripes = [np.stack([np.arange(100.0), np.repeat(0.1 * rng.standard_normal(25), 4)], axis=-1) for _ in range(6)]

    assert 2.5 < shared_length(stripes) < 6.5


def test_stripes_too_short_to_tell_are_not_taken_for_independent(rng):
    stripes = [np.stack([np.arange(60.0), 0.1 * rng.standard_normal(60)], axis=-1) for _ in range(4)]

    assert shared_length(stripes) > 1.5
