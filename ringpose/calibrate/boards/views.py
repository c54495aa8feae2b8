"""Detection of a calibration board in an image: its corners with their numbers, or the reason why there are none."""

from dataclasses import dataclass

import cv2
import numpy as np

from ringpose.calibrate.boards.chessboard import chessboard_corners, refined_corners
from ringpose.calibrate.boards.circles import circle_centers
from ringpose.calibrate.boards.diagnostics import (
    BoardFailure,
    NoBoard,
    charuco_failure,
    circle_failure,
    marker_failure,
    pattern_failure,
    too_small,
    unusable,
)
from ringpose.calibrate.boards.layout import MarkerLayout, corner_points, marker_corners, marker_layout, other_layout
from ringpose.calibrate.boards.marker_edges import corners_from_sides
from ringpose.calibrate.boards.markers import Markers, find_markers, marker_count, marker_dictionary, markers_of
from ringpose.errors import DataError
from ringpose.types.arrays import Array, Float64, Int64, UInt, UInt8
from ringpose.types.board import Board, BoardView
from ringpose.types.image import Shot

MIN_CORNERS = 6
"""Corners that a view must have: four determine the pose, six allow a check of the residuals."""

WHITE_PER_GAP = 0.9
"""Half-window of the refinement on a ChArUco board, in widths of the white rim around its markers: a window that
contains part of a marker increases the error from 0.02 to 0.1 px."""

_SATURATION_WINDOW_PX = 9
"""Side of the square around a corner in which saturated pixels are counted."""


def find_board(image: UInt[Array, "row column"], board: Board, name: str) -> BoardView | NoBoard:
    """The corners of the board in the image, in pixels and in the board frame, or the reason why there are none."""
    grey = grey_8_bit(image)
    small = too_small(grey)
    if small is not None:
        return small
    try:
        seen = _marker_view(grey, board) if marker_count(board) else _pattern_view(grey, board)
    except cv2.error as error:
        found = f"OpenCV fails on its {grey.shape[1]} x {grey.shape[0]} pixels: {' '.join(str(error.err).split())}"
        raise DataError(name, found, "give a smaller image") from error
    if isinstance(seen, NoBoard):
        return unusable(grey, seen) or seen
    return BoardView(
        name=name,
        ids=seen.ids,
        points_board_m=corner_points(board)[seen.ids],
        points_px=seen.points_px,
        end_correlation=seen.end_correlation,
        circle_radius_m=seen.circle_radius_m,
        saturated_share=_saturated_share(grey, seen.points_px),
        marker_size_ratio=None if seen.layout is None else seen.layout.size_ratio,
    )


def grey_8_bit(image: UInt[Array, "row column"]) -> UInt8[Array, "row column"]:
    """The image in 8 bits for OpenCV's detectors; deeper images are scaled so that their brightest pixel is white."""
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image)
    scale = 255.0 / max(int(image.max(initial=0)), 1)
    return np.rint(image * scale).astype(np.uint8)


