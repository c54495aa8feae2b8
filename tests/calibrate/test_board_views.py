"""Boards drawn from above, and photographs of boards."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from ringpose.calibrate.board_points import corner_points, marker_corners
from ringpose.calibrate.board_views import BoardFailure, NoBoard, find_board
from ringpose.types.board import Board

CHESSBOARD = Board(kind="chessboard", squares_x=10, squares_y=7, square_m=0.025)
CHARUCO = Board(kind="charuco", squares_x=8, squares_y=6, square_m=0.025, marker_m=0.018, dictionary="DICT_5X5_100")
FOUR = Board(kind="four_markers", dictionary="DICT_4X4_50", width_m=0.3, height_m=0.24, marker_m=0.06, margin_m=0.01)
GRID = Board(kind="aruco_grid", squares_x=4, squares_y=3, marker_m=0.04, gap_m=0.01, dictionary="DICT_4X4_50")
BOARDS = {"chessboard": CHESSBOARD, "charuco": CHARUCO, "four_markers": FOUR, "aruco_grid": GRID}
LEGACY = replace(CHARUCO, legacy_pattern=True)


def drawn_px(points_m: np.ndarray) -> np.ndarray:
    """Where the drawing has a point of the board: 2 pixels a millimetre, rim of 40, edges between pixels."""
    return 2000 * points_m[:, :2] + 40 - 0.5


def error_px(found, board: Board) -> float:
    return float(np.abs(found.points_px - drawn_px(corner_points(board)[found.ids])).max())


@pytest.mark.parametrize("board", BOARDS.values(), ids=BOARDS)
def test_all_corners_of_a_drawn_board_are_found_where_they_are(board, drawn_board):
    found = find_board(drawn_board(board), board, "drawn")

    assert len(found.ids) == len(corner_points(board))
    assert error_px(found, board) < 0.1


def test_a_legacy_charuco_board_is_found_as_such(drawn_board):
    found = find_board(drawn_board(LEGACY), LEGACY, "drawn")

    assert error_px(found, LEGACY) < 0.1


def test_a_turned_chessboard_keeps_its_numbers(drawn_board):
    upside_down = drawn_board(CHESSBOARD)[::-1, ::-1].copy()

    found = find_board(upside_down, CHESSBOARD, "turned")

    turned = np.array(upside_down.shape[::-1]) - 1 - found.points_px
    assert np.abs(turned - drawn_px(corner_points(CHESSBOARD))).max() < 0.1


def test_a_sixteen_bit_image_shows_the_same_corners(drawn_board):
    image = drawn_board(CHESSBOARD)

    found = find_board(image.astype(np.uint16) * 16, CHESSBOARD, "deep")

    assert error_px(found, CHESSBOARD) < 0.1


def test_a_marker_half_covered_leaves_the_others(drawn_board):
    image = drawn_board(FOUR)
    image[40:130, 40:110] = 198

    found = find_board(image, FOUR, "covered")

    assert set((found.ids // 4).tolist()) == {1, 2, 3}


@pytest.mark.parametrize("board", BOARDS.values(), ids=BOARDS)
def test_a_black_image_is_too_dark(board):
    found = find_board(np.zeros((480, 640), np.uint8), board, "black")

    assert found.failure is BoardFailure.TOO_DARK


@pytest.mark.parametrize("board", BOARDS.values(), ids=BOARDS)
def test_a_white_image_is_overexposed(board):
    found = find_board(np.full((480, 640), 255, np.uint8), board, "white")

    assert found.failure is BoardFailure.SATURATED


def test_a_chessboard_that_is_cut_off_is_not_whole(drawn_board):
    found = find_board(drawn_board(CHESSBOARD)[:, :300].copy(), CHESSBOARD, "cut")

    assert found.failure is BoardFailure.NOT_WHOLE


def test_a_chessboard_of_another_size_is_not_found(drawn_board):
    found = find_board(drawn_board(CHESSBOARD), replace(CHESSBOARD, squares_x=9), "other size")

    assert found.failure is BoardFailure.NOT_WHOLE


def test_a_blurred_chessboard_is_called_blurred(drawn_board):
    image = cv2.GaussianBlur(drawn_board(CHESSBOARD), (0, 0), 40)

    assert find_board(image, CHESSBOARD, "blurred").failure is BoardFailure.BLURRED


def test_one_marker_of_four_says_one_of_four(drawn_board):
    image = drawn_board(FOUR)
    image[:, 320:] = 198
    image[260:] = 198

    found = find_board(image, FOUR, "one marker")

    assert found.value == "too few of the board's markers found (1 of 4)"


def test_markers_of_another_dictionary_are_not_the_boards(drawn_board):
    found = find_board(drawn_board(FOUR), replace(FOUR, dictionary="DICT_6X6_250"), "other")

    assert isinstance(found, NoBoard)


def test_markers_with_numbers_beyond_the_board_are_those_of_another(drawn_board):
    corner = drawn_board(GRID)[:, 260:].copy()  # markers 3, 7, 11 and 2, 6, 10
    corner[:150] = 198  # leaves 6, 7, 10, 11

    found = find_board(corner, FOUR, "other board")

    assert found.failure is BoardFailure.OTHER_MARKERS


@pytest.mark.parametrize("legacy", [False, True])
@pytest.mark.parametrize("size", [(11, 8), (5, 7), (6, 5), (5, 6)])
def test_charuco_markers_are_where_opencv_prints_them(size, legacy):
    board = replace(CHARUCO, squares_x=size[0], squares_y=size[1], legacy_pattern=legacy)
    pattern = cv2.aruco.CharucoBoard(size, 0.025, 0.018, cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_5X5_100))
    pattern.setLegacyPattern(legacy)

    printed = np.array([np.asarray(corners).reshape(4, 3) for corners in pattern.getObjPoints()])
    assert np.abs(marker_corners(board) - printed).max() < 1e-7


@pytest.mark.parametrize("side", ["left", "right"])
def test_every_stereo_photograph_of_opencv_shows_its_board(side, shared_data):
    photographs = sorted((shared_data / "real" / "opencv_samples_stereo").glob(f"{side}[01]*.jpg"))

    found = [find_board(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), CHESSBOARD, path.stem) for path in photographs]

    assert [view.name for view in found if isinstance(view, NoBoard)] == []
    assert len(found) == 13


def test_a_glaring_stripe_beside_the_board_moves_no_column(shared_data):
    path = shared_data / "real" / "etna_laser_robot" / "calib3" / "frame0001.png"
    board = Board(kind="chessboard", squares_x=8, squares_y=7, square_m=0.01)

    found = find_board(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), board, "glare")

    plane, _ = cv2.findHomography(found.points_board_m[:, :2], found.points_px)
    predicted = cv2.perspectiveTransform(found.points_board_m[None, :, :2], plane)[0]
    assert np.abs(predicted - found.points_px).max() < 3  # the sector-based finder alone: 20


def test_corners_on_rendered_charuco_views_are_within_a_twentieth_of_a_pixel(shared_data, rendered_truth):
    folder = shared_data / "rendered" / "calib_b"
    board = replace(CHARUCO, squares_x=11, squares_y=8)

    errors = np.concatenate(
        [
            found.points_px - rendered_truth(path.stem, found.points_board_m)
            for path in sorted((folder / "camera").glob("*.png"))[:5]
            for found in [find_board(cv2.imread(str(path), cv2.IMREAD_GRAYSCALE), board, path.stem)]
        ]
    )

    assert np.sqrt(np.mean(errors**2)) < 0.03
    assert np.abs(errors).max() < 0.1


def test_marker_corners_on_rendered_views_are_not_drawn_inwards_by_blur(shared_data, rendered_truth):
    paths = sorted((shared_data / "rendered" / "calib_b" / "planes").glob("*.npz"))

    errors = np.concatenate(
        [
            found.points_px - rendered_truth(path.stem, found.points_board_m)
            for path in paths
            for found in [find_board(np.load(path)["images"][0], FOUR, path.stem)]
        ]
    )

    assert np.sqrt(np.mean(errors**2)) < 0.06  # OpenCV's refinement at the corners: 0.12
