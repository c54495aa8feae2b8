"""Corners of a marker drawn pixel by pixel under light that falls off."""

import numpy as np
import pytest
from scipy.special import ndtr

from ringpose.calibrate.marker_sides import corners_from_sides

CORNERS_PX = np.array([[40.3, 38.6], [140.3, 38.6], [140.3, 138.6], [40.3, 138.6]])
BLUR_PX = 1.1


@pytest.fixture
def lit_square():
    """A dark square with blurred sides on paper, under light that changes by so much a pixel."""

    def drawn(slope: tuple[float, float]) -> np.ndarray:
        row, column = np.indices((180, 180), dtype=np.float64)
        inside = [
            ndtr((place - low) / BLUR_PX) * ndtr((high - place) / BLUR_PX)
            for place, low, high in ((column, 40.3, 140.3), (row, 38.6, 138.6))
        ]
        light = 1 + slope[0] * (column - 90) + slope[1] * (row - 90)
        return np.rint((180 - 150 * inside[0] * inside[1]) * light).astype(np.uint8)

    return drawn


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.002, 0.0), (-0.0015, 0.0015)])
def test_corners_stay_where_they_are_under_light_that_falls_off(slope, lit_square):
    found = corners_from_sides(lit_square(slope), CORNERS_PX + 0.4)

    assert np.abs(found.points_px - CORNERS_PX).max() < 0.01


def test_sides_share_their_errors_more_the_more_of_them_was_left_out(lit_square):
    found = corners_from_sides(lit_square((0.0, 0.0)), CORNERS_PX + 0.4)

    assert 0.3 < found.likeness < 0.5
