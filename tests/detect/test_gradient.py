"""Gradient and anchors: exact on ramps, on the edge on steps."""

import numpy as np
import pytest

from ringpose.detect.line_segments import (
    MAX_STEPS,
    STEPS_PER_DN,
    eight_bit,
    image_gradient,
    in_sixteen_bits,
    magnitude_steps,
)

ROW, COLUMN = np.indices((24, 30))


@pytest.mark.parametrize("ramp", [COLUMN, ROW])
@pytest.mark.parametrize("slope_dn", [1, 2, 7])
def test_a_ramp_along_an_axis_has_exactly_its_slope(ramp, slope_dn):
    gradient = image_gradient((slope_dn * ramp).astype(np.uint8), 1.0)

    np.testing.assert_array_equal(gradient.magnitude[3:-3, 3:-3], STEPS_PER_DN * slope_dn)


def test_a_diagonal_ramp_is_within_seven_percent_of_its_slope():
    gradient = image_gradient((2 * (ROW + COLUMN)).astype(np.uint8), 1.0)

    steepness_dn = gradient.magnitude[3:-3, 3:-3] / STEPS_PER_DN
    np.testing.assert_allclose(steepness_dn, 2 * np.sqrt(2), rtol=0.07)


def test_the_outermost_three_pixels_have_no_gradient(rng):
    magnitude = image_gradient(rng.integers(0, 256, (19, 22), np.uint8), 1.0).magnitude

    assert magnitude[3:-3, 3:-3].all()
    assert np.count_nonzero(magnitude) == 13 * 16


@pytest.mark.parametrize("value", [0, 128, 255])
def test_a_flat_image_has_no_anchors(value):
    assert not len(image_gradient(np.full((20, 20), value, np.uint8), 0.01).anchors)


@pytest.mark.parametrize(
    ("across", "orientation"), [(ROW - 12, 0), (COLUMN - ROW - 3, 1), (COLUMN - 14, 2), (COLUMN + ROW - 27, 3)]
)
def test_anchors_of_a_step_lie_on_it_with_its_orientation(across, orientation):
    gradient = image_gradient(np.where(across > 0, 200, np.where(across < 0, 20, 110)).astype(np.uint8), 20.0)

    row, column = np.divmod(gradient.anchors, 30)
    inside = (abs(ROW - 11.5) < 6) & (abs(COLUMN - 14.5) < 9)
    along = ROW if orientation == 2 else COLUMN
    assert set(np.flatnonzero(inside & (across == 0) & (along % 8 == 0))) <= set(gradient.anchors)
    assert abs(across[row, column]).max() <= orientation % 2
    assert set(gradient.orientation[inside[row, column]]) == {orientation}


def test_the_steepest_pattern_stays_within_sixteen_bits():
    magnitude = image_gradient(np.where(ROW + COLUMN > 26, 255, 0).astype(np.uint8), 5.0).magnitude

    assert 10_000 < magnitude.max() < MAX_STEPS


@pytest.mark.parametrize(("gradient_dn", "steps"), [(0.0, 1), (1.0, 128), (3.0, 384), (1e9, MAX_STEPS)])
def test_thresholds_become_whole_steps(gradient_dn, steps):
    assert magnitude_steps(gradient_dn) == steps


@pytest.mark.parametrize("bits", [9, 12, 16])
def test_more_bits_give_the_gradient_of_eight(bits, rng):
    image = rng.integers(0, 256, (20, 24), np.uint16)
    image[0, 0] = 255

    wide = image_gradient(image << (bits - 8), 5.0, bits)

    np.testing.assert_array_equal(wide.magnitude, image_gradient(image.astype(np.uint8), 5.0).magnitude)


def test_the_low_bits_of_twelve_make_a_gradient():
    image = (2000 + 4 * COLUMN).astype(np.uint16)

    magnitude = image_gradient(image, 1.0, bits=12).magnitude

    np.testing.assert_array_equal(magnitude[3:-3, 3:-3], STEPS_PER_DN * 4 // 16)


@pytest.mark.parametrize(
    ("dtype", "largest", "elements", "bits"),
    [
        (np.uint8, 3, np.uint8, 8),
        (np.uint16, 200, np.uint8, 8),
        (np.uint16, 4095, np.uint16, 12),
        (np.uint32, 65535, np.uint16, 16),
        (np.uint32, 1 << 20, np.uint16, 16),
        (np.uint64, 0, np.uint8, 8),
    ],
)
def test_images_of_any_width_come_down_to_sixteen_bits(dtype, largest, elements, bits):
    narrowed, found = in_sixteen_bits(np.full((20, 20), largest, dtype))

    assert (narrowed.dtype, found) == (elements, bits)
    assert narrowed[0, 0] == largest >> max(0, largest.bit_length() - 16)


def test_eight_bit_leaves_an_image_of_eight_bits_alone():
    image = np.arange(12, dtype=np.uint8).reshape(3, 4)

    assert eight_bit(image) is image


@pytest.mark.parametrize(("bits", "dtype"), [(8, np.uint16), (10, np.uint16), (12, np.uint16), (16, np.uint16)])
def test_eight_bit_keeps_the_upper_bits(bits, dtype, rng):
    image = rng.integers(0, 1 << bits, (20, 20)).astype(dtype)
    image[0, 0] = (1 << bits) - 1

    np.testing.assert_array_equal(eight_bit(image), image >> (bits - 8))
