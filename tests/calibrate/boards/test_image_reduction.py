"""Positions in reduced images."""

import cv2
import numpy as np
import pytest

from ringpose.calibrate.boards.patterns.chessboard import chessboard_corners
from ringpose.calibrate.boards.patterns.image_patch import in_full_image, reduced, reductions


@pytest.mark.parametrize(
    ("longer", "expected"), [(640, [1]), (2900, [1]), (4000, [2, 1]), (7000, [4, 2]), (15000, [8, 4]), (24000, [12, 6])]
)
def test_large_images_are_searched_in_reduced_form_only(longer, expected):
    assert reductions((longer * 3 // 4, longer)) == expected


@pytest.mark.parametrize("reduction", [1, 2, 3, 7])
def test_points_of_a_reduced_image_are_mapped_to_the_full_image(reduction):
    row, column = np.indices((210, 213), dtype=np.float64)
    image = np.rint(200 * np.exp(-0.5 * ((column - 90.3) ** 2 + (row - 120.8) ** 2) / 40**2)).astype(np.uint8)

    small = reduced(image, reduction).astype(np.float64)

    down, right = np.indices(small.shape)
    place = np.array([(small * right).sum(), (small * down).sum()]) / small.sum()
    rest = image[: small.shape[0] * reduction, : small.shape[1] * reduction].astype(np.float64)
    down, right = np.indices(rest.shape)
    expected = np.array([(rest * right).sum(), (rest * down).sum()]) / rest.sum()
    assert in_full_image(place, reduction) == pytest.approx(expected, abs=0.05)


@pytest.mark.slow
def test_corners_are_as_accurate_in_a_large_image_as_in_a_small_one():
    squares = (np.indices((6, 8)).sum(axis=0) % 2 * 255).astype(np.float32)
    board = np.pad(squares.repeat(300, axis=0).repeat(300, axis=1), 400, constant_values=255.0)
    image = np.rint(cv2.GaussianBlur(0.7 * board + 20, (0, 0), 1.5)).astype(np.uint8)

    found, _ = chessboard_corners(image, 7, 5)

    column, row = np.meshgrid(np.arange(1, 8), np.arange(1, 6))
    expected = 400 + 300 * np.stack([column.ravel(), row.ravel()], axis=1) - 0.5
    assert reductions(image.shape)[0] > 1
    assert np.abs(found - expected).max() < 0.02
