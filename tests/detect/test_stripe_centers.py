"""Column centres of drawn stripes."""

import numpy as np
import pytest
from benchmarks.detection_errors import center_errors, joined
from benchmarks.stripe_images import Kind, stripe_image

from ringpose.detect.stripes import find_stripes

CONTRAST, SPECKLED_PEAK, SPECKLED_NOISE = 0.2, 120.0, 1.5


def drawn(center, *, peak=150.0, sigma=1.6, noise=0.0, rng=None, shape=(120, 400)):
    rows = np.arange(shape[0])[:, None]
    image = 10 + peak * np.exp(-0.5 * ((rows - center[None, :]) / sigma) ** 2)
    if rng is not None:
        image = image + rng.normal(0, noise, shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def errors_px(stripes, truth):
    """Rows of the centres less the true ones of their columns."""
    return stripes.position_px[:, 1] - truth[stripes.position_px[:, 0].astype(int)]


@pytest.mark.parametrize("sigma", [1.1, 1.6, 2.5])
def test_centres_have_no_bias_over_the_pixel(sigma):
    truth = 60 + np.linspace(-1, 1, 400)

    stripes = find_stripes(drawn(truth, sigma=sigma))

    error_px = errors_px(stripes, truth)
    assert len(error_px) == 400
    assert np.abs(error_px).max() < 0.03
    assert abs(error_px.mean()) < 0.003


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize("sigma", [1.1, 1.6, 2.5])
def test_centres_have_no_bias_where_the_border_cuts_the_stripe_off(sigma, turned):
    truth = np.linspace(12, 0, 400)
    image = drawn(truth, sigma=sigma)

    stripes = find_stripes(image[::-1] if turned else image)

    column, row = stripes.position_px.T
    error_px = (119 - row if turned else row) - truth[column.astype(int)]
    assert np.abs(error_px).max() < 0.06
    assert len(error_px) > 180


def test_a_jump_begins_a_new_piece():
    truth = np.where(np.arange(400) < 200, 50.0, 70.0)

    stripes = find_stripes(drawn(truth))

    assert len(stripes.laser) == 2


def test_a_gap_of_two_columns_does_not():
    image = drawn(np.full(400, 60.0))
    image[:, 200:202] = 10

    stripes = find_stripes(image)

    assert len(stripes.laser) == 1


def test_noise_has_hardly_any_stripe(rng):
    image = np.clip(rng.normal(40, 5, (1200, 1600)), 0, 255).astype(np.uint8)

    stripes = find_stripes(image)

    assert len(stripes.laser) <= 2


@pytest.mark.parametrize("kind", [Kind.DARK, Kind.DIM, Kind.SPECKLE, Kind.SATURATED, Kind.FOIL])
def test_squared_errors_of_columns_average_one_in_their_sigmas(kind):
    images = [stripe_image(kind, seed) for seed in range(2)]

    errors = joined([center_errors(find_stripes(image.image), image) for image in images])

    assert len(errors.error_px) > 9000
    assert 0.8 < np.mean((errors.error_px / errors.sigma_px) ** 2) < 1.25


@pytest.mark.parametrize("kind", [Kind.DARK, Kind.DIM])
def test_columns_of_clean_stripes_err_no_more_than_a_seventh_beyond_the_least_possible(kind):
    image = stripe_image(kind, 3)

    errors = center_errors(find_stripes(image.image), image)

    assert np.sqrt(np.mean((errors.error_px / errors.bound_px) ** 2)) < 1.15


def speckled(section, truth, rng, *, beneath=20.0):
    """Light whose pixels each scatter by a fifth of themselves, above what is beneath it, and the sensor's noise."""
    light = SPECKLED_PEAK * section(np.arange(80)[:, None] - truth)
    light = light * (1 + CONTRAST * rng.standard_normal(light.shape))
    image = light + beneath + rng.normal(0, SPECKLED_NOISE, light.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def gaussian(sigma):
    return lambda off: np.exp(-0.5 * (off / sigma) ** 2)


def least_speckled_px(sigma):
    """Of an unbiased estimate from all rows, whose variance is that of speckle, of noise and of rounding."""
    off = np.arange(-40, 41) - np.linspace(-0.5, 0.5, 20, endpoint=False)[:, None]
    light = SPECKLED_PEAK * gaussian(sigma)(off)
    variance = (CONTRAST * light) ** 2 + SPECKLED_NOISE**2 + 1 / 12
    return np.sqrt(np.mean(1 / np.sum((light * off / sigma**2) ** 2 / variance, axis=1)))


@pytest.mark.parametrize("sigma", [1.1, 1.4, 2.0, 2.5])
def test_centres_of_speckled_stripes_err_hardly_more_than_the_least_possible(sigma, rng):
    truth = 40 + np.linspace(-2, 2, 3000)

    stripes = find_stripes(speckled(gaussian(sigma), truth, rng))

    error_px = errors_px(stripes, truth)
    assert len(error_px) > 2980
    assert np.sqrt(np.mean(error_px**2)) < 1.1 * least_speckled_px(sigma)
    assert np.mean((error_px / stripes.sigma_px) ** 2) == pytest.approx(1, abs=0.2)


def skewed(off):
    """A normal section of sigma 1.5 px and skewness 0.3, its centroid at 0 (the third term of Gram and Charlier)."""
    u = off / 1.5
    return np.exp(-0.5 * u**2) * np.maximum(1 + 0.3 / 6 * (u**3 - 3 * u), 0)


def with_halo(off):
    """A hundredth as bright, three times as wide, two sigmas off."""
    return gaussian(1.5)(off) + 0.01 * gaussian(4.5)(off - 3.0)


@pytest.mark.parametrize(
    ("section", "times"),
    [(skewed, 1.0), (with_halo, 1.0), (skewed, 3.0), (skewed, 3.6)],
    ids=["skewed", "halo", "saturated", "more saturated"],
)
def test_skewed_sections_halos_and_saturation_hardly_draw_the_centres_of_speckled_stripes(section, times, rng):
    """Saturated ones are drawn by 0.09 and 0.12 px by their flanks."""
    truth = 40 + np.linspace(-2, 2, 3000)

    stripes = find_stripes(speckled(lambda off: times * section(off), truth, rng))

    error_px = errors_px(stripes, truth)
    assert len(error_px) > 2980
    assert abs(error_px.mean()) < 0.05


@pytest.mark.parametrize("apart", [5.5, 6.0, 7.0, 8.0, 9.0])
@pytest.mark.parametrize("sigma", [1.5, 2.5])
def test_another_stripe_beside_a_speckled_one_hardly_draws_its_centres(sigma, apart, rng):
    """Twice as wide a filter is drawn by 0.2 px, the weights alone by 0.3; the filter is by 0.05 at 5.5 widths."""
    truth = 30 + np.linspace(-2, 2, 3000)

    stripes = find_stripes(
        speckled(lambda off: gaussian(sigma)(off) + gaussian(sigma)(off - apart * sigma), truth, rng)
    )

    error_px = errors_px(stripes, truth)
    own = abs(error_px) < 3
    assert own.sum() > 2900
    assert abs(error_px[own].mean()) < 0.06


def test_light_that_grows_beneath_a_speckled_stripe_does_not_draw_its_centres(rng):
    truth = 40 + np.linspace(-2, 2, 3000)

    stripes = find_stripes(speckled(gaussian(1.5), truth, rng, beneath=20 + 0.5 * np.arange(80)[:, None]))

    error_px = errors_px(stripes, truth)
    assert abs(error_px.mean()) < 0.01


@pytest.mark.parametrize("turned", [False, True])
def test_the_border_does_not_draw_the_centres_of_a_speckled_stripe(turned, rng):
    truth = np.linspace(8, 0, 3000)
    image = speckled(gaussian(1.5), truth, rng)

    stripes = find_stripes(image[::-1] if turned else image)

    column, row = stripes.position_px.T
    error_px = (79 - row if turned else row) - truth[column.astype(int)]
    near = truth[column.astype(int)] < 6
    assert near.sum() > 300
    assert abs(error_px[near].mean()) < 0.02


def test_short_pieces_among_long_speckled_ones_are_not_told_as_fine_as_those(rng):
    """Of 12 columns they are measured by the filter, with twice the long ones' variance."""
    truth = 40 + np.linspace(-2, 2, 3000)
    pieces = speckled(gaussian(1.5), truth, rng)
    pieces[:, np.arange(3000) % 24 >= 12] = 20
    image = np.vstack([pieces, *(speckled(gaussian(1.5), truth, rng) for _ in range(2))])

    stripes = find_stripes(image)

    column, row = stripes.position_px.T
    own = np.bincount(stripes.piece)[stripes.piece] < 14
    error_px = row - truth[column.astype(int)]
    assert own.sum() > 1000
    assert 0.8 < np.mean((error_px[own] / stripes.sigma_px[own]) ** 2) < 1.65
