"""Corners of a marker drawn pixel by pixel under light that falls off."""

import numpy as np
import pytest
from scipy.special import ndtr

from ringpose.calibrate.boards.marker_edges import corners_from_sides

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


def shoulders(across: np.ndarray) -> np.ndarray:
    """A rise that no error function follows: an eighth of the light a pixel aside, to either side."""
    return 0.75 * ndtr(across / 0.45) + 0.125 * (ndtr((across - 1) / 0.45) + ndtr((across + 1) / 0.45))


@pytest.mark.parametrize("tilt", [0.003, -0.006, 0.02])
@pytest.mark.parametrize("place", [0.0, 0.25, 0.4])
def test_sides_along_rows_are_drawn_where_they_are_however_lens_and_pixels_blur(tilt, place):
    """Half a pixel from end to end, so that a side crosses no more than two rows."""
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


def test_sides_share_their_errors_more_the_more_of_them_was_left_out(lit_square):
    found = corners_from_sides(lit_square((0.0, 0.0)), CORNERS_PX + 0.4)

    assert 0.3 < found.end_correlation < 0.5


@pytest.mark.parametrize("cut", [30, 34])
def test_corners_stay_where_they_are_beside_the_image_s_border(cut, lit_square):
    """The paper outside a side is in the image for 9 and for 5 of the pixels that are looked at, light falling off."""
    found = corners_from_sides(lit_square((0.002, 0.0))[cut:], CORNERS_PX - [0.0, cut] + 0.4)

    assert np.abs(found.points_px - CORNERS_PX + [0.0, cut]).max() < 0.02


@pytest.mark.parametrize("radius_px", [3.0, 4.0])
def test_corners_are_found_where_a_lens_out_of_focus_spreads_each_point_over_a_disc(radius_px):
    """Seven or nine pixels wide: a rise that ends farther out than sharp edges are looked at."""
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
