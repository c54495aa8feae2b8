"""Chessboard corners under uneven illumination, on drawn boards."""

import numpy as np
import pytest
from drawn_boards import drawn_board

from ringpose.calibrate.boards.patterns.chessboard import refined_corners, saddle_points
from ringpose.geometry.board import corner_points
from ringpose.types.board import Board

BOARD = Board(kind="chessboard", squares_x=8, squares_y=7, square_m=0.02)
HALF_PX = 9.0


@pytest.fixture
def glaring(rng):
    """A dim board, lit by a stripe beside it, with speckle."""
    even = drawn_board(BOARD).astype(np.float64)
    column = np.arange(even.shape[1])
    light = 0.12 + 1.5 / (1 + ((column - 380) / 25.0) ** 2)
    speckle = 1 + 0.05 * rng.standard_normal(even.shape)
    return np.clip(even * light * speckle, 0, 255).astype(np.uint8)


def true_px() -> np.ndarray:
    return 2000 * corner_points(BOARD)[:, :2] + 40 - 0.5


def rms(points: np.ndarray) -> float:
    return float(np.sqrt(np.mean((points.reshape(-1, 2) - true_px()) ** 2)))


def test_corners_beside_a_glaring_stripe_are_half_as_far_off(glaring):
    start = true_px() + 0.3

    plain = refined_corners(glaring, start, HALF_PX)
    normalised = saddle_points(glaring, start.reshape(6, 7, 2), HALF_PX)

    assert rms(normalised) < 0.5 * rms(plain)


def test_corners_under_even_illumination_are_unchanged():
    normalised = saddle_points(drawn_board(BOARD), true_px().reshape(6, 7, 2), HALF_PX)

    assert np.abs(normalised.reshape(-1, 2) - true_px()).max() < 0.02


def test_corners_at_the_rim_of_the_image_or_without_contrast_are_unchanged():
    tight = drawn_board(BOARD)[72:-72, 72:-72].copy()
    start = true_px() - 72 + 0.4

    normalised = saddle_points(tight, start.reshape(6, 7, 2), HALF_PX).reshape(6, 7, 2)

    assert np.array_equal(normalised[0], start.reshape(6, 7, 2)[0])
    flat = np.full((400, 400), 90, np.uint8)
    assert np.array_equal(saddle_points(flat, true_px().reshape(6, 7, 2), HALF_PX).reshape(-1, 2), true_px())
