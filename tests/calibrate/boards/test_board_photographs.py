"""Corners of boards on photographs and renders, against their reference corners."""

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from drawn_boards import CHARUCO

from ringpose.calibrate.boards.diagnostics import BoardFailure
from ringpose.calibrate.boards.patterns.circles import opencv_ellipse_centers
from ringpose.calibrate.boards.views import find_board
from ringpose.files.boards import read_dictionary
from ringpose.files.images.shots import read_shots
from ringpose.types.board import Board
from ringpose.types.image import board_image


@pytest.mark.slow
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
    storage = cv2.FileStorage(str(folder / f"acircles_corners{number}.dat"), cv2.FILE_STORAGE_READ)

    image = cv2.imread(str(folder / f"acircles{number}.png"), cv2.IMREAD_GRAYSCALE)
    found = opencv_ellipse_centers(image, *SIZES[number], is_asymmetric=True)

    expected = np.asarray(storage.getNode("corners").mat()).reshape(-1, 2)
    assert np.abs(found - expected).max() < 0.01


@pytest.mark.parametrize("number", [1, 3, 5, 7])
def test_chessboards_of_opencvs_photographs_are_where_its_tests_expect_them(number, shared_data):
    folder = shared_data / "real" / "opencv_extra_calib"
    storage = cv2.FileStorage(str(folder / f"chess_corners{number}.dat"), cv2.FILE_STORAGE_READ)
    board = Board(kind="chessboard", squares_x=6, squares_y=8, square_m=0.02)

    found = find_board(cv2.imread(str(folder / f"chess{number}.png"), cv2.IMREAD_GRAYSCALE), board, "chessboard")

    expected = np.asarray(storage.getNode("corners").mat()).reshape(-1, 2)
    nearest = np.linalg.norm(found.points_px[:, None] - expected, axis=2).min(axis=1)
    assert nearest.max() < 0.5


def test_a_board_that_only_the_classic_detector_sees_beside_a_stripe_is_found(shared_data):
    path = shared_data / "real" / "uba_laser_plane" / "color" / "image011.png"
    board = Board(kind="chessboard", squares_x=12, squares_y=8, square_m=0.021167, square_y_m=0.021125)

    found = find_board(np.ascontiguousarray(board_image(read_shots(path)[0])[:600, 320:960]), board, "stripe")

    plane, _ = cv2.findHomography(found.points_board_m[:, :2], found.points_px)
    predicted = cv2.perspectiveTransform(found.points_board_m[None, :, :2], plane)[0]
    assert np.abs(predicted - found.points_px).max() < 2  # with the lens's distortion


@pytest.mark.parametrize("number", ["01", "09"])
@pytest.mark.parametrize("counts", [(9, 7), (10, 6)])
@pytest.mark.slow
def test_part_of_a_chessboard_is_not_taken_for_a_smaller_one(number, counts, shared_data):
    """OpenCV finds 8 x 6 of the 9 x 6 inner corners in 12 of 13 photographs."""
    image = cv2.imread(str(shared_data / "real" / "opencv_samples_stereo" / f"left{number}.jpg"), cv2.IMREAD_GRAYSCALE)
    board = Board(kind="chessboard", squares_x=counts[0], squares_y=counts[1], square_m=0.025)

    missing = find_board(image, board, "smaller")

    assert missing.failure in (BoardFailure.LARGER, BoardFailure.NOT_WHOLE)
    assert number != "01" or missing.finding.startswith("as with 10 x 7 squares")


@pytest.mark.slow
def test_a_bright_stripe_beside_the_board_displaces_no_column(shared_data):
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


@pytest.mark.slow
def test_marker_corners_on_rendered_views_are_not_biased_inwards_by_blur(rendered_plane_views, rendered_truth):
    errors = np.concatenate(
        [found.points_px - rendered_truth(found.name, found.points_board_m) for _, found in rendered_plane_views("*")]
    )

    assert np.sqrt(np.mean(errors**2)) < 0.06  # OpenCV's refinement at the corners: 0.12
