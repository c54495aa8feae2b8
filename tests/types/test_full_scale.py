"""At which grey value a pixel is full, from the images alone."""

import numpy as np
import pytest
from recorded_shots import make_shot

from ringpose.types.image import full_scale_dn


@pytest.mark.parametrize(
    ("brightest", "full"),
    [(0, 255), (255, 255), (256, 1023), (1023, 1023), (4000, 4095), (4095, 4095), (4096, 16383), (65535, 65535)],
)
def test_sixteen_bits_are_full_where_a_camera_with_as_many_bits_as_they_need_is(brightest, full):
    assert full_scale_dn(np.array([[1, brightest]], np.uint16) * np.uint16(brightest > 0)) == full


@pytest.mark.parametrize("bits", [10, 12, 14])
def test_values_shifted_to_the_top_are_full_at_the_top_of_their_bits(bits):
    values = np.arange(2**bits, dtype=np.uint16) << (16 - bits)

    assert full_scale_dn(values) == values.max()


def test_eight_bits_are_full_at_255_however_dim():
    assert full_scale_dn(np.zeros((3, 4), np.uint8)) == 255


def test_saturation_in_the_metadata_takes_precedence_over_the_images():
    shot = make_shot(np.full((1, 2, 2), 100, np.uint16), [7], meta={"saturation_dn": 4095})

    assert shot.saturation_dn == 4095
