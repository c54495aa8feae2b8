"""Anchors lie on steps; images of any bit depth are reduced to 8 or 16 bits."""

import numpy as np
import pytest

from ringpose.detect.line_segments import (
    MAX_STEPS,
    eight_bit,
    image_gradient,
    in_sixteen_bits,
    magnitude_steps,
)

ROW, COLUMN = np.indices((24, 30))


def test_the_outermost_three_pixels_have_no_gradient(rng):
    magnitude = image_gradient(rng.integers(0, 256, (19, 22), np.uint8), 1.0).magnitude

    assert magnitude[3:-3, 3:-3].all()
    assert np.count_nonzero(magnitude) == 13 * 16


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


@pytest.mark.parametrize(("bits", "dtype"), [(8, np.uint8), *((bits, np.uint16) for bits in (8, 10, 12, 16))])
def test_eight_bit_keeps_the_upper_bits(bits, dtype, rng):
    image = rng.integers(0, 1 << bits, (20, 20)).astype(dtype)
    image[0, 0] = (1 << bits) - 1

    np.testing.assert_array_equal(eight_bit(image), image >> (bits - 8))
