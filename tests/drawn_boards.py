"""One board of each kind with corners, as drawn by the tests."""

from ringpose.types.board import Board

CHESSBOARD = Board(kind="chessboard", squares_x=10, squares_y=7, square_m=0.025)
CHARUCO = Board(kind="charuco", squares_x=8, squares_y=6, square_m=0.025, marker_m=0.018, dictionary="DICT_5X5_100")
FOUR = Board(kind="four_markers", dictionary="DICT_4X4_50", width_m=0.3, height_m=0.24, marker_m=0.06, margin_m=0.01)
GRID = Board(kind="aruco_grid", squares_x=3, squares_y=2, marker_m=0.04, gap_m=0.01, dictionary="DICT_4X4_50")
BOARDS = {"chessboard": CHESSBOARD, "charuco": CHARUCO, "four_markers": FOUR, "aruco_grid": GRID}
