"""Stripe centres against the zero of a Gaussian derivative, known sections and symmetries."""

from dataclasses import replace

import numpy as np
import pytest
from benchmarks.stripe_images import Kind, stripe_rig, switched_frames
from scipy.ndimage import gaussian_filter1d

from ringpose.detect.stripes import StripeParams, stripe_centers, stripe_filters

FILTERS = stripe_filters(2.5)
RULES = StripeParams(min_response=0.18, coarse_per_response=540.0, full_dn=255)
WEAK_RULES = replace(RULES, begin_sigmas=1.5, continue_sigmas=1.0, min_response=0.01, coarse_per_response=0.0)
"""Under these noise is full of pieces."""

SEVENTH_RIG = stripe_rig(1 / 3.5)


def drawn(sigma, rng, *, noise=1.0, peak=150.0, skew=0.0, beneath=20.0, shape=(160, 200)):
    """An image of one stripe that rises slowly, and its rows."""
    truth = shape[0] / 2 + 0.07 * (np.arange(shape[1]) - shape[1] / 2)
    u = (np.arange(shape[0])[:, None] - truth) / sigma
    light = peak * np.exp(-0.5 * u**2) * (1 + skew * np.tanh(u)) + beneath
    return np.clip(np.rint(light + rng.normal(0, noise, light.shape)), 0, 255).astype(np.uint8), truth


def zeros_of_slope(image, sigma, near):
    """Row in each column, nearest to the given one, where the Gaussian-smoothed image has its maximum."""
    slope = gaussian_filter1d(image.astype(np.float64), sigma, axis=0, order=1, truncate=6)
    found = []
    for column, row in zip(slope.T, near, strict=True):
        above = np.flatnonzero((column[:-1] > 0) & (column[1:] <= 0))
        zero = above + column[above] / (column[above] - column[above + 1])
        found.append(zero[np.argmin(np.abs(zero - row))])
    return np.array(found)


@pytest.mark.parametrize("sigma", [2.0, 2.5, 4.0])
def test_centres_are_zeros_of_the_slope_under_a_filter_somewhat_wider_than_the_stripe(sigma, rng):
    image, truth = drawn(sigma, rng)

    found = stripe_centers(image, None, None, FILTERS, RULES)

    assert found.position_px[:, 0].tolist() == list(range(200))
    off_px = found.position_px[:, 1] - zeros_of_slope(image, 1.26 * sigma, truth)
    assert np.sqrt(np.mean(off_px**2)) < 0.3 * np.median(found.sigma_px)


@pytest.mark.parametrize(("sigma", "filter_sigma"), [(0.8, 0.7), (1.5, 1.3), (4.0, 4.0), (8.0, 8.0), (12.0, 8.0)])
def test_centres_have_no_bias_and_scatter_no_more_than_reported_under_any_ridge_filter(sigma, filter_sigma, rng):
    image, truth = drawn(sigma, rng, noise=3.0)

    found = stripe_centers(image, None, None, stripe_filters(filter_sigma), replace(RULES, coarse_per_response=5.0))

    error_px = found.position_px[:, 1] - truth[found.position_px[:, 0].astype(int)]
    assert len(error_px) > 190
    assert abs(error_px.mean()) < 4 * error_px.std() / np.sqrt(len(error_px)) + 0.01
    assert 0.1 < np.mean((error_px / found.sigma_px) ** 2) < 1.4


@pytest.mark.parametrize("width", [3.0, 8.0, 20.0, 30.0])
def test_centres_of_saturated_tops_have_no_bias(width, rng):
    truth = 80 + 0.07 * np.arange(200)
    apart = abs(np.arange(160)[:, None] - truth)
    image = np.clip(400 - 60 * np.maximum(apart - width / 2, 0) + rng.normal(0, 3, apart.shape), 0, 255)

    found = stripe_centers(image.astype(np.uint8), None, None, FILTERS, RULES)

    error_px = found.position_px[:, 1] - truth[found.position_px[:, 0].astype(int)]
    assert len(error_px) >= 190
    assert abs(error_px.mean()) < 0.02
    assert np.abs(error_px).max() < 0.5


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_centres_before_a_dark_frame_are_those_of_the_difference(dtype, rng):
    image, _ = drawn(1.6, rng, beneath=0.0, peak=120.0)
    dark = rng.integers(0, 120, image.shape, np.uint8)

    found = stripe_centers((image + dark).astype(dtype), dark.astype(dtype), None, FILTERS, RULES)

    expected = stripe_centers(image.astype(dtype), None, None, FILTERS, RULES)
    np.testing.assert_array_equal(found.piece, expected.piece)
    np.testing.assert_allclose(found.position_px, expected.position_px, atol=1e-9)


@pytest.mark.parametrize("kind", [Kind.DARK, Kind.FOIL, Kind.SPECKLE])
def test_sixteen_bits_of_the_same_light_give_the_same_centres(kind):
    image = switched_frames(kind, 1, SEVENTH_RIG)[0].image
    wide = replace(RULES, full_dn=255 * 257, min_response=RULES.min_response * 257)

    eight, sixteen = (
        stripe_centers(image, None, None, FILTERS, RULES),
        stripe_centers(image.astype(np.uint16) * 257, None, None, FILTERS, wide),
    )

    assert len(eight.piece) > 500
    np.testing.assert_array_equal(eight.piece, sixteen.piece)
    np.testing.assert_allclose(eight.position_px, sixteen.position_px, atol=1e-3)
    np.testing.assert_allclose(eight.peak_dn, sixteen.peak_dn / 257, rtol=1e-3)


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("sigma", [1.0, 2.5])
def test_a_mirrored_image_has_mirrored_centres(sigma, axis, rng):
    image, _ = drawn(sigma, rng, skew=0.3)
    mirrored = np.flip(image, axis)

    found, other = (stripe_centers(each, None, None, FILTERS, RULES) for each in (image, mirrored))

    x, y = found.position_px.T
    back = np.stack([199 - x, y] if axis else [x, 159 - y], axis=-1)
    np.testing.assert_allclose(back[np.argsort(back[:, 0])], other.position_px, atol=1e-3)