_Corners = tuple[Int64[Array, "corner"], Float64[Array, "corner xy=2"]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Detection:
    """Corners with their numbers."""

    ids: Int64[Array, "corner"]
    points_px: Float64[Array, "corner xy=2"]
    layout: MarkerLayout | None = None
    end_correlation: float = 0.0
    """Correlation of the errors of neighbouring marker corners."""
    circle_radius_m: float = 0.0


def _pattern_view(grey: UInt8[Array, "row column"], board: Board) -> _Detection | NoBoard:
    """A chessboard or a grid of circles: all of it must be visible."""
    columns, rows = board.squares_x or 0, board.squares_y or 0
    if board.kind == "chessboard":
        corners = chessboard_corners(grey, columns - 1, rows - 1)
        return pattern_failure(grey, board) if corners is None else _all_corners(corners)
    circles = circle_centers(grey, corner_points(board), columns, rows)
    return circle_failure(grey, board) if circles is None else _all_corners(*circles)


def _all_corners(corners_px: Float64[Array, "corner xy=2"], circle_radius_m: float = 0.0) -> _Detection:
    ids = np.arange(len(corners_px), dtype=np.int64)
    return _Detection(ids=ids, points_px=corners_px, circle_radius_m=circle_radius_m)


def _marker_view(grey: UInt8[Array, "row column"], board: Board) -> _Detection | NoBoard:
    """A board with markers: part of it is sufficient."""
    correlation = 0.0
    if board.kind == "charuco":
        ids, corners, markers = _charuco_corners(grey, board)
    else:
        markers = find_markers(grey, marker_dictionary(board))
        ids, corners, correlation = _marker_corners(grey, _own_markers(markers, board))
    own = _own_markers(markers, board)
    matching_layout = other_layout(board, own)
    if matching_layout is not None:
        points_px = own.corners_px.reshape(-1, 2)
        return NoBoard(failure=BoardFailure.OTHER_LAYOUT, found=matching_layout, points_px=points_px)
    if len(ids) >= MIN_CORNERS:
        return _Detection(ids=ids, points_px=corners, layout=marker_layout(board, own), end_correlation=correlation)
    if board.kind == "charuco" and len(own.ids):
        return charuco_failure(grey, board, len(ids), own)
    return marker_failure(grey, board, markers, own)


def _charuco_corners(grey: UInt8[Array, "row column"], board: Board) -> tuple[*_Corners, Markers]:
    """Refined chessboard corners between the board's markers, and the markers."""
    size = (board.squares_x or 0, board.squares_y or 0)
    pattern = cv2.aruco.CharucoBoard(size, board.square_m or 0.0, board.marker_m or 0.0, marker_dictionary(board))
    pattern.setLegacyPattern(board.legacy_pattern)
    corners, ids, found, found_ids = cv2.aruco.CharucoDetector(pattern).detectBoard(grey)
    markers = markers_of(found, found_ids)
    if ids is None or not len(ids):
        return np.empty(0, dtype=np.int64), np.empty((0, 2)), markers
    numbers = np.asarray(ids).ravel().astype(np.int64)
    points_px = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    share = WHITE_PER_GAP * ((board.square_m or 1.0) - (board.marker_m or 0.0)) / (2 * (board.square_m or 1.0))
    half_window_px = share * _square_px(numbers, points_px, size[0] - 1)
    return numbers, refined_corners(grey, points_px, half_window_px), markers


def _square_px(ids: Int64[Array, "n"], points_px: Float64[Array, "n xy=2"], columns: int) -> float:
    """Minimum distance of neighbouring corners in pixels; zero if no corner has a neighbour."""
    lattice = np.stack([ids % columns, ids // columns], axis=-1)
    neighbours = np.abs(lattice[:, None] - lattice).sum(axis=-1) == 1
    if not neighbours.any():
        return 0.0
    return float(np.linalg.norm(points_px[:, None] - points_px, axis=-1)[neighbours].min())


def _marker_corners(grey: UInt8[Array, "row column"], own: Markers) -> tuple[*_Corners, float]:
    """Corners of the board's own markers, and the correlation of the errors of neighbouring corners."""
    ids = (4 * own.ids[:, None] + np.arange(4)).ravel()
    found = [corners_from_sides(grey, corners) for corners in own.corners_px]
    points_px = np.reshape([one.points_px for one in found], (-1, 2)).astype(np.float64)
    return ids, points_px, float(np.mean([one.end_correlation for one in found])) if found else 0.0


def _own_markers(markers: Markers, board: Board) -> Markers:
    """The board's markers, without numbers that occur twice: which of the two is the board's is ambiguous."""
    _, index, count = np.unique(markers.ids, return_inverse=True, return_counts=True)
    own = (markers.ids < len(marker_corners(board))) & (count[index] == 1)
    return Markers(ids=markers.ids[own], corners_px=markers.corners_px[own])


def _saturated_share(grey: UInt8[Array, "row column"], points_px: Float64[Array, "corner xy=2"]) -> float:
    """Share of the corners with a saturated pixel near them."""
    window = np.ones((_SATURATION_WINDOW_PX, _SATURATION_WINDOW_PX), dtype=np.uint8)
    near = cv2.dilate((grey == 255).astype(np.uint8), window)
    column, row = np.clip(np.rint(points_px).astype(np.int64), 0, np.array(grey.shape[::-1]) - 1).T
    return float(np.mean(near[row, column]))


def board_image(shot: Shot) -> UInt[Array, "row column"]:
    """The frame with the lasers off; without one, the minimum of all frames, which removes switched stripes."""
    dark = dark_image(shot)
    return np.min(shot.images, axis=0) if dark is None else dark


def dark_image(shot: Shot) -> UInt[Array, "row column"] | None:
    """The first frame with the lasers off, if there is one."""
    off = np.flatnonzero(shot.lasers == 0)
    image: UInt[Array, "row column"] | None = shot.images[off[0]] if len(off) else None
    return image
