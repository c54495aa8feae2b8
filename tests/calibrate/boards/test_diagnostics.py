"""Reasons why an image shows no board."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from drawn_boards import BOARDS, CHARUCO, CHESSBOARD, FOUR, GRID

from ringpose.calibrate.boards.diagnostics import BoardFailure, NoBoard, charuco_failure, edge_width_px
from ringpose.calibrate.boards.patterns.markers import find_markers, marker_dictionary
from ringpose.calibrate.boards.views import find_board


@pytest.mark.parametrize("board", BOARDS.values(), ids=BOARDS)
def test_a_black_image_is_reported_as_too_dark(board):
    found = find_board(np.zeros((480, 640), np.uint8), board, "black")

    assert found.failure is BoardFailure.TOO_DARK


@pytest.mark.parametrize("board", BOARDS.values(), ids=BOARDS)
def test_a_white_image_is_reported_as_overexposed(board):
    found = find_board(np.full((480, 640), 255, np.uint8), board, "white")

    assert found.failure is BoardFailure.SATURATED


def test_the_number_of_corners_seen_of_a_chessboard_that_is_cut_off_is_reported(drawn_board):
    found = find_board(drawn_board(CHESSBOARD)[:, 190:].copy(), CHESSBOARD, "cut")

    assert found.failure is BoardFailure.NOT_WHOLE
    assert found.found.startswith("6 x 6 of 9 x 6 inner corners")


def test_the_number_of_corners_seen_of_a_covered_chessboard_is_reported(drawn_board):
    image = drawn_board(CHESSBOARD)
    image[220:340, 300:420] = 120

    found = find_board(image, CHESSBOARD, "covered")

    assert found.failure is BoardFailure.NOT_WHOLE
    assert len(found.points_px) >= 12


def test_the_size_of_another_chessboard_is_reported(drawn_board):
    found = find_board(drawn_board(CHESSBOARD), replace(CHESSBOARD, squares_x=9), "other size")

    assert found.failure is BoardFailure.OTHER_SIZE
    assert found.found.startswith("9 x 6 of 8 x 6 inner corners")


def test_noise_is_no_part_of_a_chessboard(rng):
    found = find_board(rng.integers(0, 255, (240, 320), dtype=np.uint8), CHESSBOARD, "noise")

    assert found.failure is BoardFailure.NOT_WHOLE


def test_a_blurred_image_is_reported_with_the_width_of_its_edges(drawn_board):
    image = cv2.GaussianBlur(drawn_board(CHESSBOARD), (0, 0), 40)

    found = find_board(image, CHESSBOARD, "blurred")

    assert found.failure is BoardFailure.BLURRED
    assert "px wide" in found.found


@pytest.mark.parametrize(("blur_px", "reason"), [(2.5, BoardFailure.BLURRED), (0.7, BoardFailure.FEW_CORNERS)])
def test_blur_is_reported_only_if_it_is_wide_against_the_markers_cells(blur_px, reason, drawn_board):
    """The cells of the markers are 4.6 pixels wide."""
    image = drawn_board(CHARUCO)
    markers = find_markers(image, marker_dictionary(CHARUCO))

    found = charuco_failure(cv2.GaussianBlur(image, (0, 0), blur_px), CHARUCO, 3, markers)

    assert found.failure is reason
    assert found.found.endswith("3 corners, 24 of 24 markers")


def test_blurred_markers_are_not_reported_as_mirrored(drawn_board):
    found = find_board(cv2.GaussianBlur(drawn_board(CHARUCO), (0, 0), 4.5), CHARUCO, "blurred")

    assert found.failure is BoardFailure.FEW_MARKERS
    assert found.found.endswith(": blurred")


@pytest.mark.parametrize("sigma_px", [2.0, 4.0, 8.0])
def test_the_edge_width_is_the_standard_deviation_of_the_blur(sigma_px):
    edge = np.where(np.arange(400) < 200, 40.0, 200.0) * np.ones((400, 1))
    image = cv2.GaussianBlur(edge, (0, 0), sigma_px).astype(np.uint8)

    assert edge_width_px(image) == pytest.approx(np.hypot(sigma_px, 1.0), rel=0.1)


def test_markers_outside_the_image_are_counted(drawn_board):
    found = find_board(drawn_board(FOUR)[:, :300].copy()[:250], FOUR, "corner")

    assert found.value == "too few of the board's markers found (1 of 4, 3 of the others are outside the image)"


def test_one_found_marker_is_reported_as_one_of_four(drawn_board):
    image = drawn_board(FOUR)
    image[:, 320:] = 198
    image[260:] = 198

    found = find_board(image, FOUR, "one marker")

    assert found.value == "too few of the board's markers found (1 of 4)"


def test_markers_of_another_dictionary_are_reported_as_other_markers(drawn_board):
    found = find_board(drawn_board(FOUR), replace(FOUR, dictionary="DICT_6X6_250"), "other")

    assert isinstance(found, NoBoard)


def test_markers_with_numbers_beyond_the_board_are_reported_as_other_markers(drawn_board):
    corner = drawn_board(GRID).copy()
    corner[:125] = 198  # leaves 3, 4, 5
    corner[:, :125] = 198  # leaves 4, 5

    found = find_board(corner, FOUR, "other board")

    assert found.failure is BoardFailure.OTHER_MARKERS


@pytest.mark.parametrize("board", BOARDS.values(), ids=BOARDS)
@pytest.mark.parametrize("shape", [(1, 1), (14, 300), (300, 14)])
def test_an_image_of_a_few_pixels_is_reported_as_too_small(shape, board):
    found = find_board(np.full(shape, 90, np.uint8), board, "tiny")

    assert found.value == f"the image is too small ({shape[1]} x {shape[0]} pixels)"


TURNED = {
    "squares_x": replace(CHARUCO, squares_x=9),
    "swapped": replace(CHARUCO, squares_x=6, squares_y=8),
    "legacy": replace(CHARUCO, legacy_pattern=True),
}


@pytest.mark.parametrize("board", TURNED.values(), ids=TURNED)
def test_the_layout_of_another_charuco_board_is_reported(board, drawn_board):
    found = find_board(drawn_board(CHARUCO), board, "other")

    assert found.failure is BoardFailure.OTHER_LAYOUT
    assert "squares_x: 8" in found.found
    assert "legacy_pattern: false" in found.found


def test_the_layout_of_another_marker_grid_is_reported(drawn_board):
    found = find_board(drawn_board(GRID), replace(GRID, squares_x=2, squares_y=3), "swapped")

    assert found.value == (
        "the markers do not lie as on the board of the board file (but as with squares_x: 3, squares_y: 2)"
    )


@pytest.mark.parametrize("board", [FOUR, CHARUCO], ids=lambda board: board.kind)
def test_a_mirrored_image_of_markers_is_reported(board, drawn_board):
    found = find_board(np.ascontiguousarray(drawn_board(board)[:, ::-1]), board, "mirrored")

    assert found.failure is BoardFailure.MIRRORED


@pytest.mark.parametrize("board", [replace(FOUR, dictionary="DICT_7X7_50"), CHESSBOARD], ids=lambda board: board.kind)
def test_the_dictionary_of_other_markers_is_reported(board, drawn_board):
    found = find_board(drawn_board(GRID), board, "family")

    assert found.failure is BoardFailure.OTHER_MARKERS
    assert found.found.startswith(GRID.dictionary[:8])
