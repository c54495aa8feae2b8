"""Where in the image the corners lie, and how the boards stood."""

from collections.abc import Sequence

import numpy as np

from ringpose.geometry.rotations import angle_between, rotation_vector
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.calibration import CameraCalibration, Coverage
from ringpose.types.camera import Camera

CELL_COLUMNS = 8
"""Cells across the image; as many down as make them nearly square."""

BARE_SHARE = 1 / 3
"""A ninth of the image is bare if no more of its cells have corners: a strip along one side."""

SAME_RAD = np.radians(2.0)
"""Boards that are turned by less against each other ..."""

SAME_SHARE = 0.02
"""... and lie nearer together than this share of their distance are one view, taken again."""

_REGIONS = (("upper left", "top", "upper right"), ("left", "middle", "right"), ("lower left", "bottom", "lower right"))


def coverage(calibration: CameraCalibration, boards: Sequence[BoardView]) -> Coverage:
    """What the views that were used cover; the boards are those of all views, in their order."""
    camera = calibration.camera
    pairs = zip(calibration.views, boards, strict=True)
    used = [(view, board) for view, board in pairs if not view.rejected]
    points_px = np.concatenate([view.points_px[~view.left_out] for view, _ in used])
    middles = [board_middle(board, view.pose) for view, board in used]
    return Coverage(
        corners=_counts(points_px, camera, (_cell_rows(camera), CELL_COLUMNS)).astype(np.int64),
        bare_regions=_bare_regions(points_px, camera),
        tilt_rad=tuple(board_tilt_rad(view.pose) for view, _ in used),
        tilt_spread_rad=_tilt_spread([view.pose for view, _ in used]),
        distance_m=tuple(float(np.linalg.norm(middle)) for middle in middles),
    )


def board_middle(board: BoardView, pose: BoardPose) -> Float64[Array, "xyz=3"]:
    """The middle of the corners seen, in the camera frame."""
    middle: Float64[Array, "xyz=3"] = pose.rotation @ board.points_board_m.mean(axis=0) + pose.translation_m
    return middle


def board_tilt_rad(pose: BoardPose) -> float:
    """Angle between board and image; where it is zero, no perspective tells the focal length, wherever the board is."""
    return float(angle_between(pose.rotation[:, 2], np.array([0.0, 0.0, 1.0])))


def different_poses(poses: Sequence[BoardPose]) -> int:
    """How many of the poses differ from all before them: a board that was not moved says the same thing again."""
    found: list[BoardPose] = []
    for pose in poses:
        if not any(_alike(pose, other) for other in found):
            found.append(pose)
    return len(found)


def _alike(pose: BoardPose, other: BoardPose) -> bool:
    turn = np.linalg.norm(rotation_vector(pose.rotation.T @ other.rotation))
    way_m = np.linalg.norm(pose.translation_m - other.translation_m)
    return bool(turn < SAME_RAD and way_m < SAME_SHARE * np.linalg.norm(pose.translation_m))


def _tilt_spread(poses: Sequence[BoardPose]) -> tuple[float, float]:
    normals = np.array([pose.rotation[:2, 2] for pose in poses])
    if len(normals) < 2:
        return 0.0, 0.0
    across, along = np.sqrt(np.maximum(np.linalg.eigvalsh(np.cov(normals.T)), 0.0)).tolist()
    return along, across


def _cell_rows(camera: Camera) -> int:
    return max(round(CELL_COLUMNS * camera.image_height / camera.image_width), 1)


def _counts(
    points_px: Float64[Array, "n xy=2"], camera: Camera, shape: tuple[int, int]
) -> Float64[Array, "cell_row cell_column"]:
    rows, columns = shape
    edges = [(-0.5, camera.image_height - 0.5), (-0.5, camera.image_width - 0.5)]
    counts, _, _ = np.histogram2d(points_px[:, 1], points_px[:, 0], bins=(rows, columns), range=edges)
    found: Float64[Array, "cell_row cell_column"] = counts
    return found


def _bare_regions(points_px: Float64[Array, "n xy=2"], camera: Camera) -> tuple[str, ...]:
    """Each ninth of the image is divided into nine cells again."""
    seen = _counts(points_px, camera, (9, 9)) > 0
    share = seen.reshape(3, 3, 3, 3).mean(axis=(1, 3))
    return tuple(_REGIONS[row][column] for row, column in zip(*np.nonzero(share <= BARE_SHARE), strict=True))
