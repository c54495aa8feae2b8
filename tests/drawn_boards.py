"""One board of each kind with corners, and drawings of boards."""

import cv2
import numpy as np

from ringpose.types.board import Board

CHESSBOARD = Board(kind="chessboard", squares_x=10, squares_y=7, square_m=0.025)
CHARUCO = Board(kind="charuco", squares_x=8, squares_y=6, square_m=0.025, marker_m=0.018, dictionary="DICT_5X5_100")
FOUR = Board(kind="four_markers", dictionary="DICT_4X4_50", width_m=0.3, height_m=0.24, marker_m=0.06, margin_m=0.01)
GRID = Board(kind="aruco_grid", squares_x=3, squares_y=2, marker_m=0.04, gap_m=0.01, dictionary="DICT_4X4_50")
BOARDS = {"chessboard": CHESSBOARD, "charuco": CHARUCO, "four_markers": FOUR, "aruco_grid": GRID}


def drawn_board(board: Board) -> np.ndarray:
    """A board from above, 2 pixels a millimetre, with a white rim of 40 pixels."""
    if board.kind == "chessboard":
        side = round(2000 * board.square_m)
        squares = np.indices((board.squares_y, board.squares_x)).sum(axis=0) % 2 * 255
        face = np.kron(squares, np.ones((side, side))).astype(np.uint8)
    elif board.kind == "charuco":
        dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        size = (board.squares_x, board.squares_y)
        pattern = cv2.aruco.CharucoBoard(size, board.square_m, board.marker_m, dictionary)
        pattern.setLegacyPattern(board.legacy_pattern)
        side = round(2000 * board.square_m)
        face = pattern.generateImage((size[0] * side, size[1] * side))
    else:
        face = _drawn_markers(board)
    printed = np.pad(face, 40, constant_values=255) * 0.7 + 20
    return np.rint(cv2.GaussianBlur(printed, (0, 0), 1.0)).astype(np.uint8)


def _drawn_markers(board: Board) -> np.ndarray:
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    side = round(2000 * board.marker_m)
    if board.kind == "four_markers":
        width, height, near = (round(2000 * size) for size in (board.width_m, board.height_m, board.margin_m))
        right, low = width - near - side, height - near - side
        places = [(near, near), (right, near), (right, low), (near, low)]
    else:
        pitch = side + round(2000 * board.gap_m)
        width = board.squares_x * pitch - round(2000 * board.gap_m)
        height = board.squares_y * pitch - round(2000 * board.gap_m)
        places = [(x * pitch, y * pitch) for y in range(board.squares_y) for x in range(board.squares_x)]
    face = np.full((height, width), 255, np.uint8)
    for number, (x, y) in enumerate(places):
        face[y : y + side, x : x + side] = cv2.aruco.generateImageMarker(dictionary, number, side)
    return face
