"""Chessboard corners under uneven illumination, in small and cut images, on drawn boards."""

import cv2
import numpy as np
import pytest
from drawn_boards import CHESSBOARD, drawn_board

from ringpose.calibrate.boards.diagnostics import BoardFailure
from ringpose.calibrate.boards.patterns.chessboard import refined_corners, saddle_points
from ringpose.calibrate.boards.views import find_board
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


def test_a_corner_beyond_the_rim_of_the_image_is_unchanged():
    corners = true_px() - [80.0, 0.0]  # the first column is at x = -0.5

    refined = refined_corners(np.ascontiguousarray(drawn_board(BOARD)[:, 80:]), corners + 0.3, HALF_PX)

    assert np.array_equal(refined[::7], corners[::7] + 0.3)
    assert np.abs((refined - corners).reshape(6, 7, 2)[:, 1:]).max() < 0.02


def far_px(image: np.ndarray, scale: float = 1.0, place: tuple[int, int] = (0, 0)) -> np.ndarray:
    """Distances of the corners found from those of the drawn board, scaled and shifted."""
    view = find_board(image, CHESSBOARD, "x")
    true = (2000 * corner_points(CHESSBOARD)[:, :2] + 40) * scale - 0.5 + place
    return np.linalg.norm(view.points_px - true, axis=1)


def test_small_noisy_squares_are_found(rng):
    small = cv2.resize(drawn_board(CHESSBOARD), None, fx=0.16, fy=0.16, interpolation=cv2.INTER_AREA)
    image = np.full((240, 320), 150.0)
    image[60 : 60 + small.shape[0], 80 : 80 + small.shape[1]] = small

    found = far_px(np.clip(image + rng.normal(0, 12, image.shape), 0, 255).astype(np.uint8), 0.16, (80, 60))

    assert found.max() < 0.7


def test_corners_that_noise_would_spoil_are_not_refined(rng):
    small = cv2.resize(drawn_board(CHESSBOARD), None, fx=0.26, fy=0.26, interpolation=cv2.INTER_AREA)
    image = np.full((240, 320), 150.0)
    image[60 : 60 + small.shape[0], 80 : 80 + small.shape[1]] = small
    blurred = cv2.GaussianBlur(image, (0, 0), 2.0)

    found = far_px(np.clip(blurred + rng.normal(0, 15, image.shape), 0, 255).astype(np.uint8), 0.26, (80, 60))

    assert found.max() < 0.7


def test_a_blot_on_one_corner_displaces_that_corner_only():
    blotted = drawn_board(CHESSBOARD)
    cv2.circle(blotted, (304, 198), 20, 20, -1)

    found = np.sort(far_px(blotted))

    assert found[-1] > 3.0
    assert found[-2] < 0.02


@pytest.mark.parametrize(
    ("corners_px", "finding"),
    [
        pytest.param(
            [(4, -92), (422, -39), (368, 287), (-57, 209)], "9 x 5 of 9 x 6 inner corners", marks=pytest.mark.slow
        ),
        ([(19, 317), (89, -68), (387, -46), (307, 378)], "8 x 6 of 9 x 6 inner corners"),
    ],
    ids=["cut above", "cut at the left"],
)
def test_corners_of_outermost_squares_do_not_replace_a_line_beyond_the_rim(corners_px, finding, rng):
    board = drawn_board(CHESSBOARD)
    height, width = board.shape
    outline = np.array([(0, 0), (width, 0), (width, height), (0, height)], np.float32)
    image_from_board = cv2.getPerspectiveTransform(outline, np.array(corners_px, np.float32))
    image = cv2.warpPerspective(board, image_from_board, (640, 480), borderValue=150)

    missing = find_board(np.clip(image + rng.normal(0, 2, image.shape), 0, 255).astype(np.uint8), CHESSBOARD, "x")

    assert missing.failure is BoardFailure.NOT_WHOLE
    assert missing.finding.startswith(finding)
