"""Corners of a marker, drawn pixel by pixel with a brightness gradient."""

import numpy as np
import pytest
from scipy.special import ndtr

from ringpose.calibrate.boards.patterns.marker_edges import corners_from_sides

CORNERS_PX = np.array([[40.3, 38.6], [140.3, 38.6], [140.3, 138.6], [40.3, 138.6]])
BLUR_PX = 1.1


def lit_square(slope: tuple[float, float]) -> np.ndarray:
    """Draws a dark square with blurred sides on paper; the brightness changes by `slope` a pixel."""
    row, column = np.indices((180, 180), dtype=np.float64)
    inside = [
        ndtr((place - low) / BLUR_PX) * ndtr((high - place) / BLUR_PX)
        for place, low, high in ((column, 40.3, 140.3), (row, 38.6, 138.6))
    ]
    light = 1 + slope[0] * (column - 90) + slope[1] * (row - 90)
    return np.rint((180 - 150 * inside[0] * inside[1]) * light).astype(np.uint8)


@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.002, 0.0), (-0.0015, 0.0015)])
def test_marker_corners_are_not_biased_by_a_brightness_gradient(slope):
    found = corners_from_sides(lit_square(slope), CORNERS_PX + 0.4)

    assert np.abs(found.points_px - CORNERS_PX).max() < 0.01


def shoulders(across: np.ndarray) -> np.ndarray:
    """The blur is not Gaussian: an eighth of the light is displaced by a pixel, to either side."""
    return 0.75 * ndtr(across / 0.45) + 0.125 * (ndtr((across - 1) / 0.45) + ndtr((across + 1) / 0.45))


@pytest.mark.parametrize("tilt", [0.003, -0.006, 0.02])
@pytest.mark.parametrize("place", [0.0, 0.25, 0.4])
def test_sides_along_pixel_rows_are_not_biased_by_the_form_of_the_blur(tilt, place):
    """The tilt is half a pixel from end to end, so that a side crosses two rows at most."""
    turn = np.array([[np.cos(tilt), -np.sin(tilt)], [np.sin(tilt), np.cos(tilt)]])
    middle = np.array([90.3, 91.1]) + place
    corners = np.array([[-60.0, -52.0], [60.0, -52.0], [60.0, 52.0], [-60.0, 52.0]])
    row, column = np.indices((180, 180), dtype=np.float64)
    on_board = (np.stack([column, row], axis=-1) - middle) @ turn
    inside = [
        shoulders(half - on_board[..., axis]) * shoulders(half + on_board[..., axis])
        for axis, half in enumerate((60.0, 52.0))
    ]
    image = np.rint(210 - 190 * inside[0] * inside[1]).astype(np.uint8)
    true = corners @ turn.T + middle

    found = corners_from_sides(image, true + 0.4)

    assert np.abs(found.points_px - true).max() < 0.015


def test_the_correlation_at_the_ends_grows_with_the_length_left_out():
    found = corners_from_sides(lit_square((0.0, 0.0)), CORNERS_PX + 0.4)

    assert 0.3 < found.end_correlation < 0.5


@pytest.mark.parametrize("cut", [30, 34])
def test_marker_corners_beside_the_border_of_the_image_are_not_biased(cut):
    """Of the paper outside a side, 9 or 5 pixels are in the image, with a brightness gradient."""
    found = corners_from_sides(lit_square((0.002, 0.0))[cut:], CORNERS_PX - [0.0, cut] + 0.4)

    assert np.abs(found.points_px - CORNERS_PX + [0.0, cut]).max() < 0.02


@pytest.mark.parametrize("radius_px", [3.0, 4.0])
def test_marker_corners_are_accurate_under_defocus(radius_px):
    """The blur is seven or nine pixels wide, more than the reach for sharp edges."""
    row, column = np.indices((180, 180), dtype=np.float64)
    turn = np.array([[np.cos(0.1), -np.sin(0.1)], [np.sin(0.1), np.cos(0.1)]])
    on_board = (np.stack([column, row], axis=-1) - 90.2) @ turn
    square = [disc_share(55.0 - on_board, radius_px), disc_share(on_board + 55.0, radius_px)]
    image = 170 - 140 * np.prod(square, axis=(0, -1))
    true = 55.0 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]]) @ turn.T + 90.2

    found = corners_from_sides(np.rint(image).astype(np.uint8), true + 0.4)

    assert np.abs(found.points_px - true).max() < 0.02


def disc_share(across: np.ndarray, radius: float) -> np.ndarray:
    """Share of a disc on the bright side of a straight edge so far within."""
    place = np.clip(across / radius, -1.0, 1.0)
    return 0.5 + (place * np.sqrt(1.0 - place**2) + np.arcsin(place)) / np.pi
