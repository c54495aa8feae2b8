"""Centres of circles and of ellipses, drawn here point by point."""

import functools
from dataclasses import replace

import cv2
import numpy as np
import pytest
from drawn_boards import CHESSBOARD, drawn_board
from scipy.special import ndtr

from ringpose.calibrate.boards.diagnostics import BoardFailure, NoBoard
from ringpose.calibrate.boards.patterns.circles import opencv_ellipse_centers, refined_ellipse_centers
from ringpose.calibrate.boards.views import find_board
from ringpose.geometry.board import corner_points
from ringpose.types.board import Board

GRID = Board(kind="asymmetric_circles", squares_x=4, squares_y=7, spacing_m=0.02)
FOCAL_PX, PRINCIPAL_PX, SIZE = 900.0, np.array([260.0, 210.0]), (520, 420)
SUBPIXELS = 2


@functools.cache
def tilted_circles(radius_m: float) -> tuple[np.ndarray, np.ndarray]:
    """Draws the grid tilted by 45 degrees at 0.35 m, and returns its projected centres."""
    points = corner_points(GRID)
    turn = cv2.Rodrigues(np.array([0.55, -0.55, 0.1]))[0]
    place = np.array([0.0, 0.0, 0.35]) - turn @ points.mean(axis=0)
    seen = points @ turn.T + place
    pixels = (np.stack(np.meshgrid(*(np.arange(n * SUBPIXELS) for n in SIZE)), -1) + 0.5) / SUBPIXELS - 0.5
    rays = np.concatenate([(pixels - PRINCIPAL_PX) / FOCAL_PX, np.ones((*pixels.shape[:2], 1))], axis=-1)
    depth = (turn[:, 2] @ place) / (rays @ turn[:, 2])
    on_board = (rays * depth[..., None] - place) @ turn[:, :2]
    row = np.clip(np.rint(on_board[..., 1] / 0.02 - 1), 0, 6)
    column = np.clip(np.rint((on_board[..., 0] / 0.02 - 1 - row % 2) / 2), 0, 3)
    nearest = 0.02 * np.stack([2 * column + row % 2 + 1, row + 1], axis=-1)
    dark = np.hypot(*np.moveaxis(on_board - nearest, -1, 0)) < radius_m
    light = cv2.resize(np.where(dark, 30.0, 220.0), SIZE, interpolation=cv2.INTER_AREA)
    image = np.rint(cv2.GaussianBlur(light, (0, 0), 0.8)).astype(np.uint8)
    return image, FOCAL_PX * seen[:, :2] / seen[:, 2:] + PRINCIPAL_PX


@pytest.mark.parametrize("radius_m", [0.006, pytest.param(0.008, marks=pytest.mark.slow)])
def test_centres_of_tilted_circles_differ_from_those_of_their_ellipses(radius_m):
    image, centers_px = tilted_circles(radius_m)

    middles = np.linalg.norm(opencv_ellipse_centers(image, 4, 7, is_asymmetric=True) - centers_px, axis=1)
    found = np.linalg.norm(find_board(image, GRID, "tilted").points_px - centers_px, axis=1)

    assert np.median(middles) > 0.08
    assert np.median(found) < 0.2 * np.median(middles)


def test_circles_are_found_in_an_image_a_quarter_as_bright():
    image, centers_px = tilted_circles(0.006)
    dim = np.rint(image * 0.25).astype(np.uint8)

    found = np.linalg.norm(find_board(dim, GRID, "dim").points_px - centers_px, axis=1)

    assert np.median(found) < 0.03


@pytest.mark.parametrize("counts", [(3, 7), pytest.param((4, 5), marks=pytest.mark.slow), (4, 6)])
def test_part_of_a_larger_grid_is_not_taken_for_the_board(counts):
    """Its circles could be any of the larger grid; the distances would be right and the board's frame wrong."""
    image, _ = tilted_circles(0.006)

    found = find_board(image, replace(GRID, squares_x=counts[0], squares_y=counts[1]), "part")

    assert found.failure is BoardFailure.LARGER
    assert found.finding == "as with kind: asymmetric_circles, squares_x: 4, squares_y: 7"


def test_squares_of_a_chessboard_are_no_grid_of_circles():
    board = Board(kind="symmetric_circles", squares_x=4, squares_y=4, spacing_m=0.02)

    assert isinstance(find_board(drawn_board(CHESSBOARD), board, "chessboard"), NoBoard)


def test_noise_makes_circles_no_larger(rng):
    """Noise of the paper clipped to one side would increase the radius by a hundredth."""
    image, _ = tilted_circles(0.006)
    noisy = np.clip(np.rint(image + 6 * rng.standard_normal(image.shape)), 0, 255).astype(np.uint8)

    radius_m = find_board(noisy, GRID, "noisy").circle_radius_m

    assert abs(radius_m - find_board(image, GRID, "clean").circle_radius_m) < 0.003 * 0.006


MIDDLE_PX = np.array([40.37, 38.81])
BLUR_PX = 1.1


def conic(axes_px: tuple[float, float], middle_px: np.ndarray) -> np.ndarray:
    moved = np.eye(3)
    moved[:2, 2] = -middle_px
    return moved.T @ np.diag([axes_px[0] ** -2, axes_px[1] ** -2, -1.0]) @ moved


def lit_ellipse(axes_px: tuple[float, float], slope: tuple[float, float]) -> np.ndarray:
    """Draws an ellipse of ink on paper, eight by eight points a pixel; the brightness changes by `slope` a pixel."""
    fine = (np.arange(80 * 8) + 0.5) / 8 - 0.5
    row, column = np.meshgrid(fine, fine, indexing="ij")
    x, y = (column - MIDDLE_PX[0]) / axes_px[0], (row - MIDDLE_PX[1]) / axes_px[1]
    size = np.hypot(x, y)
    outside = (size - 1) * size / np.hypot(x / axes_px[0], y / axes_px[1])
    light = 1 + slope[0] * (column - 40) + slope[1] * (row - 40)
    seen = (30 + 150 * ndtr(outside / BLUR_PX)) * light
    return np.rint(seen.reshape(80, 8, 80, 8).mean(axis=(1, 3))).astype(np.uint8)


@pytest.mark.parametrize("axes_px", [(14.0, 14.0), (12.0, 8.0), (5.0, 4.0)])
@pytest.mark.parametrize("slope", [(0.0, 0.0), (0.002, -0.001)])
def test_ellipse_centres_are_not_biased_by_a_brightness_gradient(axes_px, slope):
    image, start = lit_ellipse(axes_px, slope), MIDDLE_PX + np.array([0.15, -0.2])

    for _ in range(2):
        (start,) = refined_ellipse_centers(image, start[None], conic(axes_px, start)[None])

    assert np.abs(start - MIDDLE_PX).max() < 0.015


@pytest.mark.parametrize(("place", "contrast"), [((3.0, 3.0), True), ((40.0, 40.0), False)])
def test_an_ellipse_at_the_rim_of_the_image_or_without_contrast_is_unchanged(place, contrast):
    image = lit_ellipse((10.0, 10.0), (0.0, 0.0)) if contrast else np.full((80, 80), 90, np.uint8)
    start = np.array([place])

    found = refined_ellipse_centers(image, start, conic((10.0, 10.0), start[0])[None])

    assert found.tolist() == start.tolist()
