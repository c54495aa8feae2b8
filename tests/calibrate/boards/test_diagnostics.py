"""Reasons why an image shows no board."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from drawn_boards import BOARDS, CHARUCO, CHESSBOARD, FOUR, GRID, drawn_board

from ringpose.calibrate.boards.diagnostics import BoardFailure, charuco_failure, edge_width_px
from ringpose.calibrate.boards.patterns.markers import find_markers
from ringpose.calibrate.boards.views import find_board
from ringpose.geometry.board import marker_dictionary
from ringpose.types.board import Board


@pytest.mark.parametrize("board", BOARDS.values(), ids=BOARDS)
@pytest.mark.parametrize(
    ("image", "failure", "found"),
    [
        (np.zeros((480, 640), np.uint8), BoardFailure.TOO_DARK, "99 % of the pixels"),
        (np.full((480, 640), 255, np.uint8), BoardFailure.SATURATED, "100 % of the pixels"),
        (np.full((1, 1), 90, np.uint8), BoardFailure.TOO_SMALL, "1 x 1 pixels"),
        (np.full((14, 300), 90, np.uint8), BoardFailure.TOO_SMALL, "300 x 14 pixels"),
        (np.full((300, 14), 90, np.uint8), BoardFailure.TOO_SMALL, "14 x 300 pixels"),
    ],
    ids=["black", "white", "one pixel", "low", "narrow"],
)
def test_an_image_that_cannot_show_a_board_is_reported(image, failure, found, board):
    missing = find_board(image, board, "x")

    assert missing.failure is failure
    assert missing.finding.startswith(found)


def covered(image: np.ndarray, rows: slice, columns: slice, grey: int) -> np.ndarray:
    """The image with one grey value in these rows and columns."""
    image = image.copy()
    image[rows, columns] = grey
    return image


def blurred(image: np.ndarray, sigma_px: float) -> np.ndarray:
    return cv2.GaussianBlur(image, (0, 0), sigma_px)


ALL = slice(None)
KINDS = {
    "chessboard cut off": (CHESSBOARD, lambda image: image[:, 190:], BoardFailure.NOT_WHOLE, "6 x 6 of 9 x 6 inner"),
    "chessboard covered": (
        CHESSBOARD,
        lambda image: covered(image, slice(220, 340), slice(300, 420), 120),
        BoardFailure.NOT_WHOLE,
        "",
    ),
    "chessboard blurred": (CHESSBOARD, lambda image: blurred(image, 40), BoardFailure.BLURRED, "edges are "),
    "markers blurred": (CHARUCO, lambda image: blurred(image, 4.5), BoardFailure.FEW_MARKERS, "0 of 24, edges are "),
    "markers outside": (
        FOUR,
        lambda image: image[:250, :300],
        BoardFailure.FEW_MARKERS,
        "1 of 4, 3 of the others are outside the image",
    ),
    "markers covered": (
        FOUR,
        lambda image: covered(covered(image, ALL, slice(320, None), 198), slice(260, None), ALL, 198),
        BoardFailure.FEW_MARKERS,
        "1 of 4",
    ),
    "markers mirrored": (FOUR, lambda image: image[:, ::-1], BoardFailure.MIRRORED, ""),
    "corners mirrored": (CHARUCO, lambda image: image[:, ::-1], BoardFailure.MIRRORED, ""),
}


@pytest.mark.parametrize(("board", "changed", "failure", "found"), KINDS.values(), ids=KINDS)
def test_what_is_wrong_with_the_image_of_a_board_is_reported(board, changed, failure, found):
    missing = find_board(np.ascontiguousarray(changed(drawn_board(board))), board, "x")

    assert missing.failure is failure
    assert missing.finding.startswith(found)
    assert failure is not BoardFailure.NOT_WHOLE or len(missing.points_px) >= 12


OF_CHARUCO, OF_GRID = "squares_x: 8, squares_y: 6, legacy_pattern: false", "squares_x: 3, squares_y: 2"
OTHERS = [
    (CHESSBOARD, replace(CHESSBOARD, squares_x=9), BoardFailure.LARGER, "as with 10 x 7 squares: 9 x 6 of 8 x 6 inner"),
    pytest.param(
        CHESSBOARD,
        replace(CHESSBOARD, squares_x=8, squares_y=8),
        BoardFailure.OTHER_SIZE,
        "9 x 6 of 7 x 7 inner",
        marks=pytest.mark.slow,
    ),
    (FOUR, replace(FOUR, dictionary="DICT_6X6_250"), BoardFailure.OTHER_MARKERS, FOUR.dictionary[:8]),
    (GRID, replace(FOUR, dictionary="DICT_7X7_50"), BoardFailure.OTHER_MARKERS, GRID.dictionary[:8]),
    (GRID, CHESSBOARD, BoardFailure.OTHER_MARKERS, GRID.dictionary[:8]),
    (CHARUCO, replace(CHARUCO, squares_x=9), BoardFailure.OTHER_LAYOUT, f"but as with {OF_CHARUCO}"),
    (CHARUCO, replace(CHARUCO, squares_x=6, squares_y=8), BoardFailure.OTHER_LAYOUT, f"but as with {OF_CHARUCO}"),
    (CHARUCO, replace(CHARUCO, legacy_pattern=True), BoardFailure.OTHER_LAYOUT, f"but as with {OF_CHARUCO}"),
    (GRID, replace(GRID, squares_x=2, squares_y=3), BoardFailure.OTHER_LAYOUT, f"but as with {OF_GRID}"),
]


@pytest.mark.parametrize(("drawn", "board", "failure", "found"), OTHERS)
def test_an_image_of_another_board_is_reported(drawn, board, failure, found):
    missing = find_board(drawn_board(drawn), board, "other")

    assert missing.failure is failure
    assert missing.finding.startswith(found)


CIRCLES = Board(kind="asymmetric_circles", squares_x=4, squares_y=11, spacing_m=0.02)


def drawn_circles(columns: int, rows: int, white: int) -> np.ndarray:
    """Every second row half a step to the right, 40 pixels a step of the rows."""
    image = np.full((40 * rows + 40, 80 * columns + 80), white, np.uint8)
    for row, column in np.ndindex(rows, columns):
        cv2.circle(image, (80 * column + 40 * (row % 2) + 50, 40 * row + 40), 14, 20, -1)
    return image


@pytest.mark.parametrize(
    ("image", "numbers", "width"),
    [
        (drawn_circles(5, 9, 255), {45}, ""),
        (drawn_circles(4, 11, 200)[:, :210], range(20, 26), ""),
        (drawn_circles(4, 11, 200)[:250], range(20, 26), ""),
    ],
    ids=["another grid", "columns cut off", "rows cut off"],
)
def test_the_number_of_circles_is_reported(image, numbers, width):
    found = find_board(np.ascontiguousarray(image), CIRCLES, "x")

    number, text = found.finding.split(maxsplit=1)
    assert found.failure is BoardFailure.NOT_WHOLE
    assert int(number) in numbers
    assert text.startswith(f"circles are seen, the board has 4 x 11 = 44{width}")


EVEN = replace(CIRCLES, squares_y=10)
"""In a mirror, an even number of rows cannot be turned into the board itself."""


@pytest.mark.parametrize("turns", [0, 1])
def test_circles_in_an_even_number_of_rows_are_found_in_their_order(turns):
    found = find_board(np.ascontiguousarray(np.rot90(drawn_circles(4, 10, 200), turns)), EVEN, "x")

    in_image, _ = cv2.findHomography(found.points_board_m[:, :2], found.points_px)
    expected = cv2.perspectiveTransform(found.points_board_m[None, :, :2], in_image)[0]
    assert np.abs(found.points_px - expected).max() < 0.05
    assert np.linalg.det(in_image) > 0


def test_a_mirrored_grid_of_circles_is_reported():
    mirrored = np.ascontiguousarray(drawn_circles(4, 10, 200)[:, ::-1])

    assert find_board(mirrored, EVEN, "x").failure is BoardFailure.MIRRORED


def test_another_arrangement_of_as_many_circles_is_reported():
    square = np.full((440, 480), 200, np.uint8)
    for row, column in np.ndindex(5, 6):
        cv2.circle(square, (70 * column + 60, 70 * row + 60), 20, 20, -1)

    missing = find_board(square, replace(CIRCLES, squares_x=6, squares_y=5), "x")

    assert missing.failure is BoardFailure.OTHER_SIZE
    assert missing.finding == "as with kind: symmetric_circles, squares_x: 6, squares_y: 5"


def test_all_circles_without_their_rows_are_not_reported_as_missing(rng):
    scattered = np.full((480, 640), 200, np.uint8)
    for place in rng.permutation(np.argwhere(np.ones((7, 9))))[:44]:
        row, column = 60 * place + 50 + rng.integers(-12, 13, 2)
        cv2.circle(scattered, (int(column), int(row)), 12, 20, -1)

    finding = find_board(scattered, CIRCLES, "x").finding

    assert finding.startswith("44 circles are seen, as many as the board has, but not in its 11 rows")


@pytest.mark.parametrize("board", [GRID, CHARUCO, FOUR], ids=lambda board: board.kind)
def test_two_boards_of_the_same_print_in_one_view_are_named(board):
    image = drawn_board(board)
    missing = find_board(np.ascontiguousarray(np.hstack([image, image])), board, "two")

    assert missing.failure is BoardFailure.TWICE
    assert len(missing.points_px) >= 8


def test_markers_with_numbers_beyond_the_board_are_reported_as_other_markers():
    corner = covered(covered(drawn_board(GRID), slice(125), ALL, 198), ALL, slice(125), 198)  # leaves 4, 5

    assert find_board(corner, FOUR, "other board").failure is BoardFailure.OTHER_MARKERS


def test_smooth_clutter_is_not_part_of_a_chessboard(rng):
    clutter = cv2.GaussianBlur(rng.integers(0, 255, (240, 320), dtype=np.uint8), (0, 0), 2)

    found = find_board(cv2.normalize(clutter, None, 0, 255, cv2.NORM_MINMAX), CHESSBOARD, "clutter")

    assert found.failure is BoardFailure.NOT_WHOLE


def noisy(mean: float, sigma: float) -> np.ndarray:
    """An image of 1.2 megapixels of noise."""
    return np.clip(np.random.default_rng(3).normal(mean, sigma, (960, 1280)), 0, 255).astype(np.uint8)


_PATTERNS = ("findChessboardCorners", "findChessboardCornersSB", "findChessboardCornersSBWithMeta", "findCirclesGrid")
SEARCHES = [*((cv2, name) for name in _PATTERNS), (cv2.aruco, "ArucoDetector"), (cv2.aruco, "CharucoDetector")]


@pytest.mark.parametrize("board", [*BOARDS.values(), CIRCLES], ids=[*BOARDS, "circles"])
@pytest.mark.parametrize(
    ("image", "failure"),
    [
        (noisy(3, 2.5), BoardFailure.TOO_DARK),
        (noisy(265, 10), BoardFailure.SATURATED),
        (noisy(120, 30), BoardFailure.NO_CONTRAST),
        (np.full((960, 1280), 128, np.uint8), BoardFailure.NO_CONTRAST),
    ],
    ids=["dark", "overexposed", "noise", "even"],
)
def test_no_board_is_searched_in_an_image_without_contrast(monkeypatch, image, failure, board):
    for module, name in SEARCHES:
        monkeypatch.setattr(module, name, None)

    assert find_board(image, board, "x").failure is failure


@pytest.mark.parametrize("board", [CHESSBOARD, CIRCLES], ids=["chessboard", "circles"])
def test_no_board_is_searched_in_an_image_that_is_blurred_beyond_its_squares(monkeypatch, board):
    for module, name in SEARCHES:
        monkeypatch.setattr(module, name, None)

    found = find_board(blurred(drawn_board(CHESSBOARD), 60), board, "x")

    assert found.failure is BoardFailure.BLURRED


def test_a_board_in_the_dark_is_found_if_it_has_contrast():
    dim = np.rint(drawn_board(CHESSBOARD) * 0.1).astype(np.uint8)

    assert len(find_board(dim, CHESSBOARD, "dim").ids) == 54


def test_the_quick_search_sees_only_clutter_where_the_thorough_ones_would_take_seconds(monkeypatch):
    monkeypatch.setattr(cv2, "findChessboardCornersSB", None)
    walls = np.kron(np.random.default_rng(5).integers(30, 220, (24, 32)), np.ones((40, 40))).astype(np.uint8)

    assert find_board(blurred(walls, 1.5), CHESSBOARD, "walls").failure is BoardFailure.NOT_WHOLE


@pytest.mark.parametrize(
    ("scale", "blur_px", "reason"),
    [
        (1, 2.5, BoardFailure.BLURRED),
        (1, 0.7, BoardFailure.FEW_CORNERS),
        (2, 3.3, BoardFailure.BLURRED),
        (2, 2.5, BoardFailure.FEW_CORNERS),  # nearly all markers are still decoded
    ],
)
def test_blur_is_reported_only_if_it_is_wide_against_the_markers_cells(scale, blur_px, reason):
    """The cells of the markers are 5.1 pixels wide, times the scale."""
    image = cv2.resize(drawn_board(CHARUCO), None, fx=scale, fy=scale, interpolation=cv2.INTER_CUBIC)
    markers = find_markers(image, marker_dictionary(CHARUCO))

    found = charuco_failure(cv2.GaussianBlur(image, (0, 0), blur_px), CHARUCO, 3, markers)

    assert found.failure is reason
    assert found.finding.endswith("3 corners, 24 of 24 markers")


@pytest.mark.parametrize("sigma_px", [2.0, 4.0, 8.0])
def test_the_edge_width_is_the_standard_deviation_of_the_blur(sigma_px):
    edge = np.where(np.arange(400) < 200, 40.0, 200.0) * np.ones((400, 1))
    image = cv2.GaussianBlur(edge, (0, 0), sigma_px).astype(np.uint8)

    assert edge_width_px(image) == pytest.approx(np.hypot(sigma_px, 1.0), rel=0.1)
