import numpy as np
import pytest

from ringpose.simulate.renderer import speckle_pattern
from ringpose.types.scene import Speckle


@pytest.mark.parametrize("grain_px", [1.0, 3.0])
@pytest.mark.parametrize("contrast", [0.1, 0.3])
def test_speckle_has_a_mean_of_one_and_the_given_contrast(contrast, grain_px, rng):
    pattern = speckle_pattern(Speckle(contrast=contrast, grain_px=grain_px), 500, 800, rng).astype(float)

    assert pattern.mean() == pytest.approx(1.0, abs=0.01)
    assert pattern.std() == pytest.approx(contrast, rel=0.05)
    assert (speckle_pattern(Speckle(contrast=0.0), 10, 10, rng) == 1.0).all()


def test_grain_is_the_correlation_length(rng):
    """Sum of the autocorrelation along a row."""
    logarithm = np.log(speckle_pattern(Speckle(contrast=0.1, grain_px=4.0), 400, 1000, rng).astype(float))
    centred = logarithm - logarithm.mean()

    lags = [np.mean(centred[:, : 1000 - lag] * centred[:, lag:]) / centred.var() for lag in range(1, 9)]

    assert 1 + 2 * sum(lags) == pytest.approx(4.0, rel=0.1)
