"""Boards drawn from above, and photographs of boards."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest

from ringpose.calibrate.board_failures import BoardFailure, NoBoard, edge_width_px
from ringpose.calibrate.board_points import corner_points, marker_corners
from ringpose.calibrate.board_views import find_board
from ringpose.files.dictionaries import read_dictionary
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


@pytest.mark.parametrize("side", ["left", "right", "top", "bottom"])
def test_a_chessboard_that_is_cut_off_is_said_to_be_so(side, drawn_board):
    image = drawn_board(CHESSBOARD)
    kept = {"left": np.s_[:, 190:], "right": np.s_[:, :-190], "top": np.s_[110:], "bottom": np.s_[:-110]}[side]

    found = find_board(image[kept].copy(), CHESSBOARD, "cut")

    assert found.failure is BoardFailure.CUT_OFF
    assert "of 9 x 6 inner corners" in found.found


def test_a_covered_chessboard_says_how_much_is_seen(drawn_board):
    image = drawn_board(CHESSBOARD)
    image[220:340, 300:420] = 120

    found = find_board(image, CHESSBOARD, "covered")

    assert found.failure is BoardFailure.COVERED
    assert len(found.points_px) >= 12


def test_a_chessboard_of_another_size_says_which(drawn_board):
    found = find_board(drawn_board(CHESSBOARD), replace(CHESSBOARD, squares_x=9), "other size")

    assert found.failure is BoardFailure.OTHER_SIZE
    assert found.found.startswith("9 x 6 of 8 x 6 inner corners")


def test_noise_is_no_part_of_a_chessboard(rng):
    found = find_board(rng.integers(0, 255, (480, 640), dtype=np.uint8), CHESSBOARD, "noise")

    assert found.failure is BoardFailure.NOT_WHOLE


def test_an_image_too_blurred_is_called_so_with_its_measure(drawn_board):
    image = cv2.GaussianBlur(drawn_board(CHESSBOARD), (0, 0), 40)

    found = find_board(image, CHESSBOARD, "blurred")

    assert found.failure is BoardFailure.BLURRED
    assert "px wide" in found.found


@pytest.mark.parametrize("sigma_px", [2.0, 4.0, 8.0])
def test_the_width_of_edges_is_that_of_the_blur(sigma_px):
    edge = np.where(np.arange(400) < 200, 40.0, 200.0) * np.ones((400, 1))
    image = cv2.GaussianBlur(edge, (0, 0), sigma_px).astype(np.uint8)

    assert edge_width_px(image) == pytest.approx(np.hypot(sigma_px, 1.0), rel=0.1)


def test_markers_out_of_the_image_are_counted(drawn_board):
    found = find_board(drawn_board(FOUR)[:, :300].copy()[:250], FOUR, "corner")

    assert found.value == "too few of the board's markers found (1 of 4, 3 of the others are outside the image)"


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


def test_markers_of_apriltag_are_found(drawn_board):
    board = replace(GRID, dictionary="DICT_APRILTAG_36h11")

    found = find_board(drawn_board(board), board, "april")

    assert len(found.ids) == 48
    assert error_px(found, board) < 0.1


OWN = ("011010011", "110100110", "101001110", "000101100", "111011100", "100111001")


def test_markers_of_a_dictionary_of_ones_own_are_found(drawn_board):
    board = Board(
        kind="aruco_grid", squares_x=3, squares_y=2, marker_m=0.04, gap_m=0.01, dictionary="own.yml", marker_bits=OWN
    )

    found = find_board(drawn_own_markers(board), board, "own")

    assert len(found.ids) == 24
    assert error_px(found, board) < 0.1


def drawn_own_markers(board: Board) -> np.ndarray:
    """Bits as they stand in the file, 1 white, each in a black border one bit wide; 2 pixels a millimetre."""
    image = np.full((2 * 40 + 180, 2 * 40 + 280), 255, np.uint8)
    for number, (left, top) in enumerate(marker_corners(board)[:, 0, :2]):
        bits = np.pad(np.reshape([int(bit) for bit in board.marker_bits[number]], (3, 3)), 1)
        column, row = round(2000 * left) + 40, round(2000 * top) + 40
        image[row : row + 80, column : column + 80] = np.kron(bits * 255, np.ones((16, 16)))
    return cv2.GaussianBlur(image * 0.7 + 20, (0, 0), 1.0).astype(np.uint8)


def test_every_marker_of_opencvs_grid_photograph_is_found_with_its_own_dictionary(shared_data):
    folder = shared_data / "real" / "opencv_aruco_photos"
    board = Board(
        kind="aruco_grid",
        squares_x=5,
        squares_y=7,
        marker_m=0.04,
        gap_m=0.01,
        dictionary="tutorial_dict.yml",
        marker_bits=read_dictionary(folder / "tutorial_dict.yml"),
    )
    gold = json.loads((folder / "gold_corners.json").read_text())["gboriginal"]

    found = find_board(cv2.imread(str(folder / "gboriginal.jpg"), cv2.IMREAD_GRAYSCALE), board, "grid")

    expected = np.array([gold[str(number // 4)][number % 4] for number in found.ids])
    distance = np.linalg.norm(found.points_px - expected, axis=1)
    assert len(found.ids) == 4 * 35
    assert np.median(distance) < 1.0  # gold corners are whole pixels, unrefined; their own tolerance is 1 px
    assert distance.max() < 2.5


SIZES = {1: (7, 13), 2: (7, 13), 3: (7, 13), 4: (5, 5), 5: (5, 5), 6: (5, 5), 7: (3, 9), 8: (3, 9), 9: (3, 9)}


@pytest.mark.parametrize("number", SIZES)
def test_circles_of_opencvs_photographs_are_where_its_tests_expect_them(number, shared_data):
    folder = shared_data / "real" / "opencv_extra_calib" / "asymmetric_circles"
    columns, rows = SIZES[number]
    board = Board(kind="asymmetric_circles", squares_x=columns, squares_y=rows, spacing_m=0.02)
    storage = cv2.FileStorage(str(folder / f"acircles_corners{number}.dat"), cv2.FILE_STORAGE_READ)

    found = find_board(cv2.imread(str(folder / f"acircles{number}.png"), cv2.IMREAD_GRAYSCALE), board, "circles")

    expected = np.asarray(storage.getNode("corners").mat()).reshape(-1, 2)
    assert np.abs(found.points_px - expected).max() < 0.01


@pytest.mark.parametrize("number", range(1, 8))
def test_chessboards_of_opencvs_photographs_are_where_its_tests_expect_them(number, shared_data):
    folder = shared_data / "real" / "opencv_extra_calib"
    storage = cv2.FileStorage(str(folder / f"chess_corners{number}.dat"), cv2.FILE_STORAGE_READ)
    board = Board(kind="chessboard", squares_x=6, squares_y=8, square_m=0.02)

    found = find_board(cv2.imread(str(folder / f"chess{number}.png"), cv2.IMREAD_GRAYSCALE), board, "chessboard")

    expected = np.asarray(storage.getNode("corners").mat()).reshape(-1, 2)
    nearest = np.linalg.norm(found.points_px[:, None] - expected, axis=2).min(axis=1)
    assert nearest.max() < 0.5


def test_higher_squares_have_their_corners_lower():
    points = corner_points(replace(CHESSBOARD, square_y_m=0.03))

    assert points[0].tolist() == [0.025, 0.03, 0.0]
    assert points[-1] == pytest.approx([9 * 0.025, 6 * 0.03, 0.0])


@pytest.mark.parametrize("side", ["left", pytest.param("right", marks=pytest.mark.slow)])
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


def test_noise_does_not_push_the_corners_of_markers_outwards(rng, drawn_board, plane_board):
    """Noise of the bright side outweighs that of the dark side; corners must not follow it (0.05 px once)."""
    image = drawn_board(plane_board).astype(np.float64)
    outward = []
    for _ in range(6):
        noisy = np.clip(np.rint(image + rng.normal(0, 1, image.shape) * np.sqrt(image) * 0.6), 0, 255).astype(np.uint8)
        view = find_board(noisy, plane_board, "noisy")
        place = view.points_board_m[:, :2] * 2000 + 40 - 0.5
        error = (view.points_px - place).reshape(-1, 4, 2)
        corners = place.reshape(-1, 4, 2)
        away = corners - corners.mean(axis=1, keepdims=True)
        outward.append(np.sum(error * away, axis=2) / np.linalg.norm(away, axis=2))

    assert abs(np.median(outward)) < 0.012
