"""Where on a board a stripe's centre can be trusted.

Stripe centres triangulated with a board's plane (ringpose-method(7), section 6).
"""

from dataclasses import dataclass

import numpy as np

from ringpose.calibrate.boards.layout import marker_corners, outline_m
from ringpose.calibrate.boards.views import board_image, dark_image
from ringpose.geometry.rays import intersect, project, rays
from ringpose.types.arrays import Array, Bool, Float64, UInt
from ringpose.types.board import Board, BoardPose
from ringpose.types.camera import Camera
from ringpose.types.image import Shot

PRINT_MARGIN_PX = 5.0
"""Distance from an edge between black and white within which a stripe's profile is lopsided: three stripe sigmas."""


def board_surface(shot: Shot, board: Board, pose: BoardPose, camera: Camera, surround_m: float = 0.0) -> "BoardSurface":
    """The face as a shot shows it, which says which squares are dark, and which of them serve.

    Black ink shows a tenth of the light: centres there scatter three times as much. Where no frame without lasers can
    be subtracted, paper is bright by itself, and stripes stand out, and are not confused with edges, on the ink alone.
    """
    first_is_dark = _first_is_dark(board_image(shot), board, pose, camera)
    first_is_used = first_is_dark == (dark_image(shot) is None)
    return BoardSurface(board=board, pose=pose, camera=camera, surround_m=surround_m, first_is_used=first_is_used)


def _first_is_dark(image: UInt[Array, "row column"], board: Board, pose: BoardPose, camera: Camera) -> bool:
    """Whether the median step from the squares with even numbers to those with odd ones is upwards."""
    if board.kind != "chessboard":
        return True
    row, column = np.mgrid[0 : board.squares_y or 0, 0 : board.squares_x or 0]
    middles = np.stack([column + 0.5, row + 0.5], axis=-1).reshape(-1, 2) * board.square_size_m
    points = np.column_stack([middles, np.zeros(len(middles))]) @ pose.rotation.T + pose.translation_m
    x, y = np.rint(np.nan_to_num(project(points, camera), nan=-1.0)).T
    inside = (x >= 0) & (y >= 0) & (x < image.shape[1]) & (y < image.shape[0])
    grey = image[y[inside].astype(np.int64), x[inside].astype(np.int64)]
    odd = (row + column).ravel()[inside] % 2 == 1
    return not (odd.any() and not odd.all()) or float(np.median(grey[odd])) >= float(np.median(grey[~odd]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardSurface:
    """The flat face that carries the board, as one view shows it."""

    board: Board
    pose: BoardPose
    camera: Camera
    surround_m: float = 0.0
    """How far the flat sheet reaches beyond the board's outline."""
    first_is_used: bool = False
    """Whether stripes are used on those of a chessboard's squares that have the outer top-left one's colour."""

    def points(self, points_px: Float64[Array, "n xy=2"]) -> Float64[Array, "n xyz=3"]:
        """Pixels triangulated with the board's plane."""
        return triangulated(points_px, self.pose, self.camera)

    def usable(self, points_px: Float64[Array, "n xy=2"]) -> Bool[Array, "n"]:
        """Which pixels lie on the sheet and away from printed edges."""
        place = self._on_board(points_px)
        margin = PRINT_MARGIN_PX * self._metres_per_pixel()
        inside = self._on_sheet(place, margin)
        printed = (
            self._near_marker(place, margin) | self._near_square_edge(place, margin) | self._on_unused_square(place)
        )
        return inside & ~printed

    def _on_board(self, points_px: Float64[Array, "n xy=2"]) -> Float64[Array, "n xy=2"]:
        place = (self.points(points_px) - self.pose.translation_m) @ self.pose.rotation
        finite: Float64[Array, "n xy=2"] = np.nan_to_num(place[:, :2], nan=np.inf)
        return finite

    def _metres_per_pixel(self) -> float:
        return float(self.pose.translation_m[2] / self.camera.camera_matrix[0, 0])

    def _on_sheet(self, place: Float64[Array, "n xy=2"], margin: float) -> Bool[Array, "n"]:
        low = -self.surround_m if self.surround_m else margin
        high = np.array(outline_m(self.board)) - low
        inside: Bool[Array, "n"] = np.all((place > low) & (place < high), axis=1)
        return inside

    def _near_marker(self, place: Float64[Array, "n xy=2"], margin: float) -> Bool[Array, "n"]:
        if self.board.kind == "charuco":  # a grid of squares too: the margin beside a marker is its white rim
            margin = min(margin, ((self.board.square_m or 0.0) - (self.board.marker_m or 0.0)) / 4)
        corners = marker_corners(self.board)[..., :2]
        near = np.zeros(len(place), dtype=bool)
        for corner in corners:
            near |= np.all((place > corner[0] - margin) & (place < corner[2] + margin), axis=1)
        return near

    def _near_square_edge(self, place: Float64[Array, "n xy=2"], margin: float) -> Bool[Array, "n"]:
        if self.board.kind not in ("chessboard", "charuco"):
            return np.zeros(len(place), dtype=bool)
        square = np.array(self.board.square_size_m)
        counts = np.array([self.board.squares_x or 0, self.board.squares_y or 0])
        cell = np.where(np.isfinite(place), place, 0.0) / square
        nearest = (np.abs(cell - np.rint(cell)) * square).min(axis=1) < margin
        printed = np.all((place > -margin) & (place < counts * square + margin), axis=1)
        near: Bool[Array, "n"] = nearest & printed
        return near

    def _on_unused_square(self, place: Float64[Array, "n xy=2"]) -> Bool[Array, "n"]:
        """On a ChArUco board all are used, because markers fill the light squares."""
        if self.board.kind != "chessboard":
            return np.zeros(len(place), dtype=bool)
        square = np.array(self.board.square_size_m)
        column, row = np.floor(np.where(np.isfinite(place), place, -1.0) / square).T
        inside = (
            (column >= 0) & (column < (self.board.squares_x or 0)) & (row >= 0) & (row < (self.board.squares_y or 0))
        )
        unused: Bool[Array, "n"] = inside & ((column + row) % 2 == (1 if self.first_is_used else 0))
        return unused


def triangulated(points_px: Float64[Array, "n xy=2"], pose: BoardPose, camera: Camera) -> Float64[Array, "n xyz=3"]:
    """Points on the board, in the camera frame, that distorted pixels see."""
    return on_board(rays(points_px, camera), pose)


def on_board(directions: Float64[Array, "n xyz=3"], pose: BoardPose) -> Float64[Array, "n xyz=3"]:
    """P = t r with t = (n_b . c_b) / (n_b . r): where rays meet the board."""
    normal = pose.rotation[:, 2]
    return intersect(directions, normal, np.array(float(normal @ pose.translation_m)))
