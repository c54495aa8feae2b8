"""What the corners of one marker have in common (ringpose-method(7), section 6).

Each corner is where two sides meet, and each side was drawn through its edge as one parabola: an error of a side
moves both corners at its ends. Taken for independent, the corners of four markers make boards seem a third better
placed than they are.
"""

import numpy as np

from ringpose.calibrate.board_pose import board_pose, moved_pose, residuals
from ringpose.calibrate.intrinsics import projection_jacobians
from ringpose.types.arrays import Array, Float64
from ringpose.types.board import BoardPose, BoardView
from ringpose.types.camera import Camera


def by_independent_errors(
    rows: Float64[Array, "coordinate *column"], view: BoardView
) -> Float64[Array, "coordinate *column"]:
    """Rows of a view's corner coordinates (x and y of each in turn) turned into as many of independent errors.

    Their mean square stays that of a coordinate. Corners that err alike are those of whole markers.
    """
    if view.likeness == 0:
        return rows
    by_marker = rows.reshape(-1, 8, rows.size // len(rows))
    return np.linalg.solve(_error_root(view), by_marker).reshape(rows.shape)


def corner_residuals(view: BoardView, pose: BoardPose, camera: Camera) -> Float64[Array, "coordinate"]:
    """Of a view's corners in pixels, x and y of each in turn, changed to as many of independent errors."""
    return by_independent_errors(residuals(view, pose, camera).ravel(), view)


def likeliest_pose(view: BoardView, camera: Camera) -> tuple[BoardPose, Float64[Array, "pose=6 pose=6"]]:
    """The board's pose by corners that err alike, and its covariance for errors of one pixel in each coordinate."""
    pose = board_pose(view, camera)
    by_pose, _ = projection_jacobians(view.points_board_m, pose, camera)
    rows = by_independent_errors(by_pose.reshape(-1, 6), view)
    covariance: Float64[Array, "pose=6 pose=6"] = np.linalg.inv(rows.T @ rows)
    if view.likeness:
        pose = moved_pose(pose, covariance @ rows.T @ corner_residuals(view, pose, camera))
    return pose, covariance


def likeness_of_ends(left_out: float) -> float:
    """Correlation of a parabola's errors at a side's two ends, if it was drawn without this share of the side at each.

    Over places -1 to 1 its level, slope and bend have independent errors in the Legendre polynomials 1, 3^1/2 x and
    5^1/2 (3 x^2 - 1) / 2; the ends lie at x = 1 / (1 - 2 left_out) and opposite.
    """
    end = 1.0 / (1.0 - 2.0 * left_out)
    even = 1.0 + 5.0 * ((3.0 * end**2 - 1.0) / 2.0) ** 2
    odd = 3.0 * end**2
    return (even - odd) / (even + odd)


def end_of_likeness(likeness: float) -> float:
    """Where a side ends, if it was drawn from -1 to 1 and its errors at both ends have this correlation.

    With u the square of it, the even and odd parts of the variance are 1 + 5/4 (3 u - 1)^2 and 3 u.
    """
    share = 3.0 * (1.0 + likeness) / (1.0 - likeness)
    squared = np.roots([11.25, -7.5 - share, 2.25])
    return float(np.sqrt(max(squared.real.max(), 1.0)))


def side_normals(corners: Float64[Array, "marker corner=4 xy=2"]) -> Float64[Array, "marker side=4 xy=2"]:
    """Unit normals of markers' sides, outwards: corners run clockwise."""
    along = np.roll(corners, -1, axis=1) - corners
    along /= np.linalg.norm(along, axis=-1, keepdims=True)
    return np.stack([along[..., 1], -along[..., 0]], axis=-1)


def _error_root(view: BoardView) -> Float64[Array, "marker coordinate=8 coordinate=8"]:
    """Root of the correlations of the eight coordinates that the ends of a marker's four sides give."""
    corners = view.points_px.reshape(-1, 4, 2)
    normals = side_normals(corners)
    meeting = np.linalg.inv(np.stack([normals, np.roll(normals, 1, axis=1)], axis=-2))
    by_ends = np.zeros((len(corners), 8, 8))
    for corner in range(4):
        by_ends[:, 2 * corner : 2 * corner + 2, [2 * corner, 2 * ((corner - 1) % 4) + 1]] = meeting[:, corner]
    ends = np.kron(np.eye(4), np.array([[1.0, view.likeness], [view.likeness, 1.0]]))
    root: Float64[Array, "marker coordinate=8 coordinate=8"] = np.linalg.cholesky(by_ends @ ends @ by_ends.mT)
    return root
