"""Stripe centres: the kernel equals its twin, and refuses what it cannot read."""

import numpy as np
import pytest

from ringpose.bench.stripe_images import Kind, stripe_rig, switched_frames
from ringpose.detect.stripe_filters import stripe_filters
from ringpose.kernels import _stripes, reference_stripes
from ringpose.kernels.stripes import Filters, StripeRules, stripes

FILTERS = stripe_filters(2.5)
RULES = StripeRules(
    begin_sigmas=6.0,
    continue_sigmas=4.0,
    least_response=0.18,
    coarse_per_response=540.0,
    full_dn=255.0,
    gap=2,
    shortest=8,
)
WEAK_RULES = RULES._replace(begin_sigmas=1.5, continue_sigmas=1.0, least_response=0.01, coarse_per_response=0.0)
"""Under these noise is full of pieces."""

SEVENTH_RIG = stripe_rig(1 / 3.5)
IMAGE = np.zeros((60, 100), np.uint8)


def assert_equal_to_twin(image, dark=None, bands=None, filters=FILTERS, rules=RULES, least=1):
    found = stripes(image, dark, bands, filters, rules)
    expected = reference_stripes.stripes(image, dark, bands, filters, rules)

    assert len(found.piece) >= least
    np.testing.assert_array_equal(found.piece, expected.piece)
    np.testing.assert_allclose(found.position_px, expected.position_px, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.sigma_px, expected.sigma_px, rtol=1e-9)
    np.testing.assert_allclose(found.peak_dn, expected.peak_dn, rtol=1e-9)


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("kind", Kind)
def test_stripes_equal_the_twin(kind, seed):
    image, _ = switched_frames(kind, seed, SEVENTH_RIG)

    assert_equal_to_twin(image.image, least=500)


@pytest.mark.parametrize("kind", Kind)
def test_stripes_before_a_dark_frame_equal_the_twin(kind):
    _, frames = switched_frames(kind, 0, SEVENTH_RIG)

    assert_equal_to_twin(frames[0], frames[1], least=500)


@pytest.mark.parametrize("kind", [Kind.DIM, Kind.SATURATED, Kind.BRIGHT_FOIL])
@pytest.mark.parametrize("dark", [False, True], ids=["lit", "dark subtracted"])
def test_sixteen_bits_equal_the_twin(kind, dark):
    _, frames = switched_frames(kind, 1, SEVENTH_RIG)
    lit, black = frames[:2].astype(np.uint16) * 257

    assert_equal_to_twin(lit, black if dark else None, least=500)


@pytest.mark.parametrize("kind", [Kind.SPECKLE, Kind.FOIL])
@pytest.mark.parametrize("shape", [(343, 456), (343, 449), (340, 433), (129, 450), (257, 65)])
def test_odd_sizes_equal_the_twin(kind, shape):
    image, _ = switched_frames(kind, 2, SEVENTH_RIG)
    top = (343 - shape[0]) // 2

    assert_equal_to_twin(image.image[top : top + shape[0], : shape[1]])


@pytest.mark.parametrize("kind", [Kind.DARK, Kind.FOIL])
def test_bands_equal_the_twin(kind):
    image, _ = switched_frames(kind, 0, SEVENTH_RIG)
    first, last = np.floor(image.pieces_px.min(axis=1)), np.ceil(image.pieces_px.max(axis=1))
    bands = np.stack([first[:, 0], last[:, 0] + 1, first[:, 1] - 9, last[:, 1] + 10], axis=-1).astype(np.int32)

    assert_equal_to_twin(image.image, bands=bands, least=400)


@pytest.mark.parametrize("count", [0, 1, 4])
@pytest.mark.parametrize("height", [343, 40, 7])
def test_bands_anywhere_equal_the_twin(height, count, rng):
    image, _ = switched_frames(Kind.SPECKLE, 0, SEVENTH_RIG)
    bands = np.sort(rng.integers(-20, 480, (count, 2, 2)), axis=-1).reshape(count, 4)
    bands[:, 2:] = bands[:, 2:] * height // 343

    assert_equal_to_twin(image.image[150 : 150 + height], bands=bands.astype(np.int32), least=0)


