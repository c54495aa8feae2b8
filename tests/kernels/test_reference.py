"""The C kernels equal their readable twins, bit for bit."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ringpose import kernels
from ringpose.kernels import reference

LIMITS = {"lower": 64, "shortest": 4}
RULES = {"deviation_px": 0.5, "share_change": 0.7, "window": 6, "shortest": 4}

small_images = arrays(np.uint8, st.tuples(st.integers(1, 24), st.integers(1, 40)), elements=st.integers(0, 255))
coarse_images = arrays(
    np.uint8, st.tuples(st.integers(1, 6), st.integers(1, 8)), elements=st.sampled_from([0, 90, 255])
)


def results(module, image):
    """Everything that the four kernels of a module say of one image."""
    magnitude, anchors, orientation = module.gradient(image, 128)
    pixels, starts = module.chains(magnitude, anchors, orientation, **LIMITS)
    pieces = module.cuts(pixels, starts, **RULES)
    return magnitude, anchors, orientation, pixels, starts, pieces, module.fits(magnitude, pixels, pieces, 2)


def assert_equal_results(image):
    for ours, twin in zip(results(kernels, image), results(reference, image), strict=True):
        assert ours.dtype == twin.dtype
        np.testing.assert_array_equal(ours, twin)


@given(small_images)
def test_kernels_equal_their_twins_on_random_images(image):
    assert_equal_results(image)


@given(coarse_images, st.integers(1, 9))
def test_kernels_equal_their_twins_on_images_of_flat_patches_full_of_ties(image, size):
    assert_equal_results(np.kron(image, np.ones((size, size), np.uint8)))


@pytest.mark.parametrize("shape", [(1, 1), (3, 3), (1, 40), (40, 1), (2, 9), (64, 80)])
@pytest.mark.parametrize("value", [0, 255])
def test_kernels_equal_their_twins_on_flat_images(shape, value):
    assert_equal_results(np.full(shape, value, np.uint8))


@pytest.mark.parametrize("period", [1, 2, 3, 8])
def test_kernels_equal_their_twins_on_checkerboards(period):
    row, column = np.indices((50, 67)) // period

    assert_equal_results(((row + column) % 2 * 255).astype(np.uint8))


def test_kernels_equal_their_twins_on_a_stripe_with_noise(rng):
    row, column = np.indices((120, 160))
    stripe = 30 + 150 * np.exp(-0.5 * ((row - 60 - 0.1 * column) / 2.5) ** 2)

    assert_equal_results((stripe + rng.normal(0, 4, stripe.shape)).clip(0, 255).astype(np.uint8))


@pytest.mark.slow
@pytest.mark.parametrize("number", range(0, 34, 11))
def test_kernels_equal_their_twins_on_photographs(shared_data: Path, number):
    photographs = sorted((shared_data / "real" / "yorkurban" / "images").glob("*.jpg"))

    assert_equal_results(cv2.imread(str(photographs[number]), cv2.IMREAD_GRAYSCALE))
