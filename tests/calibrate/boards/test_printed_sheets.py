"""Photographs of whole sheets as `--print-board` lays them out: with rulers, their numbers and a label, on a table."""

import functools
from dataclasses import replace

import cv2
import numpy as np
import pytest
from drawn_scene import exposed, noise

from ringpose.calibrate.boards.diagnostics import BoardFailure
from ringpose.calibrate.boards.views import find_board
from ringpose.geometry.board import corner_points
from ringpose.report.board_print import board_drawing
from ringpose.types.board import Board, BoardMarker

SHEET_PX = 1800
"""Longer side of the drawn sheet, from which photographs are sampled."""

MAP = tuple(
    BoardMarker(id=number, corners_m=((x, y), (x + side, y), (x + side, y + side), (x, y + side)))
    for number, x, y, side in ((7, 0.0, 0.0, 0.08), (3, 0.17, 0.1, 0.05), (9, 0.02, 0.12, 0.04), (21, 0.15, 0.0, 0.06))
)
BOARDS = {
    "charuco": Board(
        kind="charuco", squares_x=9, squares_y=6, square_m=0.027, marker_m=0.02, dictionary="DICT_5X5_100"
    ),
    "chessboard": Board(kind="chessboard", squares_x=10, squares_y=7, square_m=0.025),
    "four_markers": Board(
        kind="four_markers", width_m=0.25, height_m=0.165, marker_m=0.045, margin_m=0.005, dictionary="DICT_4X4_50"
    ),
    "aruco_grid": Board(
        kind="aruco_grid", squares_x=6, squares_y=4, marker_m=0.032, gap_m=0.008, dictionary="DICT_4X4_50"
    ),
    "marker_map": Board(kind="marker_map", dictionary="DICT_4X4_50", markers=MAP),
    "aprilgrid": Board(
        kind="aprilgrid", squares_x=5, squares_y=4, marker_m=0.034, gap_m=0.01, dictionary="DICT_APRILTAG_36h11"
    ),
    "separate_squares": Board(kind="separate_squares", squares_x=8, squares_y=6, square_m=0.018, gap_m=0.012),
    "asymmetric_circles": Board(kind="asymmetric_circles", squares_x=4, squares_y=11, spacing_m=0.02),
    "symmetric_circles": Board(kind="symmetric_circles", squares_x=9, squares_y=7, spacing_m=0.025),
}
LARGE_CIRCLES = {
    "A4 portrait": Board(kind="asymmetric_circles", squares_x=3, squares_y=9, spacing_m=0.025),
    "A2 portrait": Board(kind="asymmetric_circles", squares_x=4, squares_y=11, spacing_m=0.04),
}

CORNERS = {
    "near, from the right": ((0.05, 0.1), (0.8, 0.02), (0.75, 0.99), (0.1, 0.9)),
    "from above": ((0.03, 0.04), (0.97, 0.04), (0.97, 0.96), (0.03, 0.96)),
    "far, from below": ((0.35, 0.25), (0.66, 0.27), (0.73, 0.67), (0.28, 0.64)),
    "far, upside down": ((0.7, 0.72), (0.27, 0.7), (0.3, 0.33), (0.72, 0.3)),
}
"""Where a sheet's corners are, clockwise from its top left, as shares of the image."""


@functools.cache
def drawn_sheet(board: Board) -> tuple[np.ndarray, float]:
    """The sheet as it is printed, and its pixels per metre."""
    drawing = board_drawing(board)
    scale = SHEET_PX / max(drawing.width_m, drawing.height_m)
    sheet = np.full((round(scale * drawing.height_m), round(scale * drawing.width_m)), 255, np.uint8)
    for x, y, width, height in np.rint(scale * drawing.rectangles_m).astype(int).tolist():
        sheet[y : y + height, x : x + max(width, 1)] = 0
    for x, y, radius in np.rint(16 * (scale * drawing.circles_m - [0.5, 0.5, 0.0])).astype(int).tolist():
        cv2.circle(sheet, (x, y), radius, 0, -1, cv2.LINE_AA, 4)
    for label in drawing.labels:
        height = label.height_m * scale * 0.7 / 21  # 21 pixels is the height of OpenCV's capital letters
        at = (round(scale * label.x_m), round(scale * label.y_m))
        cv2.putText(sheet, label.text, at, cv2.FONT_HERSHEY_SIMPLEX, height, 0, max(round(4 * height), 1), cv2.LINE_AA)
    return sheet, scale


