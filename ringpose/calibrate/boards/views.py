"""Detection of a calibration board in an image: its corners with their numbers, or the reason why there are none."""

from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np

from ringpose.calibrate.boards import diagnostics
from ringpose.calibrate.boards.patterns import chessboard
from ringpose.calibrate.boards.patterns.circles import circle_centers
from ringpose.calibrate.boards.patterns.image_patch import GreyImage, grey_8_bit
from ringpose.calibrate.boards.patterns.marker_edges import corners_from_sides
from ringpose.calibrate.boards.patterns.markers import (
    Markers,
    board_markers,
    find_markers,
    marker_layout,
    markers_of,
)
from ringpose.geometry.board import LAYOUTS, corner_numbers, corner_points, marker_dictionary
from ringpose.types.arrays import Array, Float64, Int64, UInt
from ringpose.types.board import Board, BoardView

BoardFinder = Callable[[UInt[Array, "row column"], Board, str], BoardView | diagnostics.NoBoard]
"""`find_board`, or `BoardSearch`, which calls it in another process."""

MIN_CORNERS = 6
"""Corners that a view must have: four determine the pose, six allow a check of the residuals."""

WHITE_PER_GAP = 0.9
"""Half-window of the refinement on a ChArUco board, in widths of the white rim around its markers: a window that
contains part of a marker increases the error from 0.02 to 0.1 px. On an AprilGrid, in widths of what is uniform beside
a corner, the marker's border or the small square."""

_SATURATION_WINDOW_PX = 9
"""Side of the square around a corner in which saturated pixels are counted."""


def find_board(image: UInt[Array, "row column"], board: Board, name: str) -> BoardView | diagnostics.NoBoard:
    """The corners of the board in the image, in pixels and in the board frame, or the reason why there are none."""
    grey = grey_8_bit(image)
    if (failure := diagnostics.hopeless(grey, board)) is not None:
        return failure
    try:
        view = _VIEWS[LAYOUTS[board.kind].pattern](grey, board, name)
    except cv2.error as error:  # some of its searches fail on what they find, for example at the image's rim
        finding = f"OpenCV fails on its {grey.shape[1]} x {grey.shape[0]} pixels: {' '.join(str(error.err).split())}"
        view = diagnostics.NoBoard(failure=diagnostics.BoardFailure.GIVEN_UP, finding=finding)
    if isinstance(view, diagnostics.NoBoard):
        return diagnostics.unusable(grey, view) or view
    window = np.ones((_SATURATION_WINDOW_PX, _SATURATION_WINDOW_PX), dtype=np.uint8)
    saturated = cv2.dilate((grey == 255).astype(np.uint8), window)
    column, row = np.clip(np.rint(view.points_px).astype(np.int64), 0, np.array(grey.shape[::-1]) - 1).T
    return replace(view, saturated_share=float(np.mean(saturated[row, column])))


def _chessboard_view(grey: GreyImage, board: Board, name: str) -> BoardView | diagnostics.NoBoard:
    """The view of a chessboard: all of it must be visible."""
    columns, rows = (board.squares_x or 0) - 1, (board.squares_y or 0) - 1
    if not chessboard.is_visible(grey, columns, rows):
        return diagnostics.pattern_failure(grey, board, None)
    corners, seen = chessboard.chessboard_corners(grey, columns, rows)
    return diagnostics.pattern_failure(grey, board, seen) if corners is None else _view(name, board, corners)


def _circle_view(grey: GreyImage, board: Board, name: str) -> BoardView | diagnostics.NoBoard:
    """The view of a grid of circles: all of it must be visible."""
    counts = (board.squares_x or 0, board.squares_y or 0)
    circles = circle_centers(grey, corner_points(board), *counts, board.kind == "asymmetric_circles")
    if circles is None:
        return diagnostics.circle_failure(grey, board)
    return replace(_view(name, board, circles.points_px), circle_radius_m=circles.radius_m)


def _square_view(grey: GreyImage, board: Board, name: str) -> BoardView | diagnostics.NoBoard:
    """The view of a grid of separate squares: all of it must be visible."""
    from ringpose.calibrate.boards.patterns.squares import OtherGrid, board_squares  # which no other board needs

    counts = (board.squares_x or 0, board.squares_y or 0)
    squares = board_squares(grey, *counts, (board.gap_m or 0.0) / (board.square_m or 1.0))
    if isinstance(squares, OtherGrid):
        return diagnostics.square_failure(grey, board, squares.squares, (squares.columns, squares.rows))
    if 4 * len(squares.numbers) < MIN_CORNERS:
        return diagnostics.square_failure(grey, board, len(squares.numbers), counts)
    ids = (4 * squares.numbers[:, None] + np.arange(4)).ravel()
    layout = marker_layout(board, Markers(ids=squares.numbers, corners_px=squares.corners_px))
    return replace(
        _view(name, board, squares.corners_px.reshape(-1, 2), ids),
        end_correlation=squares.end_correlation,
        marker_size_ratio=None if layout is None else layout.size_ratio,
    )


