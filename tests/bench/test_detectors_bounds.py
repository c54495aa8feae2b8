"""The bounds, against their closed forms where one kind of noise is alone."""

import math

import pytest

from ringpose.bench.detectors_bounds import column_bound_px, end_bound_px

FAINT_DN, READ_NOISE_DN = 1e-4, 1.5
BRIGHT_DN, ELECTRONS_A_DN = 1e9, 20.0


@pytest.mark.parametrize("sigma_px", [1.5, 2.5, 4.0])
def test_a_faint_column_is_bounded_by_white_noise(sigma_px):
    bound = READ_NOISE_DN / FAINT_DN * math.sqrt(2 * sigma_px / math.sqrt(math.pi))

    assert column_bound_px(FAINT_DN, sigma_px) == pytest.approx(bound, rel=1e-3)


@pytest.mark.parametrize("sigma_px", [1.5, 2.5, 4.0])
def test_a_bright_column_is_bounded_by_the_number_of_its_electrons(sigma_px):
    electrons = ELECTRONS_A_DN * BRIGHT_DN * sigma_px * math.sqrt(2 * math.pi)

    assert column_bound_px(BRIGHT_DN, sigma_px) == pytest.approx(sigma_px / math.sqrt(electrons), rel=1e-3)


@pytest.mark.parametrize("sigma_px", [1.5, 2.5, 4.0])
def test_a_faint_end_is_bounded_by_white_noise(sigma_px):
    bound = READ_NOISE_DN / FAINT_DN * math.sqrt(2 / sigma_px)

    assert end_bound_px(FAINT_DN, sigma_px) == pytest.approx(bound, rel=1e-3)


@pytest.mark.parametrize("bound", [column_bound_px, end_bound_px])
def test_more_light_is_a_lower_bound(bound):
    assert bound(200.0, 2.5) < bound(40.0, 2.5)
