"""Boards drawn from above: their corners are where they were drawn."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from drawn_boards import BOARDS, CHARUCO, CHESSBOARD, FOUR, GRID, drawn_board

from ringpose.calibrate.boards.diagnostics import BoardFailure
from ringpose.calibrate.boards.views import find_board
from ringpose.errors import DataError
from ringpose.geometry.board import corner_points, marker_corners, marker_dictionary
from ringpose.types.board import Board

LEGACY = replace(CHARUCO, legacy_pattern=True)
APRILTAG = replace(GRID, dictionary="DICT_APRILTAG_36h11")


def drawn_px(points_m: np.ndarray) -> np.ndarray:
    """Pixel of a board point in the drawing: 2 pixels a millimetre, a rim of 40, edges between pixels."""
    return 2000 * points_m[:, :2] + 40 - 0.5


def error_px(found, board: Board) -> float:
    return float(np.abs(found.points_px - drawn_px(corner_points(board)[found.ids])).max())


@pytest.mark.parametrize("board", [*BOARDS.values(), LEGACY, APRILTAG])
def test_all_corners_of_a_drawn_board_are_found_at_their_positions(board):
    found = find_board(drawn_board(board), board, "drawn")

    assert len(found.ids) == len(corner_points(board))
    assert error_px(found, board) < 0.1


def test_a_rotated_chessboard_has_the_same_corner_numbers():
    upside_down = drawn_board(CHESSBOARD)[::-1, ::-1].copy()

    found = find_board(upside_down, CHESSBOARD, "turned")

    turned = np.array(upside_down.shape[::-1]) - 1 - found.points_px
    assert np.abs(turned - drawn_px(corner_points(CHESSBOARD))).max() < 0.1


def test_a_sixteen_bit_image_shows_the_same_corners():
    image = drawn_board(CHESSBOARD)

    found = find_board(image.astype(np.uint16) * 16, CHESSBOARD, "deep")

    assert error_px(found, CHESSBOARD) < 0.1


def test_a_half_covered_marker_does_not_affect_the_others():
    image = drawn_board(FOUR)
    image[40:130, 40:110] = 198

    found = find_board(image, FOUR, "covered")

    assert set((found.ids // 4).tolist()) == {1, 2, 3}


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("size", [(11, 8), (5, 7), (6, 5), (5, 6)])
def test_charuco_markers_are_where_opencv_prints_them(size, legacy):
    board = replace(CHARUCO, squares_x=size[0], squares_y=size[1], legacy_pattern=legacy)
    pattern = cv2.aruco.CharucoBoard(size, 0.025, 0.018, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100))
    pattern.setLegacyPattern(legacy)

    printed = np.array([np.asarray(corners).reshape(4, 3) for corners in pattern.getObjPoints()])
    assert np.abs(marker_corners(board) - printed).max() < 1e-7


OWN = ("011010011", "110100110", "101001110", "000101100", "111011100", "100111001")


def test_markers_of_a_custom_dictionary_are_found():
    board = Board(
        kind="aruco_grid", squares_x=3, squares_y=2, marker_m=0.04, gap_m=0.01, dictionary="own.yml", marker_bits=OWN
    )

    found = find_board(drawn_own_markers(board), board, "own")

    assert len(found.ids) == 24
    assert error_px(found, board) < 0.1


def drawn_own_markers(board: Board) -> np.ndarray:
    """Draws markers by the bits of the file (1 is white) in a black border one bit wide; 2 pixels a millimetre."""
    image = np.full((2 * 40 + 180, 2 * 40 + 280), 255, np.uint8)
    for number, (left, top) in enumerate(marker_corners(board)[:, 0, :2]):
        bits = np.pad(np.reshape([int(bit) for bit in board.marker_bits[number]], (3, 3)), 1)
        column, row = round(2000 * left) + 40, round(2000 * top) + 40
        image[row : row + 80, column : column + 80] = np.kron(bits * 255, np.ones((16, 16)))
    return cv2.GaussianBlur(image * 0.7 + 20, (0, 0), 1.0).astype(np.uint8)


def test_the_rows_of_corners_are_spaced_by_the_height_of_the_squares():
    points = corner_points(replace(CHESSBOARD, square_y_m=0.03))

    assert points[0].tolist() == [0.025, 0.03, 0.0]
    assert points[-1] == pytest.approx([9 * 0.025, 6 * 0.03, 0.0])


def test_noise_does_not_push_the_corners_of_markers_outwards(rng):
    """The bright side has more noise than the dark side, which must not displace corners (a fixed error of 0.05 px)."""
    image = drawn_board(FOUR).astype(np.float64)
    outward = []
    for _ in range(3):
        noisy = np.clip(np.rint(image + rng.normal(0, 1, image.shape) * np.sqrt(image) * 0.6), 0, 255).astype(np.uint8)
        view = find_board(noisy, FOUR, "noisy")
        place = view.points_board_m[:, :2] * 2000 + 40 - 0.5
        error = (view.points_px - place).reshape(-1, 4, 2)
        corners = place.reshape(-1, 4, 2)
        away = corners - corners.mean(axis=1, keepdims=True)
        outward.append(np.sum(error * away, axis=2) / np.linalg.norm(away, axis=2))

    assert abs(np.median(outward)) < 0.012


def test_an_image_on_which_opencv_fails_shows_no_board(monkeypatch):
    def failing(*_, **__):
        return cv2.cvtColor(np.zeros((2, 2), np.uint8), cv2.COLOR_BGR2GRAY)  # one channel where three are needed

    monkeypatch.setattr(cv2, "findCirclesGrid", failing)
    circles = Board(kind="asymmetric_circles", squares_x=4, squares_y=11, spacing_m=0.02)

    missing = find_board(drawn_board(CHESSBOARD), circles, "vast")

    assert missing.failure is BoardFailure.GIVEN_UP
    assert missing.finding.startswith("OpenCV fails on its 580 x 430 pixels: ")


@pytest.mark.parametrize(("gain", "share"), [(1.0, 0.0), (2.0, 1.0)])
def test_corners_beside_saturated_paper_are_counted(gain, share):
    image = np.minimum(gain * drawn_board(FOUR), 255.0).astype(np.uint8)

    assert find_board(image, FOUR, "exposed").saturated_share == share


def grid_of(kind: str, squares: int) -> Board:
    return Board(kind=kind, squares_x=squares, squares_y=squares, dictionary="DICT_5X5_50")


@pytest.mark.parametrize(("kind", "squares", "needed"), [("charuco", 11, 60), ("aruco_grid", 8, 64)])
def test_a_dictionary_with_too_few_markers_for_the_board_is_rejected(kind, squares, needed):
    with pytest.raises(DataError, match=f'"DICT_5X5_50" has 50 markers, the board has {needed}; give a larger'):
        marker_dictionary(grid_of(kind, squares))


@pytest.mark.parametrize(("kind", "squares"), [("charuco", 10), ("aruco_grid", 7), ("four_markers", 1000)])
def test_a_dictionary_with_all_markers_of_the_board_is_accepted(kind, squares):
    assert len(marker_dictionary(grid_of(kind, squares)).bytesList) == 50
