"""Weights of the rows of speckled stripes, as the twin has them: what they answer to light of known shape."""

import numpy as np
import pytest

from ringpose.kernels.reference_stripe_weights import PHASES, weights

WIDTHS = pytest.mark.parametrize("width", [0.7, 1.4, 4.0])
OFFSET = (np.arange(PHASES)[:, None] + 0.5) / PHASES - 0.5


def rows_of(width):
    return np.arange(-int(5 * width + 1), int(5 * width + 1) + 1)


@WIDTHS
@pytest.mark.parametrize("speckle", [0.0, 1.5, 12.0])
def test_light_that_is_even_or_grows_steadily_has_neither_brightness_nor_offset(width, speckle):
    found = weights(width, speckle, int(5 * width + 1))

    for_light = np.stack([np.ones_like(rows_of(width)), rows_of(width)], axis=-1)
    np.testing.assert_allclose(found.brightness @ for_light, 0, atol=1e-9)
    np.testing.assert_allclose(found.offset @ for_light, 0, atol=1e-9)


@WIDTHS
@pytest.mark.parametrize("moved_px", [0.0, 0.01])
def test_a_stripe_answers_with_its_brightness_and_how_far_it_was_moved(width, moved_px):
    found = weights(width, 12.0, int(5 * width + 1))

    light = 30 * np.exp(-0.5 * ((rows_of(width) - OFFSET - moved_px) / width) ** 2)
    np.testing.assert_allclose((found.brightness * light).sum(axis=1), 30, rtol=1e-3)
    np.testing.assert_allclose((found.offset * light).sum(axis=1) / 30, moved_px, atol=2e-5)


def test_more_speckle_moves_the_weight_from_one_to_two_and_more_widths():
    even, speckled = (weights(1.4, speckle, 8).offset ** 2 for speckle in (0.0, 12.0))

    flanks = np.abs(np.arange(-8, 9) - OFFSET) > 2.5
    assert (even * flanks).sum() < 0.2 * even.sum()
    assert (speckled * flanks).sum() > 0.8 * speckled.sum()