def photograph(board: Board, view: str, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """The sheet on a table, its longer side along that of the image, and its corners in the image."""
    sheet, scale = drawn_sheet(board)
    drawing = board_drawing(board)
    height, width = sheet.shape
    size = (1200, 860) if width > height else (860, 1200)
    quadrangle = np.array(CORNERS[view], dtype=np.float32) * np.float32(size)
    corners = np.array([[0, 0], [width, 0], [width, height], [0, height]], dtype=np.float32) - np.float32(0.5)
    image_from_sheet = cv2.getPerspectiveTransform(corners, quadrangle)
    reduction = float(np.sqrt(width * height / max(abs(cv2.contourArea(quadrangle)), 1.0)))
    soft = cv2.GaussianBlur(sheet, (0, 0), 0.8 * reduction)
    image = cv2.warpPerspective(soft, image_from_sheet, size, borderValue=71)
    noisy = exposed(30.0 + np.float32(0.7) * image + np.float32(1.5) * noise(image.shape, rng))
    points = (corner_points(board)[:, :2] + drawing.origin_m) * scale - 0.5
    return noisy, cv2.perspectiveTransform(points[None], image_from_sheet)[0]


QUICK = ("charuco", "four_markers", "marker_map", "aprilgrid", "asymmetric_circles", "symmetric_circles")
SHEETS = [
    pytest.param(kind, view, marks=() if kind in QUICK and not number else pytest.mark.slow)
    for kind in BOARDS
    for number, view in enumerate(CORNERS)
]


@pytest.mark.parametrize(("kind", "view"), SHEETS)
def test_the_board_of_every_printed_sheet_is_found(kind, view, rng):
    board = BOARDS[kind]
    image, expected_px = photograph(board, view, rng)

    found = find_board(image, board, view)

    # separate squares and symmetric circles have other numbers upside down
    distance_px = np.linalg.norm(found.points_px[:, None] - expected_px, axis=2)
    is_symmetric = board.kind in ("separate_squares", "symmetric_circles")
    own_px = distance_px.min(axis=1) if is_symmetric else distance_px[np.arange(len(found.ids)), found.ids]
    # of boards with markers, a part is sufficient
    assert len(found.ids) == len(expected_px) or (board.dictionary and len(found.ids) > 0.8 * len(expected_px))
    assert own_px.max() < 1.0


@pytest.mark.parametrize("board", LARGE_CIRCLES.values(), ids=LARGE_CIRCLES)
def test_zeros_of_the_rulers_are_no_circles_of_the_board(board, rng):
    image, expected_px = photograph(board, "near, from the right", rng)

    found = find_board(image, board, "sheet")

    assert np.linalg.norm(found.points_px - expected_px, axis=1).max() < 0.3


MIRRORED = {
    **{kind: board for kind, board in BOARDS.items() if board.dictionary},
    "aruco_grid of 1000 markers": replace(BOARDS["aruco_grid"], dictionary="DICT_4X4_1000"),
    "aruco_grid of the first dictionary": replace(BOARDS["aruco_grid"], dictionary="DICT_ARUCO_ORIGINAL"),
    "asymmetric_circles in an even number of rows": replace(BOARDS["asymmetric_circles"], squares_y=10),
}
"""Two or three of the grids' markers pass for others of the board in a mirror."""


MIRRORED_ELSEWHERE = ("charuco", "four_markers", "marker_map", "aruco_grid of 1000 markers")
"""Boards of whose mirrored markers there are other fast tests."""


@pytest.mark.parametrize(
    "board",
    [
        pytest.param(board, id=name, marks=pytest.mark.slow if name in MIRRORED_ELSEWHERE else ())
        for name, board in MIRRORED.items()
    ],
)
@pytest.mark.parametrize("view", ["from above", pytest.param("far, upside down", marks=pytest.mark.slow)])
def test_a_mirrored_sheet_is_named(board, view, rng):
    image, _ = photograph(board, view, rng)

    missing = find_board(np.ascontiguousarray(image[:, ::-1]), board, view)

    assert missing.failure is BoardFailure.MIRRORED


@pytest.mark.parametrize("kind", ["asymmetric_circles", "chessboard", "separate_squares", "symmetric_circles"])
@pytest.mark.slow
def test_a_board_that_is_its_own_mirror_image_is_found_in_a_mirror(kind, rng):
    image, expected_px = photograph(BOARDS[kind], "from above", rng)

    found = find_board(np.ascontiguousarray(image[:, ::-1]), BOARDS[kind], "mirror")

    assert len(found.ids) == len(expected_px)


SMALLER = [
    ("charuco", -1, 0, BoardFailure.OTHER_LAYOUT),
    ("charuco", 0, -1, BoardFailure.LARGER),
    ("aprilgrid", -1, 0, BoardFailure.OTHER_LAYOUT),
    ("aprilgrid", 0, -1, BoardFailure.LARGER),
    ("aruco_grid", 0, -2, BoardFailure.LARGER),
    pytest.param("asymmetric_circles", -1, 0, BoardFailure.LARGER, marks=pytest.mark.slow),
    pytest.param("asymmetric_circles", 0, -1, BoardFailure.LARGER, marks=pytest.mark.slow),
    pytest.param("symmetric_circles", -1, 0, BoardFailure.LARGER, marks=pytest.mark.slow),
    pytest.param("symmetric_circles", 0, -2, BoardFailure.LARGER, marks=pytest.mark.slow),
    ("separate_squares", -1, 0, BoardFailure.LARGER),
    ("separate_squares", -1, -1, BoardFailure.LARGER),
]


@pytest.mark.parametrize(("kind", "columns", "rows", "failure"), SMALLER)
def test_a_sheet_with_more_columns_or_rows_than_the_board_file_says_is_named(kind, columns, rows, failure, rng):
    board = BOARDS[kind]
    image, _ = photograph(board, "near, from the right", rng)

    missing = find_board(
        image, replace(board, squares_x=board.squares_x + columns, squares_y=board.squares_y + rows), "larger"
    )

    assert missing.failure is failure
    assert f"squares_x: {board.squares_x}, squares_y: {board.squares_y}" in missing.finding


def test_a_marker_of_another_board_beside_it_does_not_make_the_board_larger(rng):
    image, _ = photograph(BOARDS["aprilgrid"], "far, from below", rng)
    family = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    image[20:140, 20:140] = 200
    image[40:120, 40:120] = cv2.aruco.generateImageMarker(family, 23, 80, borderBits=2) // 2 + 40

    found = find_board(image, BOARDS["aprilgrid"], "two boards")

    assert len(found.ids) > 60


def test_the_marker_size_of_an_aprilgrid_is_that_between_its_corners(rng):
    board = BOARDS["aprilgrid"]
    image, _ = photograph(board, "far, from below", rng)
    wider = replace(board, marker_m=0.037, gap_m=0.007)

    assert find_board(image, board, "true").marker_size_ratio == pytest.approx((1.0, 1.0), abs=0.02)
    assert find_board(image, wider, "wider").marker_size_ratio == pytest.approx((0.919, 0.919), abs=0.02)
