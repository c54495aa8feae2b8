"""Centres of tilted circles, drawn here point by point."""

import cv2
import numpy as np
import pytest

from ringpose.calibrate.boards.layout import corner_points
from ringpose.calibrate.boards.patterns.circles import opencv_ellipse_centers
from ringpose.calibrate.boards.views import find_board
from ringpose.types.board import Board

BOARD = Board(kind="asymmetric_circles", squares_x=4, squares_y=7, spacing_m=0.02)
FOCAL_PX, MIDDLE_PX, SIZE = 900.0, np.array([260.0, 210.0]), (520, 420)
SUBPIXELS = 4


@pytest.fixture
def tilted_circles():
    """Draws the grid tilted by 45 degrees at 0.35 m, and returns its projected centres."""

    def drawn(radius_m: float) -> tuple[np.ndarray, np.ndarray]:
        points = corner_points(BOARD)
        turn = cv2.Rodrigues(np.array([0.55, -0.55, 0.1]))[0]
        place = np.array([0.0, 0.0, 0.35]) - turn @ points.mean(axis=0)
        seen = points @ turn.T + place
        pixels = (np.stack(np.meshgrid(*(np.arange(n * SUBPIXELS) for n in SIZE)), -1) + 0.5) / SUBPIXELS - 0.5
        rays = np.concatenate([(pixels - MIDDLE_PX) / FOCAL_PX, np.ones((*pixels.shape[:2], 1))], axis=-1)
        depth = (turn[:, 2] @ place) / (rays @ turn[:, 2])
        on_board = (rays * depth[..., None] - place) @ turn[:, :2]
        row = np.clip(np.rint(on_board[..., 1] / 0.02 - 1), 0, 6)
        column = np.clip(np.rint((on_board[..., 0] / 0.02 - 1 - row % 2) / 2), 0, 3)
        nearest = 0.02 * np.stack([2 * column + row % 2 + 1, row + 1], axis=-1)
        dark = np.hypot(*np.moveaxis(on_board - nearest, -1, 0)) < radius_m
        light = cv2.resize(np.where(dark, 30.0, 220.0), SIZE, interpolation=cv2.INTER_AREA)
        image = np.rint(cv2.GaussianBlur(light, (0, 0), 0.8)).astype(np.uint8)
        return image, FOCAL_PX * seen[:, :2] / seen[:, 2:] + MIDDLE_PX

    return drawn


@pytest.mark.parametrize("radius_m", [0.005, 0.008])
def test_centres_of_tilted_circles_differ_from_those_of_their_ellipses(radius_m, tilted_circles):
    image, centers_px = tilted_circles(radius_m)

    middles = np.linalg.norm(opencv_ellipse_centers(image, 4, 7) - centers_px, axis=1)
    found = np.linalg.norm(find_board(image, BOARD, "tilted").points_px - centers_px, axis=1)

    assert np.median(middles) > 0.08
    assert np.median(found) < 0.2 * np.median(middles)


def test_circles_are_found_in_an_image_a_quarter_as_bright(tilted_circles):
    image, centers_px = tilted_circles(0.006)
    dim = np.rint(image * 0.25).astype(np.uint8)

    found = np.linalg.norm(find_board(dim, BOARD, "dim").points_px - centers_px, axis=1)

    assert np.median(found) < 0.03


def test_noise_makes_circles_no_larger(rng, tilted_circles):
    """Noise of the paper clipped to one side would increase the radius by a hundredth."""
    image, _ = tilted_circles(0.006)
    noisy = np.clip(np.rint(image + 6 * rng.standard_normal(image.shape)), 0, 255).astype(np.uint8)

    radius_m = find_board(noisy, BOARD, "noisy").circle_radius_m

    assert abs(radius_m - find_board(image, BOARD, "clean").circle_radius_m) < 0.003 * 0.006