@pytest.mark.parametrize("shortest", [1, 3])
@pytest.mark.parametrize("gap", [0, 1, 5])
@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_noise_full_of_pieces_equals_the_twin(dtype, gap, shortest, rng):
    image = rng.integers(0, np.iinfo(dtype).max, (160, 150), dtype, endpoint=True)

    assert_equal_to_twin(image, rules=WEAK_RULES._replace(gap=gap, shortest=shortest), least=5)


@pytest.mark.parametrize("sigma", [0.7, 1.3, 4.0, 8.0])
def test_other_ridge_filters_equal_the_twin(sigma, rng):
    center = 60 + 0.1 * np.arange(200)
    light = 150 * np.exp(-0.5 * ((np.arange(160)[:, None] - center) / (1.2 * sigma)) ** 2)
    image = np.clip(light + rng.normal(20, 3, light.shape), 0, 255).astype(np.uint8)

    assert_equal_to_twin(image, filters=stripe_filters(sigma), rules=RULES._replace(coarse_per_response=5.0), least=190)


@pytest.mark.parametrize("width", [3.0, 8.0, 20.0, 30.0])
def test_flat_tops_equal_the_twin(width, rng):
    apart = abs(np.arange(160)[:, None] - 80 - 0.07 * np.arange(200))
    image = np.clip(400 - 60 * np.maximum(apart - width / 2, 0) + rng.normal(0, 3, apart.shape), 0, 255)

    assert_equal_to_twin(image.astype(np.uint8), least=190)


def speckled(sigma, rng):
    """A stripe that leaves the image at its top, grows faint towards the right, and in which pixels scatter."""
    apart = np.arange(100)[:, None] - np.linspace(70, -5, 500)
    light = np.geomspace(200, 5, 500) * np.exp(-0.5 * (apart / sigma) ** 2)
    return np.clip(light * (1 + 0.2 * rng.standard_normal(light.shape)) + rng.normal(20, 1, light.shape), 0, 255)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("sigma", [0.6, 1.0, 1.5, 3.0])
def test_speckled_stripes_equal_the_twin(sigma, bits, rng):
    image = (speckled(sigma, rng) * 2 ** (bits - 8)).astype(np.uint8 if bits == 8 else np.uint16)

    assert_equal_to_twin(image, least=300)


@pytest.mark.parametrize("sigma", [0.8, 2.0])
def test_speckled_stripes_before_a_dark_frame_equal_the_twin(sigma, rng):
    dark = rng.integers(10, 14, (100, 500), np.uint8)

    assert_equal_to_twin(speckled(sigma, rng).astype(np.uint8), dark, least=300)


@pytest.mark.parametrize("share", [0.02, 0.1, 1.0])
@pytest.mark.parametrize("apart_px", [6, 9, 14, 20])
def test_speckled_stripes_beside_others_equal_the_twin(apart_px, share, rng):
    light = np.clip(speckled(1.5, rng) - 20, 0, 255)
    image = np.clip(light + share * np.roll(light, apart_px, axis=0) + 20, 0, 255)

    assert_equal_to_twin(image.astype(np.uint8), least=300)


@pytest.mark.parametrize("bits", [8, 16])
@pytest.mark.parametrize("full_dn", [80, 120, 200])
def test_saturated_speckled_stripes_equal_the_twin(full_dn, bits, rng):
    dark = rng.integers(0, 5, (100, 500)) * 2 ** (bits - 8)
    image = np.minimum(speckled(1.5, rng) * 2 ** (bits - 8), full_dn * 2 ** (bits - 8))
    rules = RULES._replace(full_dn=full_dn * 2.0 ** (bits - 8))
    dtype = np.uint8 if bits == 8 else np.uint16

    assert_equal_to_twin(image.astype(dtype), dark.astype(dtype), rules=rules, least=300)


@pytest.mark.parametrize("ridge_sigma", [4.0, 8.0])
def test_wide_speckled_stripes_equal_the_twin(ridge_sigma, rng):
    rows = np.arange(200)[:, None] - np.linspace(110, 90, 300)
    light = 120 * np.exp(-0.5 * (rows / (1.5 * ridge_sigma)) ** 2)
    image = np.clip(light * (1 + 0.2 * rng.standard_normal(light.shape)) + rng.normal(20, 1, light.shape), 0, 255)

    assert_equal_to_twin(image.astype(np.uint8), filters=stripe_filters(ridge_sigma))