@pytest.mark.parametrize("shape", [(121, 200), (130, 173), (129, 129), (100, 65)])
@pytest.mark.parametrize("moved", [(0, 0), (3, 5), (17, 16)])
def test_a_part_of_an_image_has_the_centres_that_the_image_has_there(shape, moved, rng):
    image, _ = drawn(1.6, rng)
    top, left = 20 + moved[0], min(moved[1], 200 - shape[1])

    found = stripe_centers(image[top : top + shape[0], left : left + shape[1]], None, None, FILTERS, RULES)

    whole = stripe_centers(image, None, None, FILTERS, RULES)
    expected = whole.position_px[left : left + shape[1]] - [left, top]
    np.testing.assert_allclose(found.position_px, expected, atol=1e-4)


@pytest.mark.parametrize("shortest", [1, 3])
@pytest.mark.parametrize("gap", [0, 1, 5])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_pieces_of_noise_ascend_column_by_column(dtype, gap, shortest, rng):
    image = rng.integers(0, np.iinfo(dtype).max, (160, 150), dtype, endpoint=True)

    found = stripe_centers(image, None, None, FILTERS, replace(WEAK_RULES, gap=gap, shortest=shortest))

    assert (np.diff(found.piece) >= 0).all()
    assert np.isfinite(found.position_px).all()
    assert (found.sigma_px > 0).all()
    pieces = np.split(found.position_px, np.flatnonzero(np.diff(found.piece)) + 1)
    assert len(pieces) > 2
    assert all((np.diff(piece[:, 0]) >= 1).all() for piece in pieces)


def test_every_band_shows_only_its_own_stripe(rng):
    upper, _ = drawn(1.6, rng, beneath=0.0)
    image = np.maximum(upper, np.roll(upper, 50, axis=0))

    found = stripe_centers(image, None, np.array([[32, 112, 120, 140]], np.int32), FILTERS, RULES)

    whole = stripe_centers(image, None, None, FILTERS, RULES)
    inside = (whole.position_px[:, 1] > 120) & (np.abs(whole.position_px[:, 0] - 71.5) < 40)
    np.testing.assert_allclose(found.position_px, whole.position_px[inside], atol=1e-9)


@pytest.mark.parametrize("count", [0, 1, 4])
@pytest.mark.parametrize("height", [343, 40, 7])
def test_bands_anywhere_show_no_stripe_outside_them(height, count, rng):
    image, _ = switched_frames(Kind.SPECKLE, 0, SEVENTH_RIG)
    bands = np.sort(rng.integers(-20, 480, (count, 2, 2)), axis=-1).reshape(count, 4)
    bands[:, 2:] = bands[:, 2:] * height // 343

    found = stripe_centers(image.image[150 : 150 + height], None, bands.astype(np.int32), FILTERS, RULES)

    x, y = found.position_px.T
    near = [(x >= a - 16) & (x < b + 16) & (y >= c - 8) & (y < d + 8) for a, b, c, d in bands]
    assert np.any(near, axis=0).all() if count else not len(x)


@pytest.mark.parametrize("value", [0, 100, 255])
@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (2, 50), (3, 3), (50, 1), (4, 16), (128, 64)])
def test_images_of_one_value_have_no_stripe(shape, value):
    assert len(stripe_centers(np.full(shape, value, np.uint8), None, None, FILTERS, RULES).piece) == 0


@pytest.mark.parametrize("shape", [(1, 50), (2, 50), (3, 40), (5, 300), (50, 1)])
def test_centres_of_few_rows_or_columns_lie_in_the_image(shape, rng):
    found = stripe_centers(rng.integers(0, 256, shape, np.uint8), None, None, FILTERS, replace(WEAK_RULES, shortest=1))

    assert ((found.position_px >= -0.5) & (found.position_px <= np.array(shape[::-1]) - 0.5)).all()


@pytest.mark.parametrize("part", [np.s_[:, ::2], np.s_[::2], np.s_[::-1, 3:]])
def test_an_image_may_be_a_view_of_another(part):
    image, _ = switched_frames(Kind.DARK, 0, SEVENTH_RIG)

    found = stripe_centers(image.image[part], None, None, FILTERS, RULES)

    expected = stripe_centers(image.image[part].copy(), None, None, FILTERS, RULES)
    assert len(found.piece) > 100
    np.testing.assert_array_equal(found.position_px, expected.position_px)


@pytest.mark.parametrize("rows", [(-(2**31), 2**31 - 1), (2**31 - 1, -(2**31)), (59, 60), (-9, 0), (60, 99)])
def test_bands_may_reach_beyond_the_image(rows):
    bands = np.array([[*rows, 0, 60], [0, 100, *rows], [*rows, *rows]], np.int32)

    assert len(stripe_centers(np.zeros((60, 100), np.uint8), None, bands, FILTERS, RULES).piece) == 0
