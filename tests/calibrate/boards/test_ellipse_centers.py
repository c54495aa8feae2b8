"""Centres of ellipses, drawn pixel by pixel with a brightness gradient."""

import numpy as np
import pytest
from scipy.special import ndtr

from ringpose.calibrate.boards.patterns.circles import refined_ellipse_centers

MIDDLE_PX = np.array([40.37, 38.81])
BLUR_PX = 1.1


def conic(axes_px: tuple[float, float], middle_px: np.ndarray) -> np.ndarray:
    moved = np.eye(3)
    moved[:2, 2] = -middle_px
    return moved.T @ np.diag([axes_px[0] ** -2, axes_px[1] ** -2, -1.0]) @ moved


@pytest.fixture
def lit_ellipse():
    """Draws an ellipse of ink on paper, eight by eight points a pixel; the brightness changes by `slope` a pixel."""

    def drawn(axes_px: tuple[float, float], slope: tuple[float, float]) -> np.ndarray:
        fine = (np.arange(80 * 8) + 0.5) / 8 - 0.5
        row, column = np.meshgrid(fine, fine, indexing="ij")
        x, y = (column - MIDDLE_PX[0]) / axes_px[0], (row - MIDDLE_PX[1]) / axes_px[1]
        size = np.hypot(x, y)
        outside = (size - 1) * size / np.hypot(x / axes_px[0], y / axes_px[1])
        light = 1 + slope[0] * (column - 40) + slope[1] * (row - 40)
        seen = (30 + 150 * ndtr(outside / BLUR_PX)) * light
        return np.rint(seen.reshape(80, 8, 80, 8).mean(axis=(1, 3))).astype(np.uint8)

    return drawn


@pytest.mark.parametrize("axes_px", [(14.0, 14.0), (12.0, 8.0), (5.0, 4.0)])
@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.002, -0.001)])
def test_ellipse_centres_are_not_biased_by_a_brightness_gradient(axes_px, slope, lit_ellipse):
    image, start = lit_ellipse(axes_px, slope), MIDDLE_PX + np.array([0.15, -0.2])

    for _ in range(2):
        (start,) = refined_ellipse_centers(image, start[None], conic(axes_px, start)[None])

    assert np.abs(start - MIDDLE_PX).max() < 0.015


@pytest.mark.parametrize(("place", "contrast"), [((3.0, 3.0), True), ((40.0, 40.0), False)])
def test_an_ellipse_at_the_rim_of_the_image_or_without_contrast_is_unchanged(place, contrast, lit_ellipse):
    image = lit_ellipse((10.0, 10.0), (0.0, 0.0)) if contrast else np.full((80, 80), 90, np.uint8)
    start = np.array([place])

    found = refined_ellipse_centers(image, start, conic((10.0, 10.0), start[0])[None])

    assert found.tolist() == start.tolist()