@pytest.mark.parametrize("value", [0, 100, 255])
@pytest.mark.parametrize("shape", [(1, 1), (1, 50), (2, 50), (3, 3), (50, 1), (4, 16), (128, 64)])
def test_images_of_one_value_have_no_stripe_and_nor_has_the_twin(shape, value):
    image = np.full(shape, value, np.uint8)

    assert_equal_to_twin(image, least=0)
    assert len(stripes(image, None, None, FILTERS, RULES).piece) == 0


@pytest.mark.parametrize("shape", [(1, 50), (2, 50), (3, 40), (5, 300), (50, 1)])
def test_few_rows_or_columns_equal_the_twin(shape, rng):
    assert_equal_to_twin(rng.integers(0, 256, shape, np.uint8), rules=WEAK_RULES._replace(shortest=1), least=0)


@pytest.mark.parametrize("part", [np.s_[:, ::2], np.s_[::2], np.s_[::-1, 3:]])
def test_an_image_may_be_a_view_of_another(part):
    image, _ = switched_frames(Kind.DARK, 0, SEVENTH_RIG)

    found = stripes(image.image[part], None, None, FILTERS, RULES)

    expected = stripes(image.image[part].copy(), None, None, FILTERS, RULES)
    assert len(found.piece) > 100
    np.testing.assert_array_equal(found.position_px, expected.position_px)


def call(**changed):
    arguments = {"image": IMAGE, "dark": None, "bands": None, "taps": FILTERS.taps, "filters": FILTERS.figures}
    return _stripes.stripes(*(arguments | {"rules": RULES} | changed).values())


@pytest.mark.parametrize("image", [None, 3, [[1, 2]], IMAGE.astype(np.int8), IMAGE.astype(np.float32)])
def test_an_image_of_another_type_is_a_type_error(image):
    with pytest.raises(TypeError):
        call(image=image)


@pytest.mark.parametrize("image", [IMAGE[:, ::2], IMAGE.T, IMAGE[0], IMAGE[None], IMAGE[:0], IMAGE[:, :0]])
def test_an_image_of_another_shape_or_layout_is_a_value_error(image):
    with pytest.raises(ValueError, match="image"):
        call(image=image)


@pytest.mark.parametrize("dark", [IMAGE[1:], IMAGE[:, 1:].copy(), IMAGE.astype(np.uint16)])
def test_a_dark_frame_unlike_the_image_is_a_value_error(dark):
    with pytest.raises(ValueError, match="dark: must have the type and the shape"):
        call(dark=dark)


@pytest.mark.parametrize("bands", [np.zeros((1, 100, 2), np.int32), np.zeros((4, 3), np.int32)])
def test_bands_without_four_sides_are_a_value_error(bands):
    with pytest.raises(ValueError, match="bands"):
        call(bands=bands)


@pytest.mark.parametrize("rows", [(-(2**31), 2**31 - 1), (2**31 - 1, -(2**31)), (59, 60), (-9, 0), (60, 99)])
def test_bands_may_reach_beyond_the_image(rows):
    bands = np.array([[*rows, 0, 60], [0, 100, *rows], [*rows, *rows]], np.int32)

    assert len(call(bands=bands)) == 4


@pytest.mark.parametrize(("figure", "value"), [(0, 0.0), (0, np.nan), (1, 0.0), (1, 41.0), (1, np.nan), (2, -1.0)])
def test_filters_out_of_range_are_a_value_error(figure, value):
    figures = FILTERS.figures.copy()
    figures[3, figure] = value

    with pytest.raises(ValueError, match="filters"):
        call(filters=figures)


def test_filters_with_fewer_taps_than_they_reach_are_a_value_error():
    with pytest.raises(ValueError, match="filters"):
        call(taps=np.ascontiguousarray(FILTERS.taps[..., :5]))


def test_a_single_filter_is_a_value_error():
    one = Filters(taps=FILTERS.taps[:1], figures=FILTERS.figures[:1])

    with pytest.raises(ValueError, match="filters"):
        call(taps=one.taps, filters=one.figures)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("begin_sigmas", -1.0),
        ("continue_sigmas", np.nan),
        ("least_response", 0.0),
        ("coarse_per_response", -1.0),
        ("gap", -1),
        ("gap", 1001),
        ("shortest", 0),
    ],
)
def test_rules_out_of_range_are_a_value_error(name, value):
    with pytest.raises(ValueError, match="rules"):
        call(rules=RULES._replace(**{name: value}))
