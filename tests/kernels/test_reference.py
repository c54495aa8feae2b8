"""The C kernels equal their readable twins, bit for bit."""

from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from ringpose import kernels
from ringpose.kernels import reference, reference_joins

PHOTOGRAPH = Path(__file__).parents[1] / "data" / "photographs" / "chessboard.png"
LIMITS = {"lower": 64, "shortest": 4}
RULES = {"deviation_px": 0.5, "share_change": 0.7, "window": 6, "shortest": 4}

small_images = arrays(np.uint8, st.tuples(st.integers(1, 24), st.integers(1, 40)), elements=st.integers(0, 255))
coarse_images = arrays(
    np.uint8, st.tuples(st.integers(1, 6), st.integers(1, 8)), elements=st.sampled_from([0, 90, 255])
)


def results(module, image):
    """Everything that the kernels of a module say of one image, bit for bit."""
    magnitude, anchors, orientation = module.gradient(image, 128)
    pixels, starts = module.chains(magnitude, anchors, orientation, **LIMITS)
    pieces = module.cuts(pixels, starts, **RULES)
    lines, moments = module.fits(magnitude, pixels, pieces, 2)
    joins = (kernels if module is kernels else reference_joins).joins
    joined, support = joins(lines, moments, pieces, gap_px=8.0, aside_px=1.5, shortest=6)
    found = (magnitude, anchors, orientation, pixels, starts, pieces, lines, moments, joined, support)
    return [bits_of(array) for array in found]


def bits_of(array):
    """What two equal arrays have in common."""
    return array.dtype.str, array.shape, array.tobytes()


@given(small_images)
def test_kernels_equal_their_twins_on_random_images(image):
    assert results(kernels, image) == results(reference, image)


@given(coarse_images, st.integers(1, 9))
def test_kernels_equal_their_twins_on_images_of_flat_patches_full_of_ties(image, size):
    image = np.kron(image, np.ones((size, size), np.uint8))

    assert results(kernels, image) == results(reference, image)


@pytest.mark.parametrize("shape", [(1, 1), (3, 3), (1, 40), (40, 1), (2, 9), (64, 80)])
@pytest.mark.parametrize("value", [0, 255])
def test_kernels_equal_their_twins_on_flat_images(shape, value):
    image = np.full(shape, value, np.uint8)

    assert results(kernels, image) == results(reference, image)


@pytest.mark.parametrize("period", [1, 2, 3, 8])
def test_kernels_equal_their_twins_on_checkerboards(period):
    row, column = np.indices((50, 67)) // period
    image = ((row + column) % 2 * 255).astype(np.uint8)

    assert results(kernels, image) == results(reference, image)


def test_kernels_equal_their_twins_on_a_stripe_with_noise(rng):
    row, column = np.indices((120, 160))
    stripe = 30 + 150 * np.exp(-0.5 * ((row - 60 - 0.1 * column) / 2.5) ** 2)
    image = (stripe + rng.normal(0, 4, stripe.shape)).clip(0, 255).astype(np.uint8)

    assert results(kernels, image) == results(reference, image)


def test_kernels_equal_their_twins_on_a_small_photograph():
    image = cv2.imread(str(PHOTOGRAPH), cv2.IMREAD_GRAYSCALE)

    assert results(kernels, image) == results(reference, image)


@given(
    image=arrays(np.uint16, st.tuples(st.integers(1, 20), st.integers(1, 30)), elements=st.integers(0, 65535)),
    bits=st.integers(9, 16),
)
def test_kernels_equal_their_twins_on_random_images_of_more_than_eight_bits(image, bits):
    image >>= 16 - bits

    ours = kernels.gradient(image, 128, bits)
    twin = reference.gradient(image, 128, bits)

    assert [bits_of(array) for array in ours] == [bits_of(array) for array in twin]


@given(steps=st.lists(st.integers(0, 7), min_size=1, max_size=80), stride=st.integers(1, 3))
def test_kernels_cut_random_walks_as_their_twins_do(steps, stride):
    pixels = stride * np.cumsum(np.array([reference.STEPS[step] for step in steps]), axis=0, dtype=np.int32)
    starts = np.array([0, len(pixels) // 3, len(pixels)], np.int32)

    assert bits_of(kernels.cuts(pixels, starts, **RULES)) == bits_of(reference.cuts(pixels, starts, **RULES))


@given(
    magnitude=arrays(np.int16, (9, 11), elements=st.integers(0, 300)),
    pixels=arrays(np.int32, (12, 2), elements=st.integers(-2, 12)),
    trim=st.integers(0, 9),
)
def test_kernels_fit_random_pixels_inside_and_outside_the_image_as_their_twins_do(magnitude, pixels, trim):
    pieces = np.array([[0, 11], [3, 7], [5, 5]], np.int32)

    ours = kernels.fits(magnitude, pixels, pieces, trim)
    twin = reference.fits(magnitude, pixels, pieces, trim)

    assert [bits_of(array) for array in ours] == [bits_of(array) for array in twin]


@given(
    magnitude=arrays(np.int16, st.tuples(st.integers(7, 20), st.integers(7, 24)), elements=st.integers(0, 5)),
    lower=st.integers(1, 4),
    data=st.data(),
)
def test_kernels_walk_any_magnitude_from_any_anchor_as_their_twins_do(magnitude, lower, data):
    inner = np.arange(magnitude.size).reshape(magnitude.shape)[3:-3, 3:-3].ravel().tolist()
    anchors = np.array(data.draw(st.lists(st.sampled_from(inner), max_size=30)), np.int32)
    orientation = np.resize(np.arange(4, dtype=np.uint8), len(anchors))

    ours = kernels.chains(magnitude, anchors, orientation, lower, 2)
    twin = reference.chains(magnitude, anchors, orientation, lower, 2)

    assert [bits_of(array) for array in ours] == [bits_of(array) for array in twin]


@given(
    ends=arrays(np.float64, st.tuples(st.integers(0, 25), st.just(2), st.just(2)), elements=st.integers(-3, 40)),
    gap_px=st.sampled_from([0.0, 3.0, 30.0]),
    aside_px=st.sampled_from([0.5, 2.0, 9.0]),
    shortest=st.integers(1, 20),
)
def test_kernels_join_any_lines_as_their_twins_do(ends, gap_px, aside_px, shortest):
    moments = np.concatenate([np.full((len(ends), 1), 2.0), sums_of(ends)], axis=1)
    pieces = np.stack([np.zeros(len(ends)), np.arange(len(ends))], axis=1).astype(np.int32)

    ours = kernels.joins(ends, moments, pieces, gap_px, aside_px, shortest)
    twin = reference_joins.joins(ends, moments, pieces, gap_px, aside_px, shortest)

    assert [bits_of(array) for array in ours] == [bits_of(array) for array in twin]


def sums_of(ends):
    """Sums of x, y, x x, x y and y y over both ends of each line."""
    x, y = ends[..., 0], ends[..., 1]
    return np.stack([x, y, x * x, x * y, y * y], axis=1).sum(axis=2)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(0, 34, 11))
def test_kernels_equal_their_twins_on_parts_of_photographs(shared_data: Path, number):
    photographs = sorted((shared_data / "real" / "yorkurban" / "images").glob("*.jpg"))
    image = cv2.imread(str(photographs[number]), cv2.IMREAD_GRAYSCALE)[100:260, 200:400]

    assert results(kernels, image) == results(reference, image)
