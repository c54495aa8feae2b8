"""Steps of brightness across an edge, in pictures of straight edges."""

import math

import numpy as np
import pytest

from ringpose.detect.edge_search import edge_profiles, edge_steps

COUNT = 40


def straight_edge(place_px: float, blur_px: float = 0.9, contrast_dn: float = 60.0, noise_dn: float = 0.0, rng=None):
    """Columns up to a place have one brightness, those beyond another."""
    column = np.arange(80)
    step = np.array([0.5 * math.erfc((place_px - x) / (blur_px * math.sqrt(2))) for x in column])
    image = 80 + contrast_dn * np.tile(step, (400, 1))
    if rng is not None:
        image += rng.normal(0, noise_dn, image.shape)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8)


def steps_beside(image: np.ndarray, predicted_px: float, blur_px: float = 0.9, saturation_dn: int = 255):
    place = np.stack([np.full(COUNT, predicted_px), 10 + 9.3 * np.arange(COUNT)], axis=-1)
    normal = np.tile([1.0, 0.0], (COUNT, 1))
    return edge_steps(edge_profiles(image, place, normal, 3, saturation_dn), 3, blur_px)


@pytest.mark.parametrize("contrast_dn", [60.0, -60.0])
@pytest.mark.parametrize("place_px", [39.1, 40.0, 41.7])
def test_a_clean_step_is_placed_within_a_fortieth_of_a_pixel(place_px, contrast_dn):
    steps = steps_beside(straight_edge(place_px, contrast_dn=contrast_dn), 40.0)

    np.testing.assert_allclose(steps.offset_px, place_px - 40.0, atol=0.025)


def test_height_in_grey_values_is_that_of_the_step():
    steps = steps_beside(straight_edge(40.3, contrast_dn=37.0), 40.0)

    np.testing.assert_allclose(steps.height_dn, 37.0, atol=1.0)


@pytest.mark.parametrize("noise_dn", [2.0, 6.0])
def test_sigma_is_the_scatter_of_noisy_steps(rng, noise_dn):
    squares = []
    for _ in range(20):
        steps = steps_beside(straight_edge(40.2, noise_dn=noise_dn, rng=rng), 40.0)
        squares.append((steps.offset_px - 0.2) ** 2 / steps.sigma_px**2)

    assert 0.7 < np.nanmean(squares) < 1.3


def test_saturation_beside_a_step_hides_it():
    image = straight_edge(40.2, contrast_dn=175.0)

    assert np.all(np.isnan(steps_beside(image, 40.0, saturation_dn=250).offset_px))
    assert np.all(np.isfinite(steps_beside(image, 40.0, saturation_dn=256).offset_px))


def test_noise_has_no_height(rng):
    steps = steps_beside(straight_edge(40.0, contrast_dn=0.0, noise_dn=3.0, rng=rng), 40.0)

    assert np.median(steps.height) < 4


def test_no_places_give_no_steps():
    nowhere = np.zeros((0, 2))

    steps = edge_steps(edge_profiles(straight_edge(40.0), nowhere, nowhere, 3, 255), 3, 0.9)

    assert len(steps.offset_px) == 0
