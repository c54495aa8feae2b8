"""The board as a surface for stripes: usable regions, triangulation with its plane (method(7), section 6)."""

from dataclasses import dataclass

import numpy as np

from ringpose.calibrate.boards.layout import marker_corners, outline_m
from ringpose.calibrate.boards.views import board_image, dark_image
from ringpose.geometry.rays import intersect, project, rays
from ringpose.types.arrays import Array, Bool, Float64, UInt
from ringpose.types.board import Board, BoardPose
from ringpose.types.image import Shot
from ringpose.types.rig import Camera

PRINT_MARGIN_PX = 5.0
"""Distance from a printed edge within which a stripe's profile is asymmetric: three stripe sigmas."""


def board_surface(shot: Shot, board: Board, pose: BoardPose, camera: Camera, surround_m: float = 0.0) -> "BoardSurface":
    """The board's face in a shot; on a chessboard, the grey values determine which squares are used.

    Light squares are used: black ink reflects a tenth of the light, and centres on it scatter three times as much.
    Without a frame with lasers off to subtract, dark squares are used: there, stripes stand out from the background.
    """
    first_is_dark = _first_is_dark(board_image(shot), board, pose, camera)
    first_is_used = first_is_dark == (dark_image(shot) is None)
    return BoardSurface(board=board, pose=pose, camera=camera, surround_m=surround_m, first_is_used=first_is_used)


def _first_is_dark(image: UInt[Array, "row column"], board: Board, pose: BoardPose, camera: Camera) -> bool:
    """Whether squares of even row + column (the outer top-left one's colour) are darker than the odd ones."""
    if board.kind != "chessboard":
        return True
    row, column = np.mgrid[0 : board.squares_y or 0, 0 : board.squares_x or 0]
    centers = np.stack([column + 0.5, row + 0.5], axis=-1).reshape(-1, 2) * board.square_size_m
    points = np.column_stack([centers, np.zeros(len(centers))]) @ pose.rotation.T + pose.translation_m
    x, y = np.rint(np.nan_to_num(project(points, camera), nan=-1.0)).T
    inside = (x >= 0) & (y >= 0) & (x < image.shape[1]) & (y < image.shape[0])
    grey = image[y[inside].astype(np.int64), x[inside].astype(np.int64)]
    odd = (row + column).ravel()[inside] % 2 == 1
    return not (odd.any() and not odd.all()) or float(np.median(grey[odd])) >= float(np.median(grey[~odd]))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardSurface:
    """The flat sheet that carries the board, in one view."""

    board: Board
    pose: BoardPose
    camera: Camera
    surround_m: float = 0.0
    """Width of the flat sheet beyond the board's outline."""
    first_is_used: bool = False
    """Whether stripes are used on a chessboard's squares of the outer top-left one's colour, or on the others."""

    def usable(self, points_px: Float64[Array, "n xy=2"]) -> Bool[Array, "n"]:
        """Which pixels lie on the sheet and away from printed edges."""
        board = self.board
        on_board_m = (triangulated(points_px, self.pose, self.camera) - self.pose.translation_m) @ self.pose.rotation
        position_m: Float64[Array, "n xy=2"] = np.nan_to_num(on_board_m[:, :2], nan=np.inf)
        margin = PRINT_MARGIN_PX * float(self.pose.translation_m[2] / self.camera.camera_matrix[0, 0])
        low = -self.surround_m if self.surround_m else margin
        usable = np.all((position_m > low) & (position_m < np.array(outline_m(board)) - low), axis=1)

        marker_margin = margin
        if board.kind == "charuco":  # a grid of squares too: the margin beside a marker is its white rim
            marker_margin = min(margin, ((board.square_m or 0.0) - (board.marker_m or 0.0)) / 4)
        for corner in marker_corners(board)[..., :2]:
            near = (position_m > corner[0] - marker_margin) & (position_m < corner[2] + marker_margin)
            usable &= ~np.all(near, axis=1)

        if board.kind in ("chessboard", "charuco"):
            square, counts = np.array(board.square_size_m), np.array([board.squares_x or 0, board.squares_y or 0])
            cell = np.where(np.isfinite(position_m), position_m, -square) / square
            near_edge = (np.abs(cell - np.rint(cell)) * square).min(axis=1) < margin
            printed = np.all((position_m > -margin) & (position_m < counts * square + margin), axis=1)
            usable &= ~(near_edge & printed)
        if board.kind == "chessboard":  # on a ChArUco board all squares are used, because markers fill the light ones
            column, row = np.floor(cell).T
            on_square = np.all((cell >= 0) & (np.floor(cell) < counts), axis=1)
            usable &= ~(on_square & ((column + row) % 2 == (1 if self.first_is_used else 0)))
        return usable


def triangulated(points_px: Float64[Array, "n xy=2"], pose: BoardPose, camera: Camera) -> Float64[Array, "n xyz=3"]:
    """Intersections of distorted pixels' rays r with the board: P = t r, t = (n_b . c_b) / (n_b . r), camera frame."""
    normal = pose.rotation[:, 2]
    return intersect(rays(points_px, camera), normal, np.array(float(normal @ pose.translation_m)))