def _view(
    name: str, board: Board, points_px: Float64[Array, "corner xy=2"], ids: Int64[Array, "corner"] | None = None
) -> BoardView:
    """The view of the corners with these numbers; by default of all corners of the board."""
    ids = np.arange(len(points_px)) if ids is None else ids
    return BoardView(name=name, ids=ids, points_board_m=corner_points(board)[ids], points_px=points_px)


def _marker_view(grey: GreyImage, board: Board, name: str) -> BoardView | diagnostics.NoBoard:
    """The view of a board with markers: part of it is sufficient."""
    if board.kind == "charuco":
        ids, corners_px, markers = _charuco_corners(grey, board)
    else:
        markers = find_markers(grey, marker_dictionary(board), LAYOUTS[board.kind].border_cells)
    own = board_markers(board, markers)
    correlation = 0.0
    if board.kind != "charuco":
        ids = corner_numbers(board)[own.ids].ravel()
    if board.kind == "aprilgrid":
        corners_px = _april_corners(grey, board, own)
        # The detected outlines end short of the corners, where small squares touch them, by up to a twentieth.
        own = replace(own, corners_px=corners_px.reshape(-1, 4, 2))
    elif board.kind != "charuco":
        refined = [corners_from_sides(grey, corners) for corners in own.corners_px]
        corners_px = np.reshape([one.points_px for one in refined], (-1, 2)).astype(np.float64)
        correlation = float(np.mean([one.end_correlation for one in refined])) if refined else 0.0
    if (failure := diagnostics.layout_failure(grey, board, markers, own)) is not None:
        return failure
    if len(ids) >= MIN_CORNERS:
        layout = marker_layout(board, own)
        ratio = None if layout is None else layout.size_ratio
        return replace(_view(name, board, corners_px, ids), end_correlation=correlation, marker_size_ratio=ratio)
    if board.kind == "charuco" and len(own.ids):
        return diagnostics.charuco_failure(grey, board, len(ids), own)
    return diagnostics.marker_failure(grey, board, markers, own)


def _april_corners(grey: GreyImage, board: Board, markers: Markers) -> Float64[Array, "corner xy=2"]:
    """The corners of an AprilGrid's markers, where they touch small squares, refined as those of a chessboard."""
    cells = marker_dictionary(board).markerSize + 2 * LAYOUTS[board.kind].border_cells
    clear_share = min(LAYOUTS[board.kind].border_cells / cells, (board.gap_m or 0.0) / (board.marker_m or 1.0))
    refined = []
    for corners in markers.corners_px:
        grid = corners[[[0, 1], [3, 2]]]
        half_px = WHITE_PER_GAP * clear_share * chessboard.shortest_side(grid)
        grid = chessboard.refined_corners(grey, grid.reshape(-1, 2), half_px).reshape(2, 2, 2)
        refined.append(chessboard.saddle_points(grey, grid, half_px)[[0, 0, 1, 1], [0, 1, 1, 0]])
    return np.reshape(refined, (-1, 2)).astype(np.float64)


def _charuco_corners(
    grey: GreyImage, board: Board
) -> tuple[Int64[Array, "corner"], Float64[Array, "corner xy=2"], Markers]:
    """Numbers and refined positions of the chessboard corners between the board's markers, and the markers."""
    size = (board.squares_x or 0, board.squares_y or 0)
    pattern = cv2.aruco.CharucoBoard(size, board.square_m or 0.0, board.marker_m or 0.0, marker_dictionary(board))
    pattern.setLegacyPattern(board.legacy_pattern)
    corners, ids, marker_corners, marker_ids = cv2.aruco.CharucoDetector(pattern).detectBoard(grey)
    markers = markers_of(marker_corners, marker_ids)
    if ids is None or not len(ids):
        return np.empty(0, dtype=np.int64), np.empty((0, 2)), markers
    numbers = np.asarray(ids).ravel().astype(np.int64)
    points_px = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    white_share = WHITE_PER_GAP * ((board.square_m or 1.0) - (board.marker_m or 0.0)) / (2 * (board.square_m or 1.0))
    lattice = np.stack([numbers % (size[0] - 1), numbers // (size[0] - 1)], axis=-1)
    neighbours = np.abs(lattice[:, None] - lattice).sum(axis=-1) == 1
    distance_px = np.linalg.norm(points_px[:, None] - points_px, axis=-1)
    square_px = float(distance_px[neighbours].min()) if neighbours.any() else 0.0
    return numbers, chessboard.refined_corners(grey, points_px, white_share * square_px), markers


_VIEWS = {
    "aprilgrid": _marker_view,
    "charuco": _marker_view,
    "chessboard": _chessboard_view,
    "circles": _circle_view,
    "markers": _marker_view,
    "squares": _square_view,
}
"""The search for each pattern."""
