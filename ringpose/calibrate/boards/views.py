"""What an image shows of a calibration board, or why it shows none.

The one image of a shot in which a board's corners are looked for.
"""

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

MINIMUM_CORNERS = 6
"""A view with fewer corners says too little: four fix a pose, and six leave something to judge it by."""

WHITE_PER_GAP = 0.9
"""Half-window on a ChArUco board, in widths of the white rim around its markers: a window that reaches a marker
is five times worse (0.02 -> 0.1 px)."""

_NEAR_PX = 9
"""Side of the square around a corner whose pixels its place is told by, the nearest ones."""


def find_board(image: UInt[Array, "row column"], board: Board, name: str) -> BoardView | NoBoard:
    """The corners of the board that the image shows, in pixels and in the board frame, or the reason for none."""
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
        likeness=seen.likeness,
        circle_radius_m=seen.circle_radius_m,
        saturated_share=_saturated_share(grey, seen.points_px),
        marker_size_ratio=None if seen.layout is None else seen.layout.size_ratio,
    )


def grey_8_bit(image: UInt[Array, "row column"]) -> UInt8[Array, "row column"]:
    """The image as OpenCV's detectors want it: deeper images are scaled so that their brightest pixel is white."""
    if image.dtype == np.uint8:
        return np.ascontiguousarray(image)
    scale = 255.0 / max(int(image.max(initial=0)), 1)
    return np.rint(image * scale).astype(np.uint8)


def _saturated_share(grey: UInt8[Array, "row column"], points_px: Float64[Array, "corner xy=2"]) -> float:
    """Of the corners, those with a saturated pixel near them."""
    near = cv2.dilate((grey == 255).astype(np.uint8), np.ones((_NEAR_PX, _NEAR_PX), dtype=np.uint8))
    column, row = np.clip(np.rint(points_px).astype(np.int64), 0, np.array(grey.shape[::-1]) - 1).T
    return float(np.mean(near[row, column]))


_Corners = tuple[Int64[Array, "corner"], Float64[Array, "corner xy=2"]]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seen:
    """Corners with their numbers, and how the markers lie that tell them."""

    ids: Int64[Array, "corner"]
    points_px: Float64[Array, "corner xy=2"]
    layout: MarkerLayout | None = None
    likeness: float = 0.0
    """Of the errors of a marker's corners."""
    circle_radius_m: float = 0.0


def _pattern_view(grey: UInt8[Array, "row column"], board: Board) -> _Seen | NoBoard:
    """A chessboard or a grid of circles: found whole or not at all."""
    columns, rows = board.squares_x or 0, board.squares_y or 0
    if board.kind == "chessboard":
        corners = chessboard_corners(grey, columns - 1, rows - 1)
        return pattern_failure(grey, board) if corners is None else _all_seen(corners)
    circles = circle_centers(grey, corner_points(board), columns, rows)
    return circle_failure(grey, board) if circles is None else _all_seen(*circles)


def _all_seen(corners_px: Float64[Array, "corner xy=2"], circle_radius_m: float = 0.0) -> _Seen:
    ids = np.arange(len(corners_px), dtype=np.int64)
    return _Seen(ids=ids, points_px=corners_px, circle_radius_m=circle_radius_m)


def _marker_view(grey: UInt8[Array, "row column"], board: Board) -> _Seen | NoBoard:
    """A board with markers: part of it is enough."""
    likeness = 0.0
    if board.kind == "charuco":
        ids, corners, markers = _charuco_corners(grey, board)
    else:
        markers = find_markers(grey, marker_dictionary(board))
        ids, corners, likeness = _marker_corners(grey, _own_markers(markers, board))
    own = _own_markers(markers, board)
    fitting = other_layout(board, own)
    if fitting is not None:
        return NoBoard(failure=BoardFailure.OTHER_LAYOUT, found=fitting, points_px=own.corners_px.reshape(-1, 2))
    if len(ids) >= MINIMUM_CORNERS:
        return _Seen(ids=ids, points_px=corners, layout=marker_layout(board, own), likeness=likeness)
    if board.kind == "charuco" and len(own.ids):
        return charuco_failure(grey, board, len(ids), own)
    return marker_failure(grey, board, markers, own)


def _marker_corners(grey: UInt8[Array, "row column"], own: Markers) -> tuple[*_Corners, float]:
    """Corners of the board's own markers, and how alike a marker's corners err."""
    ids = (4 * own.ids[:, None] + np.arange(4)).ravel()
    found = [corners_from_sides(grey, corners) for corners in own.corners_px]
    points_px = np.reshape([one.points_px for one in found], (-1, 2)).astype(np.float64)
    return ids, points_px, float(np.mean([one.likeness for one in found])) if found else 0.0


def _own_markers(markers: Markers, board: Board) -> Markers:
    """Those that the board has, and that are seen once."""
    own = (markers.ids < len(marker_corners(board))) & _single(markers)
    return Markers(ids=markers.ids[own], corners_px=markers.corners_px[own])


def _single(markers: Markers) -> np.ndarray[tuple[int], np.dtype[np.bool_]]:
    """Markers whose number occurs once: of two with one number, nobody knows which is the board's."""
    _, position, count = np.unique(markers.ids, return_inverse=True, return_counts=True)
    single: np.ndarray[tuple[int], np.dtype[np.bool_]] = count[position] == 1
    return single


def _charuco_corners(grey: UInt8[Array, "row column"], board: Board) -> tuple[*_Corners, Markers]:
    """Chessboard corners between the board's markers, refined, and the markers."""
    size = (board.squares_x or 0, board.squares_y or 0)
    pattern = cv2.aruco.CharucoBoard(size, board.square_m or 0.0, board.marker_m or 0.0, marker_dictionary(board))
    pattern.setLegacyPattern(board.legacy_pattern)
    corners, ids, found, found_ids = cv2.aruco.CharucoDetector(pattern).detectBoard(grey)
    markers = markers_of(found, found_ids)
    if ids is None or not len(ids):
        return np.empty(0, dtype=np.int64), np.empty((0, 2)), markers
    numbers = np.asarray(ids).ravel().astype(np.int64)
    positions = np.asarray(corners, dtype=np.float64).reshape(-1, 2)
    share = WHITE_PER_GAP * ((board.square_m or 1.0) - (board.marker_m or 0.0)) / (2 * (board.square_m or 1.0))
    half_window_px = share * _square_px(numbers, positions, size[0] - 1)
    return numbers, refined_corners(grey, positions, half_window_px), markers


def _square_px(ids: Int64[Array, "n"], positions: Float64[Array, "n xy=2"], columns: int) -> float:
    """Shortest distance of neighbouring corners, in pixels."""
    place = np.stack([ids % columns, ids // columns], axis=-1)
    neighbours = np.abs(place[:, None] - place).sum(axis=-1) == 1
    if not neighbours.any():
        return 0.0
    return float(np.linalg.norm(positions[:, None] - positions, axis=-1)[neighbours].min())


def board_image(shot: Shot) -> UInt[Array, "row column"]:
    """The frame with the lasers off; without one, the least of all frames, in which switched stripes vanish."""
    dark = dark_image(shot)
    return np.min(shot.images, axis=0) if dark is None else dark


def dark_image(shot: Shot) -> UInt[Array, "row column"] | None:
    """The first frame with the lasers off, if there is one."""
    off = np.flatnonzero(shot.lasers == 0)
    image: UInt[Array, "row column"] | None = shot.images[off[0]] if len(off) else None
    return image
