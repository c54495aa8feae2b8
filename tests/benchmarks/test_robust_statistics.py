import math

import numpy as np
import pytest
from benchmarks.robust_statistics import mean, median, rms, robust_sd

NOTHING = np.zeros(0)


@pytest.mark.parametrize("figure", [mean, median, rms, robust_sd])
def test_nothing_has_no_figure(figure):
    assert math.isnan(figure(NOTHING))


def test_the_root_mean_square_of_3_4_5_is_known():
    assert rms(np.array([3.0, -4.0, 5.0])) == pytest.approx(math.sqrt(50 / 3))


def test_the_robust_deviation_of_normal_errors_is_their_sigma_though_some_are_wild(rng):
    errors = rng.normal(7.0, 0.2, 4000)
    errors[:40] = 1e6

    assert robust_sd(errors) == pytest.approx(0.2, rel=0.06)
    assert median(errors) == pytest.approx(7.0, abs=0.02)
